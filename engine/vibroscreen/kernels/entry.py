"""The one door from Python and C into the kernels; one compiled function with all below it."""

from __future__ import annotations

from vibroscreen.kernels import state
from vibroscreen.kernels.checks import check
from vibroscreen.kernels.library import entry
from vibroscreen.kernels.outputs import read_partition
from vibroscreen.kernels.steady import (
    follow,
    lay_batch,
    place_nodes,
    prepare_slice,
    solve_many,
    solve_steady,
    start_slice,
)
from vibroscreen.kernels.step import advance, initialise

(
    INITIALISE,
    ADVANCE,
    START_SLICE,
    START_BELOW,
    LAY_BATCH,
    FOLLOW,
    SOLVE,
    SOLVE_MANY,
    PLACE_NODES,
    READ,
    CHECK,
) = range(11)


@entry("int64(vector, int64, float64, float64)")
def run(buffer, command, first, second):
    """Carry out a command on a buffer; returns ACCEPTED or why it is refused.

    INITIALISE; ADVANCE first = s; START_SLICE; START_BELOW first = deck; LAY_BATCH first = kg/m2,
    second = s to come; FOLLOW first = s, second = deck; SOLVE; SOLVE_MANY first = designs, second =
    whether nodes change; PLACE_NODES; CHECK; READ what is found only when it is read.
    """
    if command == INITIALISE:
        return initialise(buffer)
    if command == ADVANCE:
        return advance(buffer, first)
    if command == START_SLICE:
        return prepare_slice(buffer)
    if command == CHECK:
        return check(buffer)
    if command == SOLVE:
        return solve_steady(buffer)
    if command == SOLVE_MANY:
        solve_many(buffer, int(first), second)
    elif command == READ:
        read_partition(buffer)
    elif command == PLACE_NODES:
        place_nodes(buffer)
    elif command == START_BELOW:
        start_slice(buffer, int(first))
    elif command == LAY_BATCH:
        lay_batch(buffer, first, second)
    else:
        follow(buffer, int(second), first)
    return state.ACCEPTED
