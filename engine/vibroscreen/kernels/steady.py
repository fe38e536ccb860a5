"""One slice followed from the feed to the discharge, or kept on a plate: no packages needed."""

from __future__ import annotations

from vibroscreen.kernels.deck import residence_time, start_cohort
from vibroscreen.kernels.jit import inlined
from vibroscreen.kernels.layout import (
    ACCEPTED,
    AT_COLUMN_FLUX,
    AT_FEED_FRACTION,
    AT_INPUT,
    AT_LEAD,
    AT_LEAD_FEED,
    AT_LEAD_PASSED,
    AT_SCENE,
    D_LEAD_LAYERS,
    D_PACE,
    D_STEP,
    D_WIDE,
    FEED_RATE,
    INPUT,
    S_HORIZON,
    column,
    deck_vector,
    node_vector,
    scalars,
    scene_vector,
)
from vibroscreen.kernels.package import integrate, restack
from vibroscreen.kernels.step import prepare


@inlined
def follow(buffer, duration):
    """Advance the leading slice alone by `duration` s; what passed is added to lead_passed."""
    book = deck_vector(buffer, 0)
    scene = scene_vector(buffer, AT_SCENE, 0, 0)
    lead = column(buffer, AT_LEAD, 0)
    fed = node_vector(buffer, AT_LEAD_FEED, 0)
    layers = int(book[D_LEAD_LAYERS])
    book[D_LEAD_LAYERS] = integrate(buffer, scene, book, lead, fed, layers, duration)
    passed, more = node_vector(buffer, AT_LEAD_PASSED, 0), node_vector(buffer, AT_COLUMN_FLUX, 0)
    for i in range(passed.size):
        passed[i] += more[i]


@inlined
def start_slice(buffer):
    """Put the slice that enters with the inputs in the buffer at the feed end; ACCEPTED or not."""
    code = prepare(buffer, False)
    if code == ACCEPTED:
        scene = scene_vector(buffer, AT_SCENE, 0, 0)
        scene[S_HORIZON] = residence_time(buffer, 0, scene)
        start_cohort(buffer, 0, max(0.0, scalars(buffer, AT_INPUT, len(INPUT))[FEED_RATE]))
    return code


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
