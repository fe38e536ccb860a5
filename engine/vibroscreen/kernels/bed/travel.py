"""Where things are on a deck: panels, cells, and riding time against place (MODEL.md, "The deck").

The riding time is what a package needs from the feed end to a place, s. A deck conveys on all of
its panels or on none.
"""

from math import inf

from vibroscreen.compiler.language import kernel
from vibroscreen.kernels import state


@kernel
def panel_count(buffer, deck):
    return int(state.panel_count(buffer)[deck])


@kernel
def deck_length(buffer, deck):
    length = 0.0
    for panel in range(panel_count(buffer, deck)):
        length += state.panel(buffer, deck, panel).length
    return length


@kernel
def panel_velocity(buffer, deck, panel):
    return state.scene(buffer, deck, panel).transport_velocity


@kernel
def conveys(buffer, deck):
    return panel_velocity(buffer, deck, 0) > 0.0


@kernel
def panel_end_time(buffer, deck, panel):
    """Riding time at the end of a panel, s."""
    return riding_time_over(buffer, False, deck, panel + 1)


@kernel
def time_to_next(buffer, deck, panel, time):
    """Time from a riding time on until the next panel, s; endless on the last one, and at rest."""
    if panel + 1 < panel_count(buffer, deck) and conveys(buffer, deck):
        return panel_end_time(buffer, deck, panel) - time
    return inf


@kernel
def riding_time_over(buffer, new, deck, panels):
    """Riding time over the first panels in the scenes in use or new, s; 0: it does not convey."""
    time = 0.0
    for k in range(panels):
        scene = state.scene_now(buffer, deck, k) if new else state.scene(buffer, deck, k)
        velocity = scene.transport_velocity
        if velocity <= 0.0:
            return 0.0
        time += state.panel(buffer, deck, k).length / velocity
    return time


@kernel
def residence_time(buffer, deck):
    """Riding time at the discharge, s; 0 where the deck does not convey."""
    return panel_end_time(buffer, deck, panel_count(buffer, deck) - 1)


@kernel
def place_after(buffer, deck, time):
    """Place [m] at a riding time [s], also before the feed end and beyond the discharge."""
    if panel_velocity(buffer, deck, 0) <= 0.0:
        return time
    place, left, last = 0.0, time, panel_count(buffer, deck) - 1
    for panel in range(last):
        length = state.panel(buffer, deck, panel).length
        velocity = panel_velocity(buffer, deck, panel)
        if left * velocity <= length:
            return place + left * velocity
        left -= length / velocity
        place += length
    return place + left * panel_velocity(buffer, deck, last)


@kernel
def panel_cells(buffer, deck, panel):
    return int(state.panel_cells(buffer, deck)[panel])


@kernel
def cell_length(buffer, deck, panel):
    """Length of a cell on a panel, that of the longest package, m."""
    return state.panel(buffer, deck, panel).length / panel_cells(buffer, deck, panel)


@kernel
def cell_panel(buffer, deck, cell):
    panel = 0
    first = panel_cells(buffer, deck, 0)
    while cell >= first and panel + 1 < panel_count(buffer, deck):
        panel += 1
        first += panel_cells(buffer, deck, panel)
    return panel


@kernel
def cell_end(buffer, deck, cell):
    """Riding time at the end of a cell, s."""
    panel = cell_panel(buffer, deck, cell)
    behind = -1 - cell  # cells of the panel that follow
    for k in range(panel + 1):
        behind += panel_cells(buffer, deck, k)
    end = panel_end_time(buffer, deck, panel)
    if behind == 0:
        return end
    span = state.panel(buffer, deck, panel).length / panel_velocity(buffer, deck, panel)
    return end - span * behind / panel_cells(buffer, deck, panel)
