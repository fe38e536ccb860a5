"""Streams that meet in a chute or a bin without hold-up."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Rates", "composition", "mix"]

Rates: TypeAlias = NDArray[np.float64]
"""Mass flow rate by size class, finest first, kg/s."""


def mix(*streams: Rates) -> Rates:
    """Mass flow rate by size class of the mixed stream, kg/s.

    Adding rates class by class weighs the compositions by mass. Nothing is held, no time passes.
    ValueError if the streams do not have the same size classes.
    """
    if not streams:
        raise ValueError("streams = () is nothing to mix: give at least one")
    for number, stream in enumerate(streams[1:], start=2):
        if stream.shape != streams[0].shape:
            raise ValueError(
                f"stream {number} has {stream.size} size classes, the first has "
                f"{streams[0].size}: give all streams on the same sieves"
            )
    return np.asarray(np.sum(streams, axis=0))


def composition(stream: Rates, at_rest: Rates) -> Rates:
    """Mass fraction of each size class in a stream, 1; sums to one.

    A stream that does not flow has no composition and takes that of `at_rest`.
    """
    reference = stream if stream.sum() > 0.0 else at_rest
    return np.asarray(reference / reference.sum())
