"""Observed orders: of each scheme in time, of the cells along the deck, of the layers of a bed.

Against closed solutions: a well mixed deep bed (tests/exact.py), and for the cells a converged run.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.test_exact_solutions import MIXED, exact_load, scene
from vibroscreen import Feed, Screen
from vibroscreen import screen as screen_module
from vibroscreen.config import ScreenConfig, Solver
from vibroscreen.kernels import layout as lay
from vibroscreen.kernels import package
from vibroscreen.kernels.entry import LAY_BATCH, START_SLICE, run
from vibroscreen.kernels.jit import kernel

AREAL_MASS, TIME = 70.0, 2.0


@kernel
def march_explicit(buffer, scene_, layers, h, steps, scheme):
    """Steps of one length of an explicit scheme, from the block NOW; five stages if stabilised."""
    for _ in range(steps):
        package.column_rates(
            buffer, scene_, lay.AT_STAGE, package.NOW, layers, lay.AT_STAGE, package.K1, 0.0
        )
        if scheme == package.PAIR:
            package.pair_step(buffer, scene_, layers, h, 0.0)
        elif scheme == package.POSITIVE:
            package.positive_step(buffer, scene_, layers, h, 0.0)
        else:
            package.stabilised_step(buffer, scene_, layers, h, 5, 0.0)
        package.take_explicit(buffer, layers, False)


@kernel
def march_implicit(buffer, scene_, layers, h, steps):
    """The same of the implicit scheme, extrapolated to order 3."""
    for _ in range(steps):
        for k in range(3):
            package.run_trial(buffer, scene_, k, layers, layers, h, 0.0)
            package.extrapolate(buffer, k, layers)
        package.take_implicit(buffer, scene_, layers, h)


SCHEMES = {
    "pair": (package.PAIR, 5, (1, 2, 4, 8)),
    "positive": (package.POSITIVE, 3, (2, 4, 8, 16)),
    "stabilised": (package.STABILISED, 2, (4, 8, 16, 32)),
    "implicit": (None, 3, (4, 8, 16, 32)),
}


def slope(number: tuple[int, ...], error: list[float]) -> float:
    """Fitted order: how fast the error falls with the number."""
    return -float(np.polyfit(np.log(number), np.log(error), 1)[0])


@pytest.mark.parametrize("name", SCHEMES)
def test_order_of_a_scheme_in_time(name: str) -> None:
    """Well mixed deep bed: passed masses after 2 s against the closed solution."""
    scheme, order, numbers = SCHEMES[name]
    config = scene(Feed(60.0, MIXED))
    layout, buffer = Screen(config)._slice()
    run(buffer, START_SLICE, 0.0, 0.0)
    run(buffer, LAY_BATCH, AREAL_MASS, TIME)
    load, scene_ = layout.view(buffer, "lead")[0], layout.view(buffer, "scene")[0, 0]
    reference = layout.view(buffer, "lead_feed")[0]
    first = load.copy()
    left, deep = exact_load(first[0], config.passage.velocity, config.bed.contact_depth, TIME)
    assert deep
    errors = []
    for steps in numbers:
        load[:] = first
        layout.view(buffer, "column_flux")[:] = 0.0
        package.gather(buffer, scene_, load, reference, 1)
        package.layers_for(buffer, scene_, first.sum())
        if scheme is None:
            march_implicit(buffer, scene_, 1, TIME / steps, steps)
        else:
            march_explicit(buffer, scene_, 1, TIME / steps, steps, scheme)
        package.scatter(buffer, load, 1, 1, TIME)
        errors.append(float(np.abs(load[0] - left).max() / AREAL_MASS))
    assert errors[-1] > 1e-14  # still above round-off
    assert slope(numbers, errors) == pytest.approx(order, abs=0.4), errors


def test_order_of_the_cells_along_the_deck(monkeypatch: pytest.MonkeyPatch) -> None:
    """What packages average away is of second order in their length.

    Undersize by class while the frequency changes every two seconds, integrated tightly, against a
    run with many cells.
    """
    config = ScreenConfig.default().replace(solver=Solver(1e-2))

    def undersize(cells: int) -> np.ndarray:
        monkeypatch.setattr(screen_module, "LEAST_CELLS", cells)
        screen = Screen(config)
        assert screen.layout.dimension["cells"] == cells
        screen.view("parameter")[lay.TOLERANCE] = 1e-8
        screen.switch(closed_cohorts=False)  # they average nothing
        frequency = screen.view("input")[lay.FREQUENCY : lay.FREQUENCY + 1]
        rows = []
        for k in range(20):
            frequency[0] = 15.5 + 0.8 * np.sin(1.3 * k)
            screen.advance(2.0)
            rows.append(screen.balance().undersize.to_numpy())
        return np.array(rows) / screen.balance().fed.to_numpy()

    reference = undersize(512)
    numbers = (8, 16, 32, 64)
    errors = [float(np.sqrt(((undersize(n) - reference) ** 2).mean())) for n in numbers]
    assert slope(numbers, errors) == pytest.approx(2.0, abs=0.5), errors
