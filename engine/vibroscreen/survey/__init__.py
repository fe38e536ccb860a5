"""From the sheets of a plant's survey to a calibrated screen."""

from vibroscreen.survey.read import Sheet, Survey, SurveyRun, read_sheets
from vibroscreen.survey.reconcile import Noise, Reconciliation, reconcile
from vibroscreen.survey.recoveries import read_survey

__all__ = [
    "Noise",
    "Reconciliation",
    "Sheet",
    "Survey",
    "SurveyRun",
    "read_sheets",
    "read_survey",
    "reconcile",
]
