"""Where the engine breaks: a stress map of extreme scenes, and a soak of a million random steps.

    python tests/benchmarks/stability.py [--quick] [--soak STEPS] [--output DIR]

Every row of the map is a family of scenes that stretches one thing to its limits; a cell is the
worst of the family:
  balance     error of the mass of a class, as a part of what was fed of it (limit 1e-12);
  negative    most negative number among loads, streams and their sums, as a part of the largest
              (limit 0);
  reference   difference of the recovery of a class in the steady state to that at a tolerance of
              1e-8 with the same nodes, in units of the tolerance (limit 1);
  forced      steps taken although their error was too large, as a part of all;
  rates       how often the rates of a column were evaluated, in the dearest scene.
The soak changes feed, composition, motion and step at random, zeros among them, and looks at every
number of the state after every step. Prints both, writes stability.json and stability.png. The map
takes about a minute and a million steps four to nine on one core, compiling apart.
"""

from __future__ import annotations

import argparse
import platform
import resource
import sys
import time
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import matplotlib.pyplot as plt
import numpy as np
from numba import njit
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from tests.benchmarks.output import write_json
from vibroscreen import Feed, InputError, Screen, ScreenConfig
from vibroscreen.kernels import state
from vibroscreen.sections import (
    COARSEST,
    FINEST,
    MOST_OPEN,
    Bed,
    Deck,
    Displacement,
    Panel,
    Passage,
    Segregation,
    Solver,
)
from vibroscreen.size_classes import SizeClasses
from vibroscreen.stream import MOST_FED
from vibroscreen.units import DEG, MM

Row = dict[str, Any]

MODELS = ("well_mixed", "proportional", "exchange", "classified")
LAWS = ("gaudin", "pelevin")
EDGES = (0.0, 0.004, 0.008, 0.0125, 0.016, 0.022, 0.045)
DUTY = 80.0  # kg/s
REFERENCE = 1e-8
CLOSURE = 1e-12

# Fields that may never hold a negative number.
POSITIVE = (
    "load",
    "length",
    "lead",
    "lead_passed",
    "partial",
    "held",
    "reference",
    "step_mass",
    "class_mass",
    "undersize_fraction",
    "oversize_fraction",
    "intermediate_fraction",
)
FINITE = (*POSITIVE, "output", "intermediate", "deck_result", "ledger", "carry", "deck", "pace")


