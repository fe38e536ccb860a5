"""The closed circuit: against the linear system with an ideal screen, then with the screen FMU."""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from closed_circuit import CIRCUIT, SCHEDULE, answer, main, run
from components.regimes import Circuit, Regime
from components.screen_fmu import RefusedStepError, ScreenFmu, ScreenStep
from components.stream import Rates
from tests.places import ROOT
from vibroscreen.circuit import Conveyor, Crusher, solve_circuit_many
from vibroscreen.config import ScreenConfig
from vibroscreen.sizing_rules import Rules
from vibroscreen.stream import Feed
from vibroscreen.units import KW, KWH_T, MINUTE, MM, PERCENT, T_H

EDGES = np.array([0, 1, 2, 4, 5.6, 8, 11.2, 16, 22.4, 31.5, 45, 63, 75]) * MM


class PartitionScreen:
    """A screen without hold-up that sends a fixed share of each class to the oversize."""

    def __init__(self, edges: Rates, to_oversize: Rates) -> None:
        """`to_oversize`: one share per class, 1."""
        self.edges = edges
        self.to_oversize = to_oversize
        self.hold_up = 0.0

    def step(self, feed: Rates, frequency: float, step: float) -> ScreenStep:
        """Split the feed at once; neither frequency nor time matter."""
        oversize = feed * self.to_oversize
        return ScreenStep(feed - oversize, oversize, power=0.0)


CRUSHER, BELT = CIRCUIT.unit["crusher"], CIRCUIT.unit["belt"]
assert isinstance(CRUSHER, Crusher)
assert isinstance(BELT, Conveyor)
TRANSFER = CRUSHER.transfers(EDGES, {})["product"][0]
FRESH = np.array(CIRCUIT.feeds[0].mass_fraction)
IDEAL = np.where(EDGES[1:] <= 16 * MM, 0.0, 1.0)  # cuts at 16 mm without error
BLUNT = np.clip(EDGES[1:] / (20 * MM), 0.05, 1.0)  # leaves undersize in the oversize


@pytest.mark.parametrize("to_oversize", [IDEAL, BLUNT], ids=["ideal", "blunt"])
def test_circulating_load_is_that_of_the_linear_system(to_oversize: Rates) -> None:
    """Oversize o = S T (f + o), T the crusher, S the screen: o = (I - S T)^-1 S T f."""
    loop = to_oversize[:, None] * TRANSFER
    fresh = FRESH
    expected = np.linalg.solve(np.eye(fresh.size) - loop, loop @ fresh).sum()
    schedule = (Regime("one", 300 * T_H, 15.5, 100 * BELT.delay),)
    circuit = run(PartitionScreen(EDGES, to_oversize), schedule, step=8.0)
    regime = circuit.regimes.iloc[0]
    assert regime["circulating load, %"] == pytest.approx(100 * expected, rel=1e-9)
    assert regime["product, t/h"] == pytest.approx(300, rel=1e-9)
    assert regime["crusher feed, t/h"] == pytest.approx(300 * (1 + expected), rel=1e-9)
    assert abs(circuit.balance_error) < 1e-12 * circuit.fed


def test_each_turn_takes_the_delay() -> None:
    """In turn n the product is (I - S) T sum over k <= n of (S T)^k f: stairs of 40 s."""
    fresh = 300 * T_H * FRESH
    circuit = run(PartitionScreen(EDGES, IDEAL), (Regime("one", 300 * T_H, 15.5, 160.0),))
    returned, stairs = np.zeros(fresh.size), []
    for _ in range(4):
        screened = TRANSFER @ (fresh + returned)
        returned = screened * IDEAL
        stairs.append((screened - returned).sum())
    assert_allclose(circuit.history["product"], np.repeat(stairs, 40), rtol=1e-12)


def test_the_balance_holds_while_the_circuit_fills_and_changes() -> None:
    """Three regimes, cut off in mid-flight: fed = product + held to round-off."""
    schedule = tuple(Regime(f"{q} t/h", q * T_H, 15.5, 100.0) for q in (300.0, 0.0, 500.0))
    circuit = run(PartitionScreen(EDGES, BLUNT), schedule, step=0.7)
    assert circuit.history["held"].iloc[-1] > 1000.0
    assert abs(circuit.balance_error) < 1e-12 * circuit.fed


