"""Observed orders: of each scheme in time, of the cells along the deck, of the layers of a bed.

Against closed solutions: a well mixed deep bed (tests/kernels/numerics/exact.py), and for the cells a converged run.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.fixed import FIXED, fixed_screen
from tests.kernels.numerics.test_exact_solutions import MIXED, exact_load, scene
from vibroscreen import Feed, Screen
from vibroscreen import screen as screen_module
from vibroscreen.compiler.whole import compiled
from vibroscreen.config import ScreenConfig
from vibroscreen.kernels import state
from vibroscreen.kernels.entry import LAY_BATCH, START_SLICE, run
from vibroscreen.kernels.numerics import (
    blocks,
    chain,
    column,
    explicit,
    implicit,
    layers,
    pair,
    rates,
    step_control,
)
from vibroscreen.sections import Bed, Displacement, Solver
from vibroscreen.size_classes import SizeClasses

AREAL_MASS, TIME = 70.0, 2.0


@compiled
def march_explicit(buffer, layers, h, steps, scheme):
    """Steps of one length of an explicit scheme, from the block NOW.

    scheme: PAIR or the number of stages of the chain.
    """
    scene_ = state.scene(buffer, 0, 0)
    for _ in range(steps):
        rates.column_rates(buffer, scene_, blocks.NOW, layers, blocks.K1, 0.0)
        if scheme == explicit.PAIR:
            pair.pair_step(buffer, scene_, layers, h, 0.0)
        else:
            chain.chain_step(buffer, scene_, layers, h, scheme, 0.0)
        explicit.take_explicit(buffer, layers, False)


@compiled
def march_implicit(buffer, layers, h, steps):
    """The same of the implicit scheme, extrapolated to order 3."""
    scene_ = state.scene(buffer, 0, 0)
    for _ in range(steps):
        for k in range(3):
            implicit.run_trial(buffer, scene_, k, layers, layers, h, 0.0)
            implicit.extrapolate(buffer, k, layers)
        implicit.take_implicit(buffer, scene_, layers, h)


STAGES = range(chain.CHAIN_LEAST, chain.CHAIN_MOST + 1)
SCHEMES = {
    "pair": (explicit.PAIR, 5, (1, 2, 4, 8)),
    **{f"chain of {s}": (s, 3, (2, 4, 8, 16)) for s in STAGES},
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
    load, scene_ = layout.view(buffer, "lead")[0], layout.record(buffer, "scene")[0, 0]
    reference = layout.view(buffer, "lead_feed")[0]
    first = load.copy()
    left, deep = exact_load(first[0], config.passage.velocity, config.bed.contact_depth, TIME)
    assert deep
    errors = []
    for steps in numbers:
        load[:] = first
        layout.view(buffer, "column_flux")[:] = 0.0
        column.gather(buffer, scene_, load, reference, 1)
        layers.layers_for(buffer, scene_, first.sum())
        if scheme is None:
            march_implicit(buffer, 1, TIME / steps, steps)
        else:
            march_explicit(buffer, 1, TIME / steps, steps, scheme)
        column.scatter(buffer, load, 1, 1, TIME)
        errors.append(float(np.abs(load[0] - left).max() / AREAL_MASS))
    assert errors[-1] > 1e-14  # still above round-off
    assert slope(numbers, errors) == pytest.approx(order, abs=0.4), errors


def decayed(a: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Stages of an explicit Runge-Kutta scheme on y' = -y from 1, in steps of z [stage, step]."""
    stage = np.ones((len(a), z.size))
    for j in range(1, len(a)):
        stage[j] = 1.0 - z * (a[j] @ stage)
    return stage


