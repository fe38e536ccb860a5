"""The one door from Python and C into the kernels; one compiled function with all below it."""

from __future__ import annotations

from vibroscreen.kernels.jit import kernel
from vibroscreen.kernels.layout import ACCEPTED
from vibroscreen.kernels.steady import follow, lay_batch, start_slice
from vibroscreen.kernels.step import advance, initialise

INITIALISE, ADVANCE, START_SLICE, LAY_BATCH, FOLLOW = range(5)


@kernel
def run(buffer, command, first, second):
    """Carry out a command on a buffer; returns ACCEPTED or why it is refused.

    INITIALISE; ADVANCE first = s; START_SLICE; LAY_BATCH first = kg/m2, second = s to come;
    FOLLOW first = s.
    """
    if command == INITIALISE:
        return initialise(buffer)
    if command == ADVANCE:
        return advance(buffer, first)
    if command == START_SLICE:
        return start_slice(buffer)
    if command == LAY_BATCH:
        lay_batch(buffer, first, second)
    else:
        follow(buffer, first)
    return ACCEPTED
