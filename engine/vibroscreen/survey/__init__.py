"""From the sheets of a plant's survey to a calibrated screen."""

from vibroscreen.survey.read import Sheet, Survey, SurveyRun, read_sheets, read_survey

__all__ = ["Sheet", "Survey", "SurveyRun", "read_sheets", "read_survey"]