def test_the_answer_follows_from_the_regimes() -> None:
    """The answer says yes or no to both questions, with the numbers."""
    schedule = tuple(Regime(name, 300 * T_H, 15.5, 3 * MINUTE) for name in "abc")
    circuit = run(PartitionScreen(EDGES, IDEAL), schedule, step=5.0)
    circuit.regimes[:] = 1.0
    circuit.regimes.loc["b", ["fresh feed, t/h", "product, t/h"]] = 360.0, 359.0
    circuit.regimes["circulating load, %"] = 30.0, 40.0, 50.0
    circuit.regimes["crusher, kW"] = 300.0, 360.0, 370.0
    circuit.regimes["screen, kW"] = 12.0, 14.0, 10.0
    circuit.regimes["energy, kWh/t of product"] = 1.040, 1.039, 1.056
    assert answer(circuit.regimes) == (
        "Yes: fed 360 t/h it makes 359 t/h, the circulating load goes from 30 to 40 %. "
        "The slower screen saves no energy: it draws 4.0 kW less, the crusher 10.0 kW more at a "
        "load of 50 %, from 1.039 to 1.056 kWh/t."
    )
    circuit.regimes.loc["b", "product, t/h"] = 300.0
    circuit.regimes.loc["c", "energy, kWh/t of product"] = 1.0
    last = answer(circuit.regimes)
    assert last.startswith("No: fed 360 t/h it makes 300 t/h")
    assert "The slower screen saves energy: it draws" in last


def test_regimes_need_names_of_their_own() -> None:
    """Two regimes of one name could not be told apart in the table."""
    regime = Regime("same", 300 * T_H, 15.5)
    with pytest.raises(ValueError, match="schedule names two regimes alike"):
        run(PartitionScreen(EDGES, IDEAL), (regime, regime))


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> tuple[Circuit, Path]:
    """The example as the README runs it: builds the FMU, runs, draws; and the folder it used."""
    folder = tmp_path_factory.mktemp("circuit")
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        circuit = main(fmu=folder / "VibratingScreen.fmu", output=folder / "circuit.png")
    assert printed.getvalue().splitlines()[-1] == answer(circuit.regimes)
    return circuit, folder


def test_example_builds_and_draws(example: tuple[Circuit, Path]) -> None:
    """The FMU that was missing is there, and so is the picture."""
    _, folder = example
    assert (folder / "VibratingScreen.fmu").is_file()
    assert (folder / "circuit.png").stat().st_size > 20_000


def test_example_closes_its_balance(example: tuple[Circuit, Path]) -> None:
    """Fed = product + held to round-off over the whole run; what is fed is what was scheduled."""
    circuit, _ = example
    assert circuit.fed == pytest.approx(sum(r.fresh_feed * r.duration for r in SCHEDULE), rel=1e-12)
    assert abs(circuit.balance_error) < 1e-12 * circuit.fed


def test_example_reaches_steady_states(example: tuple[Circuit, Path]) -> None:
    """At the end of each regime product = fresh feed within 0.1 %, and it settled in 10 of 15 min.

    No alarm but that of a screen whose oversize has not come yet.
    """
    circuit, _ = example
    regimes = circuit.regimes
    assert_allclose(regimes["product, t/h"], regimes["fresh feed, t/h"], rtol=1e-3)
    assert_allclose(
        regimes["crusher feed, t/h"],
        regimes["fresh feed, t/h"] + regimes["oversize, t/h"],
        rtol=1e-3,
    )
    assert regimes["settled after, min"].max() < 10.0
    assert set(circuit.alarms) <= {"alarm.performance"}
    assert all(time < MINUTE for time in circuit.alarms.values())


