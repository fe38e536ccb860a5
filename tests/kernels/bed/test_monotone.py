"""What must rise or fall does: feed, length, open area, size; for every law and model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vibroscreen import ScreenConfig, solve_steady_many
from vibroscreen.sections import Bed, Deck, Displacement, Panel, Passage, Segregation, Solver
from vibroscreen.size_classes import SizeClasses
from vibroscreen.stream import Feed

EDGES = (0.0, 0.002, 0.004, 0.006, 0.008, 0.010, 0.014, 0.020)
APERTURE = 0.010
TOLERANCE = 1e-4
LAWS = ("gaudin", "pelevin", "bounce")
MODELS = ("well_mixed", "proportional", "exchange", "classified")

OF_BOUNCE = {"drift": 0.3, "crowding": 4.0, "levelling": 0.3, "bouncing": 10.0}

fractions = st.lists(st.floats(0.02, 1.0), min_size=7, max_size=7)
logs = {
    "u": st.floats(np.log(0.005), np.log(1.0)),
    "w": st.floats(np.log(0.002), np.log(0.5)),
    "dilation": st.floats(np.log(1e-4), np.log(1e-2)),
    "rate": st.floats(np.log(3.0), np.log(100.0)),
}


@st.composite
def screens(draw: st.DrawFn, law: str, model: str) -> ScreenConfig:
    """A screen of seven classes, thin to deep beds, weak to strong passage and percolation."""
    number = {name: float(np.exp(draw(strategy))) for name, strategy in logs.items()}
    fed = np.array(draw(fractions))
    bounced = {}
    if law == "bounce":
        bounced = {name: draw(st.sampled_from((0.0, most))) for name, most in OF_BOUNCE.items()}
    # With drift a size inside a class may be the last that passes at all: the nodes that the engine
    # chooses, by the duty, then take that edge differently.
    nodes = (1,) if bounced.get("drift") else (0, 1)
    return ScreenConfig(
        SizeClasses(EDGES, draw(st.sampled_from(nodes))),
        decks=(Deck(1.5, (Panel(3.0, 0.0, APERTURE, 0.5),)),),
        displacement=Displacement("prescribed", draw(st.floats(0.1, 0.5))),
        passage=Passage(law, number["u"], **bounced),
        segregation=Segregation(model, number["w"], number["dilation"], draw(st.floats(0.0, 1.0))),
        bed=Bed(draw(st.floats(0.005, 0.02))),
        solver=Solver(TOLERANCE),
        feed=Feed(number["rate"], tuple(fed / fed.sum())),
    )


VARIED = {
    "feed.mass_flow_rate": (np.array([1.0, 1.15, 1.5, 3.0]), -1.0),
    "deck[1].panel[1].length": (np.array([1.0, 1.1, 1.5, 3.0]), 1.0),
    "deck[1].panel[1].open_area": (np.array([0.5, 0.55, 0.7, 0.9]), 1.0),
}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("model", MODELS)
def test_recovery_is_monotone(law: str, model: str) -> None:
    """More feed: lower. A longer deck, a wider open area: higher. Near-size: last of all.

    The undersize recovery, and on one screen the recovery of every class against the finer ones;
    what the solver's tolerance allows is allowed, twice as both sides may err. Two exceptions are
    the laws' own. Under Pelevin a grain passes more easily beside finer ones; a sorted bed that
    gets deeper than the contact layer puts finer ones there: a gain of 0.0053 was found. And under bounce grains of a deck that
    is not covered bounce on: there a screen recovers the more, the more is fed, as in practice. So
    more feed is held to lower the recovery only of beds that land softly (bouncing 0).
    """
    sorts = model in ("classified", "proportional")
    gained = 2e-2 if sorts and law == "pelevin" else 0.0

    @settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
    @given(screens(law, model))
    def check(config: ScreenConfig) -> None:
        finer = np.array(EDGES[1:]) <= APERTURE
        fed = np.array(config.feed.mass_fraction)[finer]
        bounces = law == "bounce" and config.passage.bouncing > 0.0
        for name, (factors, sign) in VARIED.items():
            if bounces and name == "feed.mass_flow_rate":
                continue
            value = 1.0 if name.endswith("open_area") else config.value_of(name)
            table = solve_steady_many(config, {name: value * factors})
            total = table.recovery[:, finer] @ fed / fed.sum()
            allowed = max(2.0 * TOLERANCE, gained if sign < 0.0 else 0.0)
            assert (sign * np.diff(total) > -allowed).all(), (name, total)
            by_size = np.diff(table.recovery[:, finer], axis=1)
            assert (by_size < 2.0 * TOLERANCE).all(), (name, table.recovery)
            assert (table.recovery[:, ~finer] == 0.0).all()

    check()