# --- scenes --------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Step:
    """A communication step of dt s; what is None stays as it was."""

    dt: float
    feed: float | None = None
    velocity: float | None = None
    frequency: float | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A screen and what happens to it."""

    config: ScreenConfig
    steps: tuple[Step, ...]


def even(count: int) -> tuple[float, ...]:
    """The same of every class."""
    return (1.0 / count,) * count


def only(count: int, place: int) -> tuple[float, ...]:
    """All mass in one class."""
    return tuple(1.0 if k == place else 0.0 for k in range(count))


def deck_of(*apertures: float, open_area: float = 0.55, factors: Sequence[float] = ()) -> Deck:
    """A deck of 6 m with a panel for every aperture [m]."""
    speeds = factors or (1.0,) * len(apertures)
    length = 6.0 / len(apertures)
    panels = (
        Panel(length, 5.0 * DEG, aperture, open_area, speed)
        for aperture, speed in zip(apertures, speeds, strict=True)
    )
    return Deck(2.4, tuple(panels))


def screen(
    edges: Sequence[float] = EDGES,
    *decks: Deck,
    fraction: Sequence[float] = (),
    feed: float = DUTY,
    law: str = "pelevin",
    u: float = 0.1,
    model: str = "exchange",
    w: float = 0.1,
    dilation: float = 1.0 * MM,
    mixing: float = 0.0,
    bed: Bed | None = None,
    velocity: float = 0.3,
    tolerance: float = 1e-4,
) -> ScreenConfig:
    """A screen with one node a class, so that the nodes are those of any tolerance."""
    return ScreenConfig(
        SizeClasses(tuple(edges), subdivision=1),
        decks=decks or (deck_of(16.0 * MM),),
        displacement=Displacement("prescribed", velocity),
        passage=Passage(law, velocity=u),
        segregation=Segregation(model, w, dilation, mixing=mixing),
        bed=bed or Bed(contact_depth=20.0 * MM, layers=16),
        solver=Solver(tolerance),
        feed=Feed(feed, tuple(fraction) or even(len(edges) - 1)),
    )


ON_OFF = tuple(Step(1.0, DUTY * (k % 2)) for k in range(24))
GO_ON = (Step(0.01), Step(1.0), Step(7.0), Step(30.0), Step(1.0))
STOP_AND_GO = (
    *(
        Step(dt, feed, velocity, frequency)
        for velocity, frequency in ((0.3, 15.5), (0.0, 15.5), (1e-7, 15.5), (0.3, 0.0), (0.3, 15.5))
        for dt, feed in ((1.0, DUTY), (10.0, None), (0.05, 0.0), (10.0, DUTY))
    ),
    Step(60.0, 0.0),
    Step(1.0),
)


def of_steps() -> Iterator[Scene]:
    for model in MODELS:
        for dt in (1e-3, 1e-2, 0.1, 1.0, 10.0, 60.0, 600.0, 36_000.0):
            yield Scene(screen(model=model), tuple(Step(dt, DUTY * (k % 2)) for k in range(12)))
        mixed = (36_000.0, 1e-3, 60.0, 1e-3, 36_000.0, 0.5)
        yield Scene(screen(model=model), tuple(Step(dt, DUTY + k) for k, dt in enumerate(mixed)))


def of_feeds() -> Iterator[Scene]:
    for model in MODELS:
        for feed in (1e-9, 1e-6, 1e-3, 1.0, 100.0, 1e3, MOST_FED):
            ramp = tuple(Step(2.0, feed * (1 + k % 3) / 3) for k in range(12))
            yield Scene(screen(model=model, feed=feed), (*ramp, Step(3600.0), Step(30.0, 0.0)))
        jumps = (MOST_FED, 1e-9, 0.0, 1e-9, MOST_FED, 0.0, 80.0, 1e-6, 80.0)
        yield Scene(screen(model=model), tuple(Step(2.0, feed) for feed in jumps))


def of_models() -> Iterator[Scene]:
    for model in MODELS:
        for law in LAWS:
            for tolerance in (1e-2, 1e-4):
                yield Scene(screen(model=model, law=law, tolerance=tolerance), ON_OFF)


def of_sizes() -> Iterator[Scene]:
    wide = np.geomspace(1e-6, 1.0, 13)
    for model in MODELS:
        for aperture in (FINEST, 1e-3, 0.016, 0.3):
            yield Scene(screen(wide, deck_of(aperture), model=model), ON_OFF)
        yield Scene(screen(np.geomspace(1e-6, 1e-4, 7), deck_of(FINEST), model=model), ON_OFF)


def of_classes() -> Iterator[Scene]:
    for model in MODELS:
        for count in (1, 2, 3, 5, 40, 200):
            edges = np.linspace(0.0, 0.045, count + 1)
            yield Scene(screen(edges, model=model), ON_OFF[: 24 if count < 40 else 6])


def of_open_areas() -> Iterator[Scene]:
    for law in LAWS:
        for open_area in (0.0, 1e-6, 1e-3, 0.1, MOST_OPEN):
            yield Scene(screen(EDGES, deck_of(0.016, open_area=open_area), law=law), ON_OFF)


def of_passage() -> Iterator[Scene]:
    for model in MODELS:
        for u in (0.0, 1e-9, 1e-3, 1.0, 10.0, 100.0):
            yield Scene(screen(model=model, u=u), ON_OFF)


def of_percolation() -> Iterator[Scene]:
    for w in (0.0, 1e-9, 1e-3, 1.0, 10.0, 100.0):
        for dilation in (0.0, 1e-6, 1e-3, 0.1, MOST_OPEN):
            yield Scene(screen(w=w, dilation=dilation), ON_OFF)


def of_instant() -> Iterator[Scene]:
    for law in LAWS:
        for u in (0.0, 10.0, 100.0):
            for w in (10.0, 100.0):
                for tolerance in (1e-2, 1e-4):
                    config = screen(law=law, u=u, w=w, dilation=1.0, tolerance=tolerance)
                    yield Scene(config, ON_OFF)


def of_switches() -> Iterator[Scene]:
    """Rates around those at which a scheme hands over to the next."""
    for model in ("well_mixed", "exchange"):
        for u in np.geomspace(0.02, 60.0, 20):
            yield Scene(screen(model=model, u=float(u)), GO_ON)
    for w in np.geomspace(0.02, 100.0, 20):
        yield Scene(screen(w=float(w), dilation=0.05), GO_ON)


def of_layers() -> Iterator[Scene]:
    for layers, contact, layer in (
        (2, 0.02, 0.02),
        (2, 0.02, 1e-4),
        (16, 0.02, 1e-3),
        (100, 0.02, 1e-3),
        (500, 5e-3, 2.5e-4),
        (16, 1e-4, 5.0),
        (16, 5.0, 1e-4),
        (16, 1e-4, 0.01),
    ):
        steps = ON_OFF if layers < 100 else ON_OFF[:4]
        yield Scene(screen(bed=Bed(contact, layer, layers=layers)), steps)


def of_thin_beds() -> Iterator[Scene]:
    full = 0.3 * 2.4 * 1600.0 * 0.02  # kg/s that fill the contact layer
    for model in MODELS:
        for part in (1e-6, 0.1, 0.999, 1.0, 1.0 + 1e-9, 1.001, 1.999, 2.0, 2.001):
            ramp = tuple(Step(1.0, full * part * (k % 4 != 3)) for k in range(16))
            yield Scene(screen(model=model, feed=full * part), ramp)


def of_velocities() -> Iterator[Scene]:
    for model in MODELS:
        yield Scene(screen(model=model), STOP_AND_GO)
        for velocity in (1e-3, 20.0):
            yield Scene(screen(model=model, velocity=velocity), GO_ON)


def of_abysses() -> Iterator[Scene]:
    """A bed of 20 km: its contact layer holds less of it than the tolerance, and is renewed 1e7
    times. The estimate of the implicit scheme cannot see what passes through it."""
    for model in MODELS:
        yield Scene(screen(model=model, velocity=1e-6), GO_ON)


def of_single_classes() -> Iterator[Scene]:
    for model in MODELS:
        for place in range(len(EDGES) - 1):
            config = screen(model=model, fraction=only(len(EDGES) - 1, place))
            yield Scene(config, ON_OFF)


def of_narrow_classes() -> Iterator[Scene]:
    for model in MODELS:
        for size in (0.01, 0.016):
            edges = size * (1.0 + 1e-9 * np.arange(7.0))
            yield Scene(screen(edges, model=model), ON_OFF)


def of_apertures() -> Iterator[Scene]:
    for model in MODELS:
        for law in LAWS:
            for aperture in (FINEST, 0.001, 0.0199999, 0.045, 0.046, COARSEST):
                yield Scene(screen(EDGES, deck_of(aperture), model=model, law=law), ON_OFF)


def of_decks() -> Iterator[Scene]:
    decks = (deck_of(0.022, 0.016, factors=(1.0, 0.7)), deck_of(0.008, 0.0125, 0.004))
    for model in MODELS:
        for law in LAWS:
            yield Scene(screen(EDGES, *decks, model=model, law=law), ON_OFF[:12])
        yield Scene(screen(EDGES, *decks, model=model), GO_ON)
        yield Scene(screen(EDGES, *decks, model=model), STOP_AND_GO)


def of_tolerances() -> Iterator[Scene]:
    for model in MODELS:
        for tolerance in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
            yield Scene(screen(model=model, tolerance=tolerance), ON_OFF[:8])


FAMILIES: dict[str, Callable[[], Iterator[Scene]]] = {
    "steps of 1 ms to 10 h": of_steps,
    "feeds of 1e-9 to 5e3 kg/s": of_feeds,
    "feed on and off, all models": of_models,
    "sizes from 1 um to 1 m": of_sizes,
    "1 to 200 classes": of_classes,
    "open area 0 to 1": of_open_areas,
    "u from 0 to 100 m/s": of_passage,
    "w to 100 m/s, dilation to 1 m": of_percolation,
    "all at once: u, w, dilation": of_instant,
    "where a scheme hands over": of_switches,
    "2 to 500 layers, thin and thick": of_layers,
    "beds of part of a layer": of_thin_beds,
    "stop, creep and go": of_velocities,
    "a bed of 20 km, v = 1 um/s": of_abysses,
    "all mass in one class": of_single_classes,
    "sizes equal to 1e-9": of_narrow_classes,
    "apertures below and above all": of_apertures,
    "two decks with panels": of_decks,
    "tolerances 1e-2 to 1e-6": of_tolerances,
}


DEAR = ("a bed of 20 km, v = 1 um/s",)  # not in a quick run


# --- what is measured ----------------------------------------------------------------------------
def worst_balance(screen: Screen) -> float:
    """Largest balance error of a class, as a part of what came in of it."""
    balance = screen.balance()
    came = (balance.fed + balance.initial).to_numpy()
    error = np.abs(balance.error.to_numpy())
    return float(np.max(np.divide(error, came, out=error.copy(), where=came > 0.0)))


def worst_negative(screen: Screen) -> float:
    """Most negative number of the state, as a part of the largest of its field."""
    worst = 0.0
    for name in POSITIVE:
        field = screen.view(name)
        if field.size and field.min() < 0.0:
            worst = max(worst, float(-field.min() / np.abs(field).max()))
    return worst


def broken(screen: Screen) -> list[str]:
    """Fields that hold a number that is not finite."""
    return [name for name in FINITE if not np.isfinite(screen.view(name)).all()]


def put(screen: Screen, step: Step) -> None:
    """Write the inputs of a step."""
    inputs = screen.record("input")
    for name, value in (
        ("feed_mass_flow_rate", step.feed),
        ("displacement_velocity", step.velocity),
        ("motion_frequency", step.frequency),
    ):
        if value is not None:
            setattr(inputs, name, value)


def from_reference(screen: Screen) -> float:
    """Difference of the steady recovery to that at a tolerance of 1e-8, in tolerances."""
    parameter = screen.record("parameter")
    tolerance = float(parameter.solver_tolerance)
    ours = screen.solve_steady().recovery
    parameter.solver_tolerance = REFERENCE
    reference = screen.solve_steady().recovery
    parameter.solver_tolerance = tolerance
    return float(np.abs(ours - reference).max() / tolerance)


def measure(scene: Scene) -> Row:
    """Run a scene; what it shows."""
    screen = Screen(scene.config)
    row: Row = {"balance": 0.0, "negative": 0.0, "reference": from_reference(screen)}
    for step in scene.steps:
        put(screen, step)
        screen.advance(step.dt)
        row["negative"] = max(row["negative"], worst_negative(screen))
        row["balance"] = max(row["balance"], worst_balance(screen))
        if names := broken(screen):
            raise ArithmeticError(f"not finite after {step}: {names}")
    counters = screen.counters()
    row["forced"] = counters["column_steps_forced"] / max(1, counters["column_steps"])
    row["rates"] = counters["rates"] + counters["sub_steps"]
    return row


def stress(family: Sequence[Scene], tick: Callable[[], None]) -> Row:
    """The worst of a family, column by column."""
    row: Row = {"scenes": len(family)}
    for scene in family:
        for name, value in measure(scene).items():
            row[name] = max(row.get(name, 0.0), value)
        tick()
    return row


def refusals() -> dict[str, str]:
    """What becomes of beds that would convey upwards."""
    prescribed = Screen(screen())
    prescribed.record("input").displacement_velocity = -0.1
    try:
        prescribed.advance(1.0)
        said = "accepted"
    except InputError as error:
        said = f"refused: {error}"
    rigid = Screen(screen().replace(displacement=Displacement("rigid_body")))
    rigid.record("input").motion_throw_angle = 135.0 * DEG
    rigid.advance(10.0)
    result = rigid.result()
    return {
        "prescribed velocity of -0.1 m/s": said,
        "rigid body thrown upwards": (
            f"v = {result.transport_velocity:g} m/s, {', '.join(result.alarms)}, "
            f"{result.hold_up:g} kg held of {10.0 * DUTY:g} kg fed, "
            f"{worst_balance(rigid):.0e} off"
        ),
    }


# --- soak ----------------------------------------------------------------------------------------
@njit(error_model="numpy")
def look_through(buffer, starts, stops, may_be_negative):
    """Least number of the fields that may not be negative; NaN if any number is not finite."""
    least = 0.0
    for k in range(starts.size):
        for i in range(starts[k], stops[k]):
            value = buffer[i]
            if not np.isfinite(value):
                return np.nan
            if value < least and not may_be_negative[k]:
                least = value
    return least


BLOCK = 10_000  # random steps that are drawn at once


class Soak:
    """A cheap screen through random steps: feed, composition, motion and dt change, also to 0."""

    def __init__(self, seed: int = 7) -> None:
        base = screen(
            (0.0, 0.008, 0.016, 0.045), bed=Bed(0.02, layers=4), tolerance=1e-2, velocity=0.3
        )
        self.screen = Screen(
            base.replace(
                solver=Solver(1e-2, packages=68),
                displacement=Displacement("rigid_body"),
            )
        )
        self.rng = np.random.default_rng(seed)
        layout = self.screen.layout
        offset = [layout.offset[name] for name in FINITE]
        size = [int(np.prod(layout.shape[name])) for name in FINITE]
        self.starts = np.array(offset)
        self.stops = self.starts + np.array(size)
        self.signed = np.array([name not in POSITIVE for name in FINITE])

    def draw(self, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Inputs, fractions and lengths of random steps. A setting holds for a few of them."""
        rng = self.rng

        def held(values: np.ndarray, chance: float) -> np.ndarray:
            new = rng.random(count) < chance
            new[0] = True
            return values[np.maximum.accumulate(np.where(new, np.arange(count), 0))]

        feed = held(
            rng.choice([0.0, 0.0, 1e-9, 600.0, 1.0], count)
            + rng.choice([0.0, 1.0], count) * rng.uniform(0.0, 150.0, count),
            0.4,
        )
        frequency = held(rng.choice([0.0, 15.5, 18.0, 12.0], count, p=[0.1, 0.5, 0.2, 0.2]), 0.1)
        amplitude = held(rng.choice([0.0, 3e-3, 5e-3, 7e-3], count, p=[0.1, 0.3, 0.3, 0.3]), 0.1)
        inputs = np.tile(self.screen.view("input"), (count, 1))
        for name, drawn in (
            ("feed_mass_flow_rate", feed),
            ("motion_frequency", frequency),
            ("motion_amplitude", amplitude),
        ):
            inputs[:, state.INPUT.index(name)] = drawn
        share = rng.random((count, 3)) * (rng.random((count, 3)) < 0.8)
        share[np.arange(count), rng.integers(3, size=count)] += 0.1
        fraction = held(share / share.sum(axis=1, keepdims=True), 0.3)
        longest = np.where(rng.random(count) < 0.02, 3.0, 0.5)  # log10 of s
        return inputs, fraction, 10.0 ** rng.uniform(-3.0, longest)

    def run(self, count: int) -> float:
        """So many steps; returns the least number seen, raises for one that is not finite."""
        screen, buffer = self.screen, self.screen.buffer
        inputs, fraction = screen.view("input"), screen.view("fraction")
        values, shares, lengths = self.draw(count)
        least = 0.0
        for k in range(count):
            inputs[:] = values[k]
            fraction[:] = shares[k]
            screen.advance(lengths[k])
            seen = look_through(buffer, self.starts, self.stops, self.signed)
            if not seen >= least:
                if np.isnan(seen):
                    raise ArithmeticError(f"not finite: {broken(screen)}")
                least = seen
        return least


