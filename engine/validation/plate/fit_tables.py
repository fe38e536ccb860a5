"""What a fit found and what it says of itself, for a section of the report."""

from __future__ import annotations

from evidence import table
from vibroscreen.calibrate import Calibration


def numbers_table(calibration: Calibration) -> str:
    """Fitted numbers with their intervals and the range over the left-out fits."""
    frame = calibration.fit.frame()
    rows = [
        (
            name,
            f"{row['value']:.3g}",
            f"{row['lower_95']:.2g} to {row['upper_95']:.2g}",
            f"{row['held_out_min']:.2g} to {row['held_out_max']:.2g}",
        )
        for name, row in frame.iterrows()
    ]
    return table(("number (SI)", "value", "95 %", "a case left out"), rows)


def said(calibration: Calibration) -> str:
    """What the fit warns of."""
    return "".join(f"- {warning}\n" for warning in calibration.fit.warnings) or "- nothing\n"
