"""The particle simulations: errors of the calibrated plate computed anew, against the targets."""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from dem_calibration import PLATE
from evidence import DATA
from plate import along, fit
from plate.batch_section import write_batches
from plate.decks import deck_runs, twice_the_feed
from plate.heights import heights
from plate.segregation import growth
from vibroscreen import Feed, Motion, Screen, ScreenConfig
from vibroscreen.size_classes import SizeClasses

DECKS = ("B0", "Bh", "I10", "NEAR", "CP")
BATCHES = ("S1", "S3", "S4", "S6")
SPHERE = 2650.0 * math.pi / 6.0


def rows(name: str) -> list[dict[str, str]]:
    """Rows of a file, read without the study's reader."""
    with (DATA / f"dem_{name}.csv").open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


@pytest.fixture(scope="module")
def plate() -> ScreenConfig:
    """The calibrated plate as it is shipped."""
    return ScreenConfig.load(PLATE)


def deck_error(plate: ScreenConfig, name: str) -> np.ndarray:
    """Errors of the recoveries below the aperture of a deck: another feed, motion, inclination."""
    case = next(row for row in rows("deck_cases") if row["case"] == name)
    part = [row for row in rows("deck_streams") if row["case"] == name]
    feed = np.array([float(row["feed_kg_s"]) for row in part])
    amplitude, frequency = float(case["A_m"]), float(case["f_Hz"])
    motion = Motion.linear(amplitude, frequency, math.radians(45.0))
    if case["motion"] == "circular":
        motion = Motion.circular(amplitude, frequency, "against_flow")
    # The streams are those of the simulated width; only the feed over the width counts.
    rate = feed.sum() * plate.decks[0].width / float(case["W_m"])
    config = plate.replace(feed=Feed(rate, tuple(feed / feed.sum())), motion=motion)
    config = config.with_values(
        {"deck[1].panel[1].inclination": math.radians(float(case["alpha_deg"]))}
    )
    measured = np.array([float(row["recovery"]) for row in part])
    below = np.array([float(row["size_mm"]) for row in part]) < 8.0
    return np.asarray((Screen(config).solve_steady().recovery - measured)[below])


def batch_error(plate: ScreenConfig, name: str) -> np.ndarray:
    """Errors of the recoveries below the aperture of a batch."""
    passed: dict[float, dict[float, float]] = defaultdict(dict)
    mass: dict[float, float] = {}
    for row in rows("batch_sieving"):
        if row["case"] == name:
            size = float(row["d_mm"])
            passed[float(row["time_s"])][size] = float(row["passed"])
            mass[size] = float(row["N0"]) * SPHERE * (size * 1e-3) ** 3
            stroke, frequency = float(row["A_mm"]) * 1e-3, float(row["f_Hz"])
    edges = [1e-3 * (size + side) for size in sorted(mass) for side in (-0.05, 0.05)]
    fraction = np.zeros(len(edges) - 1)
    fraction[::2] = [mass[size] for size in sorted(mass)]
    total = fraction.sum()
    config = plate.replace(
        size_classes=SizeClasses(tuple(edges), 1),
        feed=Feed(1.0, tuple(fraction / total)),
        motion=Motion.linear(stroke, frequency, 0.5 * math.pi),
    )
    recovery = Screen(config).sieve_batch(
        total / 0.11**2, config.feed.mass_fraction, times=sorted(passed)
    )
    measured = np.array(
        [[line[size] for size in sorted(mass)] for _, line in sorted(passed.items())]
    )
    below = np.array(sorted(mass)) < 8.0
    return np.asarray((recovery[:, ::2] - measured)[:, below]).ravel()


def numbers(plate: ScreenConfig) -> dict[str, float]:
    """Numbers of the plate, fitted or held, by the name of the variable."""
    held = ("damping", "lift", "stirring", "calming", "depletion", "levelling")
    names = ("velocity", "rim", "drift", "passing_time", *held)
    values = {f"passage.{name}": getattr(plate.passage, name) for name in names}
    values["segregation.velocity"] = plate.segregation.velocity
    values["segregation.relative_dilation"] = plate.segregation.relative_dilation
    return values


