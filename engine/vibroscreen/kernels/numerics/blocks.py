"""Columns as the schemes hold them: of the sizes that take part, in blocks of `stage`.

A block is what passed, the loads of the layers, and the composition of the top one in the row above
it, as vectors over the sizes that take part, a multiple of four: `stage` gives it as one vector,
stage_passed and stage_load[layer, size] its parts.
"""

from vibroscreen.compiler.fours import all_four, four, four_in, in_fours, larger, largest
from vibroscreen.compiler.language import kernel, view1, view2
from vibroscreen.kernels import state
from vibroscreen.kernels.physics.layer import layer_mass

# Blocks: the column, the column at a stage, the rates at the stages, time integrals.
NOW, STAGED, K1, K2, K3, K4, K5, K6, K7, INTEGRAL = range(10)
# Trials of the implicit scheme. In their place while rates are found: loads at the faces of the
# layers. While a step is taken: its errors; between steps the column or its time integral over a
# part.
TRIAL = 10
LOWER, UPPER, OF_PART = TRIAL, TRIAL + 1, TRIAL + 2


@kernel
def _start(buffer, index):
    rows = state.extent(buffer).layers + 2
    return int(buffer[state.AT.stage]) + index * rows * in_fours(state.extent(buffer).nodes)


@kernel
def stage(buffer, index):
    rows = state.extent(buffer).layers + 2
    return view1(buffer, _start(buffer, index), rows * state.work(buffer).active)


@kernel
def stage_passed(buffer, index):
    return view1(buffer, _start(buffer, index), state.work(buffer).active)


@kernel
def stage_load(buffer, index):
    """Loads of a block [layer, active size]."""
    active = state.work(buffer).active
    return view2(buffer, _start(buffer, index) + active, state.extent(buffer).layers, active)


@kernel
def stage_share(buffer, index, layers):
    """Mass fractions of the top one of `layers` layers in a block [1, active size]."""
    active = state.work(buffer).active
    return view2(buffer, _start(buffer, index) + (layers + 1) * active, 1, active)


@kernel
def top_mass(buffer, index, layers):
    """Mass of the top layer in a block, kg/m2, or its rate."""
    return layer_mass(stage_load(buffer, index), layers - 1)


@kernel
def rates(buffer):
    """Rates at the stages 1 to 7, each a block as one vector."""
    k1, k2, k3 = stage(buffer, K1), stage(buffer, K2), stage(buffer, K3)
    k4, k5, k6 = stage(buffer, K4), stage(buffer, K5), stage(buffer, K6)
    return k1, k2, k3, k4, k5, k6, stage(buffer, K7)


@kernel
def step_ends(buffer):
    """The column before and after a step that is not yet taken, and its rates then."""
    return stage(buffer, NOW), stage(buffer, STAGED), stage(buffer, K1), stage(buffer, K7)


@kernel
def follows_share(buffer, layers):
    """Whether the composition of the top layer is followed beside its masses."""
    return layers > 1 and state.work(buffer).source_terms == 0.0


@kernel
def rows_followed(buffer, layers):
    """Length of the part of a block that a scheme advances."""
    return (layers + (2 if follows_share(buffer, layers) else 1)) * state.work(buffer).active


@kernel
def worst_of(error, weight):
    """Largest product of two vectors over the sizes that take part, not below 0."""
    worst = all_four(0.0)
    for i in range(0, error.size, 4):
        worst = larger(worst, four(error, i) * four(weight, i))
    return largest(worst)


@kernel
def largest_of(values, row):
    """Largest number of a row over the sizes that take part, not below 0."""
    most = all_four(0.0)
    for i in range(0, values.shape[1], 4):
        most = larger(most, four_in(values, row, i))
    return largest(most)
