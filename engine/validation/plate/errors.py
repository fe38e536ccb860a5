"""Root mean square of errors, and one number of a table of them."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rmse(error: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(error))))


def at(frame: pd.DataFrame, row: str, column: str) -> float:
    """A number of a table."""
    return float(frame[column].to_numpy()[frame.index.get_loc(row)])
