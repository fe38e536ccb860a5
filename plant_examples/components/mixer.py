"""Streams that meet in a chute or a bin without hold-up."""

from __future__ import annotations

import numpy as np

from components.stream import Rates

__all__ = ["mix"]


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
