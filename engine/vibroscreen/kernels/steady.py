"""One slice followed from the feed to the discharge of every deck, or kept on a plate.

No packages are needed: a slice of a lower deck starts empty and takes up what falls on it, read
from the knots of the deck above (MODEL.md, "Steady state and batches").
"""

from __future__ import annotations

from vibroscreen.kernels.deck import advance_lead, cross_lead, start_cohort
from vibroscreen.kernels.jit import inlined, kernel
from vibroscreen.kernels.layout import (
    ACCEPTED,
    AT_CARRY,
    AT_COLUMN_TIME,
    AT_FALL_COHORT,
    AT_FEED_FRACTION,
    AT_HOLD_UP_WORK,
    AT_INPUT,
    AT_LEAD,
    AT_LEAD_FEED,
    AT_LEAD_PASSED,
    AT_PARTIAL,
    AT_SCENE,
    AT_STEP_MASS,
    D_CAPACITY_ALARM,
    D_COHORT_FRONT,
    D_LEAD_LAYERS,
    D_LEAD_PANEL,
    D_PACE,
    D_PARTIAL_LAYERS,
    D_STEP,
    D_WIDE,
    FEED_RATE,
    INPUT,
    N_DECKS,
    S_HORIZON,
    column,
    deck_vector,
    node_vector,
    scalars,
    scene_vector,
)
from vibroscreen.kernels.package import bed_load, restack
from vibroscreen.kernels.place import (
    conveys,
    deck_width,
    panel_count,
    panel_end_time,
    panel_velocity,
    residence_time,
)
from vibroscreen.kernels.step import prepare


@kernel
def start_slice(buffer, deck):
    """Put a slice at the feed end of a deck: on the top one what is fed, on a lower one nothing."""
    rate = max(0.0, scalars(buffer, AT_INPUT, len(INPUT))[FEED_RATE])
    start_cohort(buffer, deck, rate)
    clear_slice(buffer, deck)


@kernel
def clear_slice(buffer, deck):
    """Zero the sums that a slice adds to."""
    decks = int(buffer[N_DECKS])
    carry, fallen = node_vector(buffer, AT_CARRY, deck), node_vector(buffer, AT_FALL_COHORT, deck)
    under = node_vector(buffer, AT_STEP_MASS, deck)
    over = node_vector(buffer, AT_STEP_MASS, decks + deck)
    partial = column(buffer, AT_PARTIAL, deck)
    for i in range(carry.size):
        carry[i], fallen[i], under[i], over[i] = 0.0, 0.0, 0.0, 0.0
        for j in range(partial.shape[0]):
            partial[j, i] = 0.0
    deck_vector(buffer, deck)[D_CAPACITY_ALARM] = 0.0


@inlined
def prepare_slice(buffer):
    """Take the inputs in the buffer into use and start a slice on the top deck; ACCEPTED or not."""
    code = prepare(buffer, False)
    if code == ACCEPTED:
        for deck in range(int(buffer[N_DECKS])):
            horizon = residence_time(buffer, AT_SCENE, deck)
            for panel in range(panel_count(buffer, deck)):
                scene_vector(buffer, AT_SCENE, deck, panel)[S_HORIZON] = horizon
        start_slice(buffer, 0)
    return code


@kernel
def follow(buffer, deck, duration):
    """Let the slice of a deck ride on for `duration` s, over the ends of panels."""
    book = deck_vector(buffer, deck)
    left = duration
    while left > 0.0:
        panel = int(book[D_LEAD_PANEL])
        step = left
        crosses = False
        if conveys(buffer, deck) and panel + 1 < panel_count(buffer, deck):
            until = panel_end_time(buffer, AT_SCENE, deck, panel) - book[D_COHORT_FRONT]
            crosses = until <= left
            step = max(0.0, until) if crosses else left
        if step > 0.0:
            advance_lead(buffer, deck, step)
        book[D_COHORT_FRONT] += step
        left -= step
        if crosses:
            book[D_COHORT_FRONT] = panel_end_time(buffer, AT_SCENE, deck, panel)
            cross_lead(buffer, deck)


@inlined
def lay_batch(buffer, areal_mass, horizon):
    """Put a batch of `areal_mass` kg/m2 of the feed's composition on the plate."""
    book = deck_vector(buffer, 0)
    scene = scene_vector(buffer, AT_SCENE, 0, 0)
    lead = column(buffer, AT_LEAD, 0)
    fed, passed = node_vector(buffer, AT_LEAD_FEED, 0), node_vector(buffer, AT_LEAD_PASSED, 0)
    fraction = node_vector(buffer, AT_FEED_FRACTION, 0)
    for i in range(fed.size):
        fed[i] = areal_mass * fraction[i]
        passed[i] = 0.0
        for j in range(lead.shape[0]):
            lead[j, i] = 0.0
        lead[0, i] = fed[i]
    scene[S_HORIZON] = horizon
    book[D_STEP], book[D_PACE], book[D_WIDE] = 0.0, 0.0, 0.0
    book[D_LEAD_LAYERS] = restack(buffer, scene, lead, 1)


@inlined
def solve_decks(buffer):
    """Follow the slices of all decks to the discharge; the top one's is at the feed end.

    Afterwards `step_mass` holds the streams [kg/s]: undersize of every deck, then oversize of every
    deck; `hold_up_work` what lies on every deck [kg].
    """
    decks = int(buffer[N_DECKS])
    hold_up = scalars(buffer, AT_HOLD_UP_WORK, decks)
    for deck in range(decks):
        if deck > 0:
            start_slice(buffer, deck)
        if conveys(buffer, deck):
            follow(buffer, deck, residence_time(buffer, AT_SCENE, deck))
        book = deck_vector(buffer, deck)
        width = deck_width(buffer, deck)
        last = panel_count(buffer, deck) - 1
        passing = width * panel_velocity(buffer, AT_SCENE, deck, 0)
        leaving = width * panel_velocity(buffer, AT_SCENE, deck, last)
        under = node_vector(buffer, AT_STEP_MASS, deck)
        over = node_vector(buffer, AT_STEP_MASS, decks + deck)
        passed, lead = node_vector(buffer, AT_LEAD_PASSED, deck), column(buffer, AT_LEAD, deck)
        for i in range(passed.size):
            under[i] = passing * passed[i]
            over[i] = 0.0
        for j in range(int(book[D_LEAD_LAYERS])):
            for i in range(passed.size):
                over[i] += leaving * lead[j, i]
        partial = column(buffer, AT_PARTIAL, deck)
        hold_up[deck] = width * bed_load(partial, int(book[D_PARTIAL_LAYERS]))