def test_example_agrees_with_the_steady_circuit(example: tuple[Circuit, Path]) -> None:
    """The end of each regime is the fixed point of crusher and steady screen, within 0.5 %.

    The circuit is solved by `solve_circuit_many` here: no FMU, no conveyor, no time.
    """
    circuit, _ = example
    values = {
        "fresh.mass_flow_rate": np.array([regime.fresh_feed for regime in SCHEDULE]),
        "screen.motion.frequency": np.array([regime.frequency for regime in SCHEDULE]),
    }
    expected = solve_circuit_many(CIRCUIT, values).circulating_load
    assert_allclose(circuit.regimes["circulating load, %"] * PERCENT, expected, rtol=5e-3)


def load_by_rules(fresh_feed: float, rule: str) -> float:
    """Circulating load [1] of the circuit at a fresh feed [kg/s] with a sizing rule as the screen.

    VSMA tells one recovery of all undersize, Karra that of each class.
    """
    config = ScreenConfig.default()
    edges, (fed,) = np.array(config.size_classes.edges), CIRCUIT.feeds
    crusher, fresh = CIRCUIT.unit["crusher"], fresh_feed * np.array(fed.mass_fraction)
    assert isinstance(crusher, Crusher)
    oversize = np.zeros(fresh.size)
    for _ in range(25):
        crushed = crusher.crush(edges, fresh + oversize)
        feed = Feed(crushed.sum(), tuple(crushed / crushed.sum()))
        says = Rules(config.replace(feed=feed), feed.mass_flow_rate)
        recovery = says.class_recovery if rule == "Karra" else says.vsma_recovery
        oversize = crushed * np.where(edges[1:] <= 1.0001 * says.aperture, 1.0 - recovery, 1.0)
    return float(oversize.sum() / fresh.sum())


def test_example_headline(example: tuple[Circuit, Path]) -> None:
    """The circulating load lies between those with VSMA's and with Karra's screen; README says it.

    A slower screen recovers less; the crusher then works more.
    """
    regimes = example[0].regimes
    load = regimes["circulating load, %"]
    for regime, found in zip(SCHEDULE[:2], load, strict=False):
        vsma, karra = (load_by_rules(regime.fresh_feed, rule) for rule in ("VSMA", "Karra"))
        assert vsma < found * PERCENT < karra
    assert load.iloc[2] > load.iloc[1]
    more, slow = regimes.iloc[1], regimes.iloc[2]
    saved, spent = (
        more["screen, kW"] - slow["screen, kW"],
        slow["crusher, kW"] - more["crusher, kW"],
    )
    assert saved > 0.0 < spent
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"the circulating load goes from {load.iloc[0]:.0f} to {load.iloc[1]:.0f} %" in text
    assert f"the screen draws {saved:.1f} kW less, the crusher {spent:.1f} kW more" in text


def test_energy_by_hand(example: tuple[Circuit, Path]) -> None:
    """Energy per tonne is both powers over the product."""
    regime = example[0].regimes.iloc[0]
    power = (regime["crusher, kW"] + regime["screen, kW"]) * KW
    energy = power / (regime["product, t/h"] * T_H) / KWH_T
    assert regime["energy, kWh/t of product"] == pytest.approx(energy, rel=1e-12)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda feed: -feed, "= -12 kg/s is "),
        (lambda feed: np.nan * feed, "= nan kg/s is not"),
    ],
    ids=["negative feed", "not a number"],
)
def test_a_refused_step_says_why_and_cleans_up(
    example: tuple[Circuit, Path],
    spoil: Callable[[Rates], Rates],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The FMU refuses the step, the unzipped folder goes, and the next instance runs."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    fmu = example[1] / "VibratingScreen.fmu"

    def spoil_a_running_screen() -> None:
        with ScreenFmu(fmu) as screen:
            feed = np.ones(screen.edges.size - 1)
            screen.step(feed, 15.5, 1.0)
            assert len(list(tmp_path.iterdir())) == 1
            screen.step(spoil(feed), 15.5, 1.0)

    message = rf"^step of 1 s at 1 s refused: feed\.mass_flow_rate {words}"
    with pytest.raises(RefusedStepError, match=message):
        spoil_a_running_screen()
    assert not list(tmp_path.iterdir())
    with ScreenFmu(fmu) as screen:
        step = screen.step(np.ones(screen.edges.size - 1), 15.5, 1.0)
    assert step.undersize.sum() > 0.0