def butcher(stages: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The chain as a Runge-Kutta scheme with the next step's first stage: a, b, and the error's b."""
    row = stages - chain.CHAIN_LEAST
    a, b, error = np.zeros((stages + 1, stages + 1)), np.zeros(stages + 1), np.zeros(stages + 1)
    a[range(1, stages), range(stages - 1)] = chain.CHAIN_STAGE[row, : stages - 1]
    a[stages - 1, 0] += chain.CHAIN_FIRST[row]
    b[stages - 3 : stages] = chain.CHAIN_END[row]
    a[stages] = b
    places = [0, *range(stages - 4, stages + 1)]
    np.add.at(error, places, chain.CHAIN_ERROR[row])
    return a, b, error


@pytest.mark.parametrize("stages", STAGES)
def test_conditions_of_the_chain(stages: int) -> None:
    """Order 3, an error of order 4 that is right for linear rates, and stability.

    On y' = -y the solution after z is nearer to exp(-z) than that of any other scheme of order 3 with
    as many stages: the difference reaches its largest magnitude with alternating signs at one place
    more than there are free coefficients (Chebyshev).
    """
    a, b, error = butcher(stages)
    c = a.sum(axis=1)
    assert c[-1] == pytest.approx(1.0, abs=1e-15)
    for weights, order in ((b, (1.0, 1 / 2, 1 / 3, 1 / 6)), (error, (0.0, 0.0, 0.0, 0.0))):
        found = [weights.sum(), weights @ c, weights @ c**2, weights @ a @ c]
        np.testing.assert_allclose(found, order, atol=2e-15)
    assert error @ a @ a @ c == pytest.approx(b @ a @ a @ c - 1 / 24, rel=1e-12)

    reach = chain.CHAIN_STABLE[stages - chain.CHAIN_LEAST]
    z = reach * np.linspace(0.0, 1.0, 20001)
    stage = decayed(a, z)
    assert np.abs(stage).max() <= 1.0 + 1e-12
    missed = stage[stages] - np.exp(-z)
    slope = np.diff(missed)
    extremes = missed[[*(np.nonzero(slope[1:] * slope[:-1] < 0.0)[0] + 1), -1]]
    largest = np.abs(missed).max()
    assert extremes.size >= stages - 2
    np.testing.assert_allclose(np.abs(extremes), largest, rtol=1e-3)
    assert (extremes[1:] * extremes[:-1] < 0.0).all()
    assert largest < 0.35
    # The error is not much less than the truth, nor far beyond it where all is damped.
    estimate = np.abs(z * (error @ stage))
    assert (estimate >= 0.3 * np.abs(missed) - 0.25 * largest).all()
    assert estimate.max() < (1.2 if stages == 4 else 0.6)


def test_estimate_of_the_pair() -> None:
    """On y' = -y what order 5 leaves out is at most HIGHER z of the estimate, wherever it is stable."""
    a, b = np.zeros((7, 7)), pair.A[5]
    a[1:, :6] = pair.A
    z = np.linspace(0.05, explicit.STABLE, 500)
    stage = decayed(a, z)
    estimate = np.abs(z * ((np.append(b, 0.0) - pair.B_LOW) @ stage))
    missed = np.abs(stage[6] - np.exp(-z))
    assert (missed <= step_control.HIGHER * z * estimate).all()
    assert (missed >= 0.7 * step_control.HIGHER * z * estimate).all()


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
        screen.record("parameter").solver_tolerance = 1e-8
        screen.switch(closed_cohorts=False)  # they average nothing
        inputs = screen.record("input")
        rows = []
        for k in range(20):
            inputs.motion_frequency = 15.5 + 0.8 * np.sin(1.3 * k)
            screen.advance(2.0)
            rows.append(screen.balance().undersize.to_numpy())
        return np.array(rows) / screen.balance().fed.to_numpy()

    reference = undersize(512)
    numbers = (8, 16, 32, 64)
    errors = [float(np.sqrt(((undersize(n) - reference) ** 2).mean())) for n in numbers]
    assert slope(numbers, errors) == pytest.approx(2.0, abs=0.5), errors


def test_steps_go_past_layers_that_run_out() -> None:
    """A bed of 80 mm in ever thinner layers: the error keeps to the tolerance, hardly a step lands.

    At a tolerance of 1e-8 a step ends wherever a layer runs out.
    """
    tolerance, layers = 1e-4, (12, 25, 50, 100)
    default = fixed_screen()
    steps = []

    def solve(count: int, solver: Solver) -> tuple[np.ndarray, float, float]:
        depth = 0.08 / count
        screen = Screen(
            default.replace(
                size_classes=SizeClasses(default.size_classes.edges, subdivision=1),
                displacement=Displacement("prescribed", 0.3),
                segregation=dataclasses.replace(FIXED["segregation"], velocity=0.05),
                bed=Bed(contact_depth=depth, layer_depth=depth, layers=count + 1),
                solver=solver,
            )
        )
        recovery = screen.solve_steady().recovery
        layout, buffer = screen._slice()
        counter = layout.record(buffer, "counter")
        return recovery, counter.column_steps, counter.landings

    for count in layers:
        exact, _, _ = solve(count, Solver(1e-8))
        recovery, taken, landings = solve(count, Solver(tolerance))
        assert np.abs(recovery - exact).max() <= tolerance
        assert landings <= 0.05 * taken
        steps.append(taken)
    assert slope(layers, steps) > -0.4, steps