def rmse(errors: list[np.ndarray]) -> float:
    """Root of the mean over the cases of their mean squares."""
    return math.sqrt(np.mean([np.mean(error**2) for error in errors]))


def test_the_plate_meets_the_decks(plate: ScreenConfig) -> None:
    assert rmse([deck_error(plate, name) for name in DECKS]) <= 0.022


def test_the_plate_meets_the_batches(plate: ScreenConfig) -> None:
    assert rmse([batch_error(plate, name) for name in BATCHES]) <= 0.04


def test_undersize_of_the_deepest_deck(plate: ScreenConfig) -> None:
    """1.5 times the base feed passes no more than it does: the openings are taken up."""
    assert rmse([deck_error(plate, "B15")]) <= 0.065


def test_twice_the_base_feed(plate: ScreenConfig) -> None:
    """The data's README says about 9 kg/(m2 s) from 0.75 to 2 times the base feed."""
    assert twice_the_feed(numbers(plate)) == pytest.approx(9.0, rel=0.1)


def test_what_the_plate_says_of_a_bed_that_is_thrown(plate: ScreenConfig) -> None:
    """Lift and calming are those of the heights of the grains, not of what passes."""
    lift, calming, missed, lifted = heights()
    assert plate.passage.lift == pytest.approx(lift, rel=0.02)
    assert plate.passage.calming == pytest.approx(calming, rel=0.02)
    assert missed < 0.1 * lifted


def test_undersize_along_the_decks(plate: ScreenConfig) -> None:
    """Within two standard errors in 65 of 72 segments; a cubic for each deck has 67."""
    values, runs = numbers(plate), deck_runs()
    inside = {run.name: along.within(along.along(run, values)) for run in runs}
    assert sum(inside.values()) >= 64
    assert min(inside.values()) >= 8


def test_undersize_at_the_discharge_by_the_measured_velocity_there(plate: ScreenConfig) -> None:
    """The bed runs out over the edge: with that, nothing refitted, as many as a cubic has."""
    faster = along.run_out()
    assert 1.1 < faster < 1.3
    values = numbers(plate)
    met = sum(
        along.within(along.along(along.with_run_out(run, faster), values)) for run in deck_runs()
    )
    assert met >= 67


def test_classes_of_the_plate_have_the_spheres_as_means(plate: ScreenConfig) -> None:
    assert plate.size_classes.subdivision == 1
    np.testing.assert_allclose(
        plate.size_classes.mean, np.array([3, 4, 5, 6, 7, 7.5, 9, 12]) * 1e-3, rtol=1e-12
    )


@pytest.fixture(scope="module")
def batch() -> dict[str, float]:
    """Numbers fitted to the batches alone."""
    return fit.numbers_of(fit.batch_fit())


def test_batches_fitted_by_themselves(batch: dict[str, float], plate: ScreenConfig) -> None:
    assert len(batch) <= 6
    alone = plate.with_values({**batch, "passage.drift": 0.0})
    assert rmse([batch_error(alone, name) for name in BATCHES]) <= 0.04
    held = fit.by_run(fit.batch_fit())["left out"]
    assert rmse([held.to_numpy()]) <= 0.05


def test_segregation_by_the_constants_of_the_batches(batch: dict[str, float]) -> None:
    """Growth of the height gap within 25 %."""
    grown = growth(tuple(batch.items()))
    for name in ("G1", "G2"):
        assert abs(grown["modelled"][name] / grown["measured"][name] - 1.0) <= 0.25


def test_sections_name_what_they_show(tmp_path: Path) -> None:
    """The batch section links pictures that it draws."""
    text = write_batches(tmp_path)
    assert "(dem_batch.png)" in text
    assert (tmp_path / "dem_batch.png").stat().st_size > 10_000
