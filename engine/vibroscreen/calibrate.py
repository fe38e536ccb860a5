"""Fits of the model to surveys, by the name that they have had: `vibroscreen.survey.calibrate`."""

from vibroscreen.survey.calibrate import (
    Calibration,
    Fit,
    HeldOut,
    Parameter,
    Run,
    calibrate,
    fit,
)

__all__ = ["Calibration", "Fit", "HeldOut", "Parameter", "Run", "calibrate", "fit"]