def resident_mb() -> float:
    """Memory of this process now, MB."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 2**20
    except OSError:  # no /proc: the most that it ever was
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10


def soak(steps: int, tick: Callable[[int], None]) -> Row:
    """Random steps in blocks; what they show."""
    bath = Soak()
    book = bath.screen.record("deck")[0]
    row: Row = {"steps": steps, "balance": 0.0, "negative": 0.0, "packages": 0}
    done, start, traced = 0, time.perf_counter(), []
    while done < steps:
        block = min(BLOCK, steps - done)
        last = steps - done <= BLOCK
        if last:  # Python's own memory, in the last block only: tracing costs time
            tracemalloc.start()
            bath.run(block // 2)
            traced.append(tracemalloc.get_traced_memory()[0])
            row["negative"] = min(row["negative"], bath.run(block - block // 2))
            traced.append(tracemalloc.get_traced_memory()[0])
            tracemalloc.stop()
        else:
            row["negative"] = min(row["negative"], bath.run(block))
        done += block
        row["balance"] = max(row["balance"], worst_balance(bath.screen))
        row["packages"] = max(row["packages"], int(book.packages + book.cells))
        row.setdefault("resident_mb_first", resident_mb())
        tick(block)
    row["seconds"] = time.perf_counter() - start
    row["resident_mb_grown"] = resident_mb() - row["resident_mb_first"]
    row["traced_bytes_grown"] = traced[1] - traced[0]
    row["room"] = bath.screen.layout.dimension["packages"]
    row["fed_t"] = float(bath.screen.balance().fed.sum() / 1e3)
    row["counters"] = bath.screen.counters()
    return row


# --- report --------------------------------------------------------------------------------------
COLUMNS = ("balance", "negative", "reference", "forced", "rates")


def print_map(rows: dict[str, Row]) -> None:
    """The table."""
    head = "".join(f"{name:>12}" for name in ("scenes", *COLUMNS))
    print(f"{'worst of a family':<34}{head}")
    for name, row in rows.items():
        cells = f"{row['scenes']:>12}{row['balance']:>12.1e}{row['negative']:>12.1e}"
        print(f"{name:<34}{cells}{row['reference']:>12.2g}{row['forced']:>12.1e}{row['rates']:>12}")


def print_soak(row: Row) -> None:
    """Figures of the soak."""
    print(
        f"\nsoak: {row['steps']} steps, {row['fed_t']:.4g} t fed, in {row['seconds']:.0f} s "
        f"({1e6 * row['seconds'] / row['steps']:.0f} us a step)\n"
        f"  balance {row['balance']:.1e} of what was fed of a class, least number "
        f"{row['negative']:g}, all finite\n"
        f"  packages at most {row['packages']} in room for {row['room']}, memory grew by "
        f"{row['resident_mb_grown']:.1f} MB (Python's own {row['traced_bytes_grown']} bytes)"
    )


def draw(rows: dict[str, Row], path: Path) -> None:
    """The map in colours: decades above (red) or below (blue) the limit; rates in decades."""
    limits = {"balance": CLOSURE, "negative": 1e-30, "reference": 1.0, "forced": 1e-2, "rates": 1e9}
    figure, axis = plt.subplots(figsize=(9, 0.36 * len(rows) + 1.4), layout="constrained")
    shade = np.array(
        [[np.log10(max(row[c], 1e-30) / limits[c]) for c in COLUMNS] for row in rows.values()]
    )
    axis.imshow(np.clip(shade, -6, 6), cmap="RdBu_r", vmin=-6, vmax=6, aspect="auto")
    for y, row in enumerate(rows.values()):
        for x, column in enumerate(COLUMNS):
            axis.text(x, y, f"{row[column]:.2g}", ha="center", va="center", fontsize=9)
    axis.set_xticks(range(len(COLUMNS)), COLUMNS)
    axis.set_yticks(range(len(rows)), list(rows), fontsize=9)
    axis.xaxis.tick_top()
    axis.set_xlabel("red: beyond its limit; blue: below it")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(
    output: Path | None = None, *, quick: bool = False, steps: int = 1_000_000
) -> dict[str, Any]:
    """Run the map and the soak, print, and write into `output` if it is given."""
    every = 7 if quick else 1
    families = {
        name: list(make())[::every]
        for name, make in FAMILIES.items()
        if not (quick and name in DEAR)
    }
    if quick:
        steps = min(steps, 2_000)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    rows: dict[str, Row] = {}
    with Progress(*columns, console=Console(stderr=True)) as progress:
        bar = progress.add_task("map", total=sum(len(family) for family in families.values()))
        for name, family in families.items():
            progress.update(bar, description=name)
            rows[name] = stress(family, lambda: progress.advance(bar))
        bath = progress.add_task("soak", total=steps)
        soaked = soak(steps, lambda count: progress.advance(bath, count))
    print_map(rows)
    said = refusals()
    print()
    for name, text in said.items():
        print(f"{name}: {text}")
    print_soak(soaked)
    result: dict[str, Any] = {
        "machine": platform.processor() or platform.machine(),
        "python": platform.python_version(),
        "quick": quick,
        "map": rows,
        "refusals": said,
        "soak": soaked,
    }
    if output is not None:
        write_json(output, "stability", result)
        draw(rows, output / "stability.png")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    parser.add_argument("--quick", action="store_true", help="every seventh scene, a short soak")
    parser.add_argument("--soak", type=int, default=1_000_000, help="random steps of the soak")
    arguments = parser.parse_args()
    main(arguments.output, quick=arguments.quick, steps=arguments.soak)
