"""The one door from Python and C into the kernels; one compiled function with all below it."""

from vibroscreen.kernels import checks, outputs, state, steady, step
from vibroscreen.kernels.bed import along
from vibroscreen.kernels.library import entry

INITIALISE, ADVANCE, START_SLICE, START_BELOW, LAY_BATCH, FOLLOW = range(6)
SOLVE, SOLVE_MANY, PLACE_NODES, READ, CHECK, READ_BED = range(6, 12)


@entry("int64(vector, int64, float64, float64)")
def run(buffer, command, first, second):
    """Carry out a command on a buffer; returns ACCEPTED or why it is refused.

    INITIALISE; ADVANCE first = s; START_SLICE; START_BELOW first = deck; LAY_BATCH first = kg/m2,
    second = s to come; FOLLOW first = s, second = deck; SOLVE; SOLVE_MANY first = designs, second =
    whether nodes change; PLACE_NODES; CHECK; READ what is found only when it is read; READ_BED what
    lies at the place first = m, second = deck.
    """
    if command == INITIALISE:
        return step.initialise(buffer)
    if command == ADVANCE:
        return step.advance(buffer, first)
    if command == START_SLICE:
        return steady.prepare_slice(buffer)
    if command == CHECK:
        return checks.check(buffer)
    if command == SOLVE:
        return steady.solve_steady(buffer)
    if command == SOLVE_MANY:
        steady.solve_many(buffer, int(first), second)
    elif command == READ:
        outputs.read_sizes(buffer)
    elif command == READ_BED:
        along.read_bed(buffer, int(second), first)
    elif command == PLACE_NODES:
        steady.place_nodes(buffer)
    elif command == START_BELOW:
        steady.start_slice(buffer, int(first))
    elif command == LAY_BATCH:
        steady.lay_batch(buffer, first, second)
    else:
        steady.follow(buffer, int(second), first)
    return state.ACCEPTED
