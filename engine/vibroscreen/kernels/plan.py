"""What must be known of a screen before its state is laid out: cells, nodes, passage by panel.

Python uses the formulas one by one, the library without Python calls `plan`.
"""

from math import ceil, sqrt

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.travel import panel_count
from vibroscreen.kernels.checks import APERTURE, check, refuse
from vibroscreen.kernels.library import entry
from vibroscreen.kernels.numerics import vectors
from vibroscreen.kernels.steady import place_nodes

# A package is never longer than this part of the deck, less where the tolerance asks for it: what
# it averages along y is of second order in its length.
LEAST_CELLS = 64
MOST_CELLS = 512


@kernel
def cells_for(tolerance, least):
    """Cells of a deck: a package is never longer than one."""
    cells = int(ceil(least * sqrt(1e-4 / tolerance)))
    return min(MOST_CELLS, max(least, cells))


@kernel
def share_cells(length, cells, share):
    """Cells on each panel of a deck: by its length [m], at least one."""
    whole = vectors.total(length)
    end, taken = 0.0, 0
    for k in range(length.size):
        end += length[k]
        left = length.size - 1 - k
        wanted = int(end * cells / whole + 0.5) if left > 0 else cells
        stop = max(taken + 1, min(cells - left, max(taken + 1, wanted)))
        share[k] = stop - taken
        taken = stop


@kernel
def between(at, value, x):
    """Linear interpolation of value over at, ascending; x lies between the first and the last."""
    last = at.size - 1
    if x >= at[last]:
        return value[last]
    k = 0
    while x >= at[k + 1]:
        k += 1
    return (value[k + 1] - value[k]) / (at[k + 1] - at[k]) * (x - at[k]) + value[k]


@entry("int64(vector, vector, vector)")
def plan(buffer, aperture, velocity):
    """Fill in what follows from parameters, feed and edges in a buffer with room for one slice.

    aperture and velocity: rows of the table of passage velocities, or none. Writes the number of
    cells and of nodes, cells and passage factors of the panels, and the nodes. Returns the code of
    a refusal, or ACCEPTED.
    """
    code = check(buffer)
    if code == state.ACCEPTED and aperture.size > 0:
        code = read_velocities(buffer, aperture, velocity)
    if code != state.ACCEPTED:
        return code
    extent = state.extent(buffer)
    extent.cells = cells_for(state.parameters(buffer).solver_tolerance, LEAST_CELLS)
    for deck in range(extent.decks):
        # The lengths lie apart from each other: in a row for a moment.
        length = state.vector(buffer, state.AT.kinks, panel_count(buffer, deck), 0)
        for k in range(length.size):
            length[k] = state.panel(buffer, deck, k).length
        share_cells(length, extent.cells, state.panel_cells(buffer, deck))
    place_nodes(buffer)
    return code


@kernel
def read_velocities(buffer, aperture, velocity):
    """Passage velocity of the first panel, and of all panels over it, from a table."""
    first, extent = 0.0, state.extent(buffer)
    for deck in range(extent.decks):
        factor = state.passage_factor(buffer, deck)
        for k in range(panel_count(buffer, deck)):
            wanted = state.panel(buffer, deck, k).aperture
            least, most = aperture[0], aperture[aperture.size - 1]
            if not least <= wanted <= most:
                place = state.panel_place(buffer, deck, k) + APERTURE
                limit = least if wanted < least else most
                return refuse(buffer, state.REFUSED.off_table, place, wanted, limit)
            found = between(aperture, velocity, wanted)
            if deck == 0 and k == 0:
                first = found
                state.parameters(buffer).passage_velocity = first
            factor[k] = found / first if first != 0.0 else 1.0
    return state.ACCEPTED
