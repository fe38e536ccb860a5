"""What a step costs, what a steady solution costs, how cost grows, and what every skip saves.

    python tests/benchmarks/step_cost.py [--repeat N] [--output DIR] [--quick]

Tables, with ratios:
  steps of 1 s of four screens: steady, after a change of the feed, and with frequency, feed or
      everything changing every step (motion, feed, and what is tunable of passage and segregation);
  steady solutions over the tolerance: nodes, true error (against 24 nodes a piece of a class and a
      tolerance of 1e-9), time of the bare engine (same motion; new motion) and of `solve_steady`;
  cost over the number of classes, layers and packages, with fitted slopes of log over log;
  every skip on and off in a scene where it matters, with its counter;
  the same step through the engine's door, the Python object, and the FMU (raw and by fmpy);
  the native runtime, driven by a program in C: an instance, a step, a day of plant time;
  targets, met or not.

Times are medians of processor time of this thread; what is compared takes turns. Writes
step_cost.json and step_cost.png.
"""

from __future__ import annotations

import argparse
import ctypes
import dataclasses
import platform
import shutil
import statistics
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import matplotlib.pyplot as plt
import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from build_fmu import build
from tests.benchmarks.output import write_json
from tests.benchmarks.work_precision import quarry_screen, refined
from tests.fixed import fixed_screen
from tests.fmu import native
from vibroscreen import Feed, Screen, ScreenConfig
from vibroscreen.config import QUARRY_EDGES, typical_fractions
from vibroscreen.kernels import state
from vibroscreen.kernels.entry import ADVANCE, SOLVE, run
from vibroscreen.screen import LEAST_CELLS, Inputs
from vibroscreen.sections import Bed, Deck, Displacement, Panel, Passage, Segregation, Solver
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import MM

Array = NDArray[np.float64]
Row = dict[str, Any]
ROOT = Path(__file__).resolve().parents[2]
SCREENS = ROOT / "plant_examples" / "screens"

# What is compared is run for no longer than this, s.
LONGEST = 6.0
# Of a median of steady steps: calls for one look at the clock, which itself takes 0.3 us.
STEADY_BATCH = 50
TARGET = {
    "steady_step_us": 5.0,
    "steady_over_everything": 1 / 50,
    "frequency_us": 300.0,
    "steady_1e-3_ms": 0.1,
    "steady_1e-5_ms": 1.0,
    "slope": 1.05,
    "edge_us": 10.0,
    "native_start_ms": 2.0,
    "native_edge_us": 3.0,
    "native_steady_day_s": 1.0,
    "native_restless_day_s": 20.0,
}
DAY = 86_400  # s, and as many steps
RESTLESS = 0.05  # of the feed: what it wanders by, with a memory of a minute
FORTY = 40  # values set and got at the edge of the FMU


@dataclass(frozen=True)
class Effort:
    """How far everything is driven."""

    repeat: int = 200
    tolerances: tuple[float, ...] = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
    reference: tuple[float, int] = (1e-9, 24)
    classes: tuple[int, ...] = (5, 10, 20, 35, 50, 75, 100, 140, 200)
    layers: tuple[int, ...] = (1, 2, 3, 5, 8, 12, 20, 35, 60, 100)
    cells: tuple[int, ...] = (64, 96, 128, 192, 256, 384, 512)
    day: int = DAY


QUICK = Effort(
    repeat=5,
    tolerances=(1e-2, 1e-4),
    reference=(1e-6, 16),
    classes=(5, 20, 60),
    layers=(2, 8, 24),
    cells=(64, 128, 256),
    day=500,
)


# --- time --------------------------------------------------------------------------------------
@dataclass
class Timed:
    """An action with what goes before it, which is not timed; `batch` times in a row."""

    action: Callable[[], object]
    before: Callable[[], object] = lambda: None
    batch: int = 1

    def microseconds(self) -> float:
        """Time of the action, us."""
        self.before()
        action = self.action
        start = time.thread_time()
        for _ in range(self.batch):
            action()
        return 1e6 * (time.thread_time() - start) / self.batch


def in_turns(actions: Sequence[Timed], repeat: int, budget: float = LONGEST) -> list[float]:
    """Median times of actions that take turns, so that all see the same machine, us."""
    for one in actions:
        one.microseconds()
    times: list[list[float]] = []
    start = time.perf_counter()
    while len(times) < repeat and (len(times) < 3 or time.perf_counter() - start < budget):
        times.append([one.microseconds() for one in actions])
    return [statistics.median(column) for column in zip(*times, strict=True)]


# --- scenes ------------------------------------------------------------------------------------
class Scene:
    """A screen in operation whose inputs change as a controller or an upstream plant would."""

    def __init__(self, config: ScreenConfig, off: str = "") -> None:
        self.config, self.screen = config, Screen(config)
        if off:
            self.screen.view("switch")[state.SWITCH.index(off)] = 0.0
        self.rng = np.random.default_rng(1)
        self.inputs, self.fraction = self.screen.record("input"), self.screen.view("fraction")
        self.parameter = self.screen.record("parameter")
        self.run = run.on(self.screen.buffer)
        self.duty = np.array(config.feed.mass_fraction)
        self.full = self.residence_time = 0.0

    def advance(self) -> None:
        """A step of 1 s through the engine's door."""
        code = self.run(ADVANCE, 1.0, 0.0)
        assert code == state.ACCEPTED

    def near(self, value: float, part: float) -> float:
        """A value at most this part away."""
        return value * (1.0 + self.rng.uniform(-part, part))

    def new_frequency(self) -> None:
        self.inputs.motion_frequency = self.near(self.config.motion.frequency, 0.02)

    def new_feed(self) -> None:
        mix = self.duty * self.rng.uniform(0.8, 1.2, self.duty.size)
        self.fraction[:] = mix / mix.sum()
        self.inputs.feed_mass_flow_rate = self.near(self.config.feed.mass_flow_rate, 0.2)

    def new_everything(self) -> None:
        self.new_feed()
        self.new_frequency()
        self.inputs.motion_amplitude = self.near(self.config.motion.amplitude, 0.02)
        self.inputs.motion_throw_angle = self.near(self.config.motion.throw_angle, 0.02)
        for name, value in (
            ("passage_velocity", self.config.value_of("passage.velocity")),
            ("segregation_velocity", self.config.value_of("segregation.velocity")),
            ("segregation_dilation", self.config.value_of("segregation.dilation")),
        ):
            setattr(self.parameter, name, self.near(value, 0.02))

    def run_in(self, change: Callable[[], object] = lambda: None, steps: int = 60) -> Scene:
        """Steps that fill the decks."""
        for _ in range(steps):
            change()
            self.advance()
        return self

    def counted(self, steps: int, change: Callable[[], object] = lambda: None) -> dict[str, float]:
        """What is counted in a step, mean over `steps`."""
        before = self.screen.counters()
        self.run_in(change, steps)
        after = self.screen.counters()
        return {name: (after[name] - before[name]) / steps for name in after}


def nothing() -> None:
    """No change."""


def screens() -> dict[str, ScreenConfig]:
    """The screens whose steps are timed."""
    return {
        "default": ScreenConfig.default(),
        "20 classes": quarry_screen(),
        "two decks": ScreenConfig.load(SCREENS / "two_deck.toml"),
        "banana": ScreenConfig.load(SCREENS / "banana.toml"),
    }


STEPS = ("steady scene", "after a feed change", "frequency", "feed", "everything")


def step_costs(config: ScreenConfig, effort: Effort) -> Row:
    """Cost of a step of 1 s in five scenes, us; cost of the steps after a change of the feed, us."""
    steady = Scene(config).run_in(steps=90)
    after = Scene(config).run_in(steps=90)
    full = after.screen.buffer.copy()

    def change_feed() -> None:
        after.screen.buffer[:] = full
        after.new_feed()

    timed = [
        Timed(steady.advance, batch=STEADY_BATCH),
        Timed(after.advance, change_feed),
    ]
    counts = {}
    for name in STEPS[2:]:
        scene = Scene(config)
        change = getattr(scene, f"new_{name}")
        scene.run_in(change)
        counts[name] = scene.counted(10, change)
        timed.append(Timed(scene.advance, change))
    costs = in_turns(timed, effort.repeat)
    change_feed()
    later = []
    while len(later) < 120 and (len(later) < 3 or later[-1] > 5.0):
        later.append(Timed(after.advance).microseconds())
    return {
        "us": dict(zip(STEPS, costs, strict=True)),
        "after_feed_change_us": later,
        "nodes": steady.screen.nodes.count,
        "counted": counts,
    }


# --- steady solutions --------------------------------------------------------------------------
class Solution:
    """Steady solutions of a screen by the bare engine, never for quite the same feed."""

    def __init__(self, config: ScreenConfig) -> None:
        self.config, self.screen, self.calls = config, Screen(config), 0
        self.recovery = self.screen.solve_steady().recovery
        self.layout, self.buffer = self.screen._slice()
        self.run = run.on(self.buffer)
        self.inputs = self.layout.record(self.buffer, "input")
        Inputs(self.layout, self.buffer).put(config.feed, config.motion)

    def nudge(self) -> None:
        """Another feed in the last digits, so that nothing can be taken over."""
        self.calls += 1
        rate = self.config.feed.mass_flow_rate * (1.0 + 1e-13 * self.calls)
        self.inputs.feed_mass_flow_rate = rate

    def shake(self) -> None:
        """Another frequency in the last digits: the displacement is solved anew."""
        self.nudge()
        self.inputs.motion_frequency = self.config.motion.frequency * (1.0 + 1e-13 * self.calls)

    def bare(self) -> None:
        """The engine alone, with inputs that lie in its buffer."""
        assert self.run(SOLVE, 0.0, 0.0) == state.ACCEPTED

    def whole(self) -> None:
        """As a user calls it; only what a Feed checks of its fractions is left out."""
        self.calls += 1
        rate = self.config.feed.mass_flow_rate * (1.0 + 1e-13 * self.calls)
        self.screen.solve_steady(Feed(rate, self.config.feed.mass_fraction))

    def rates(self) -> float:
        """Evaluations of rates in a solution."""
        counter = self.layout.record(self.buffer, "counter")
        before = counter.rates
        self.bare()
        return float(counter.rates - before)


def solution_costs(config: ScreenConfig, effort: Effort) -> list[Row]:
    """True error and cost of steady solutions by tolerance."""
    reference = Screen(refined(config, *effort.reference)).solve_steady().recovery
    rows = []
    for tolerance in effort.tolerances:
        one = Solution(config.replace(solver=Solver(tolerance)))
        bare, moved, whole = in_turns(
            [
                Timed(one.bare, one.nudge),
                Timed(one.bare, one.shake),
                Timed(one.whole),
            ],
            effort.repeat,
            2.0,
        )
        rows.append(
            {
                "tolerance": tolerance,
                "nodes": one.screen.nodes.count,
                "error": float(np.abs(one.recovery - reference).max()),
                "bare_us": bare,
                "bare_new_motion_us": moved,
                "solve_steady_us": whole,
            }
        )
    return rows


# --- growth ------------------------------------------------------------------------------------
def slope(numbers: Sequence[float], costs: Sequence[float]) -> float:
    """Fitted slope of log cost over log number."""
    return float(np.polyfit(np.log(numbers), np.log(costs), 1)[0])


def growth(
    title: str, unit: str, numbers: Sequence[float], timed: Sequence[Timed], repeat: int
) -> Row:
    """Cost over a number: all of it, slope over all and over the upper half, where overheads fade."""
    costs = in_turns(timed, repeat)
    upper = len(numbers) // 2
    return {
        "title": title,
        "of": unit,
        "number": [float(n) for n in numbers],
        "us": costs,
        "slope": slope(numbers, costs),
        "slope_upper_half": slope(numbers[upper:], costs[upper:]),
        "refines": False,  # whether the model is another one for every number
    }


def class_growth(effort: Effort, subdivision: int) -> Row:
    """Steady solution over the number of classes: limits in one ratio from 0.5 to 75 mm."""
    timed = []
    for count in effort.classes:
        edges = (0.0, *np.geomspace(0.5, 75.0, count).tolist())
        edges = tuple(d * MM for d in edges)
        feed = Feed(ScreenConfig.default().feed.mass_flow_rate, typical_fractions(edges))
        one = Solution(ScreenConfig(SizeClasses(edges, subdivision=subdivision), feed=feed))
        timed.append(Timed(one.bare, one.nudge))
    how = "engine's nodes" if subdivision == 0 else "one node each"
    return growth(f"classes, {how}", "classes", effort.classes, timed, effort.repeat)


def deep_deck(layers: int, depth: float, layer: float) -> ScreenConfig:
    """A deck of steady velocity, a bed of `depth` m in layers of `layer` m, finer than grains."""
    edges = tuple(d * MM for d in (0, 1, 2, 4, 5.6, 8, 11.2, 16, 22.4, 31.5))
    width, velocity = 1.0, 0.3
    config = ScreenConfig.default()
    rate = config.material.bulk_density * depth * velocity * width
    return ScreenConfig(
        SizeClasses(edges, subdivision=3),
        decks=(Deck(width, (Panel(3.0, 0.0, 16 * MM, 0.5),)),),
        displacement=Displacement("prescribed", velocity),
        passage=Passage(velocity=0.1),
        segregation=Segregation("exchange", velocity=0.05, dilation=1.0 * MM),
        bed=Bed(contact_depth=layer, layer_depth=layer, layers=max(2, layers + 1)),
        feed=Feed(rate, typical_fractions(edges)),
    )


def layer_growth(effort: Effort, thinner: bool) -> Row:
    """Steady solution over bed depth/layer depth: a deeper bed, or thinner layers.

    The depth of a layer is the model's mixing length, so thinner layers are another model for
    every number, one of sharper fronts that cross more layers: shown, without a target.
    """
    solutions = []
    for count in effort.layers:
        layer = 0.1 / count if thinner else 0.01
        solutions.append(Solution(deep_deck(count, layer * count, layer)))
    timed = [Timed(one.bare, one.nudge) for one in solutions]
    how = "thinner layers, bed of 0.1 m" if thinner else "layers of 10 mm"
    row = growth(how, "layers", effort.layers, timed, effort.repeat)
    return {**row, "refines": thinner, "evaluations": [one.rates() for one in solutions]}


def package_growth(effort: Effort, spare: bool) -> Row:
    """Step with a new frequency over the packages that are integrated; same tolerance and nodes.

    Cells follow from the tolerance, which is then set back. Without spare room neighbours are
    merged all the time.
    """
    timed, packages = [], []
    default = ScreenConfig.default()
    for cells in effort.cells:
        tolerance = default.solver.tolerance * (LEAST_CELLS / cells) ** 2
        config = default.replace(
            size_classes=dataclasses.replace(default.size_classes, subdivision=3),
            solver=Solver(tolerance * (1.0 + 1e-9), 0 if spare else cells + 4),
        )
        scene = Scene(config)
        scene.parameter.solver_tolerance = default.solver.tolerance
        scene.run_in(scene.new_frequency)
        packages.append(scene.counted(10, scene.new_frequency)["packages_integrated"])
        timed.append(Timed(scene.advance, scene.new_frequency))
    how = "" if spare else ", no spare room"
    return growth(f"packages{how}", "packages", packages, timed, max(5, effort.repeat // 4))


# --- skips -------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Skip:
    """A scene where a skip matters: which screen, what changes, and what is counted.

    From the start: `steps` steps from empty decks, each time anew; else one step of a running
    screen. `less`: the counter falls by the skip, else it rises.
    """

    switch: str
    scene: str
    config: ScreenConfig
    counter: str
    change: str = ""
    from_empty: int = 0
    less: bool = False


def skips() -> list[Skip]:
    """One scene for every switch."""
    default = fixed_screen()
    finer = (*QUARRY_EDGES[:8], *(d * MM for d in (19, 22.4, 26.5, 31.5, 37.5, 45, 53, 63, 75)))
    deck = Deck(2.4, (Panel(aperture=8 * MM, open_area=0.4),))
    scalped = tuple(0.0 if u <= 5.6 * MM else 1.0 for u in default.size_classes.upper)
    scalped = tuple(f / sum(scalped) for f in scalped)
    thin = default.replace(
        feed=Feed(default.feed.mass_flow_rate / 6, default.feed.mass_fraction),
        decks=(Deck(2.4, (Panel(length=12.0),)),),
        passage=Passage(velocity=0.3),
        segregation=Segregation("well_mixed"),
    )
    return [
        Skip(
            "coarse_sizes",
            "8 mm, many coarse classes",
            default.replace(
                size_classes=SizeClasses(finer),
                decks=(deck,),
                feed=Feed(default.feed.mass_flow_rate, typical_fractions(finer)),
            ),
            "coarse_sizes_skipped",
            "frequency",
        ),
        Skip(
            "empty_sizes",
            "feed without fines",
            default.replace(feed=Feed(default.feed.mass_flow_rate, scalped)),
            "empty_sizes_skipped",
            "frequency",
        ),
        Skip(
            "used_up_sizes",
            "thin mixed bed, 12 m",
            thin,
            "used_up_sizes_skipped",
            "frequency",
        ),
        Skip("explicit", "new frequency", default, "sub_steps", "frequency", less=True),
        Skip(
            "idle_packages",
            "two decks, the first 3 s",
            ScreenConfig.load(SCREENS / "two_deck.toml"),
            "packages_skipped",
            from_empty=3,
        ),
        Skip(
            "shared_trajectory",
            "filling from empty, 20 s",
            default,
            "packages_integrated",
            from_empty=20,
            less=True,
        ),
        Skip("closed_cohorts", "new frequency", default, "cohorts_followed", "frequency"),
        Skip("steady_scene", "steady", default, "steady_steps"),
        Skip("displacement", "steady", default, "displacement_solutions", less=True),
    ]


def skip_cost(skip: Skip, effort: Effort) -> Row:
    """Cost of a step with a skip on and off, us, what was counted, and how far results differ."""
    timed, scenes, counted, rates = [], [], [], []
    for off in ("", skip.switch):
        scene = Scene(skip.config, off)
        change = getattr(scene, f"new_{skip.change}") if skip.change else nothing
        steps = skip.from_empty
        if steps:
            empty = scene.screen.buffer.copy()

            def again(scene: Scene = scene, empty: Array = empty) -> None:
                scene.screen.buffer[:] = empty

            def fill(scene: Scene = scene, steps: int = steps) -> None:
                for _ in range(steps):
                    scene.advance()

            counted.append(scene.counted(steps)[skip.counter])
            timed.append(Timed(fill, again))
        else:
            scene.run_in(change)
            counted.append(scene.counted(10, change)[skip.counter])
            timed.append(Timed(scene.advance, change))
        scenes.append(scene)
        output = scene.screen.record("output")
        under = scene.screen.view("undersize_fraction") * output.undersize_rate
        rates.append(under / scene.config.feed.mass_flow_rate)
    on, off_ = in_turns(timed, max(5, effort.repeat // 4))
    steps = max(1, skip.from_empty)
    return {
        "switch": skip.switch,
        "scene": skip.scene,
        "on_us": on / steps,
        "off_us": off_ / steps,
        "ratio": off_ / on,
        "counter": skip.counter,
        "counted_on": counted[0],
        "counted_off": counted[1],
        "works": counted[0] < counted[1] if skip.less else counted[0] > counted[1],
        "difference": float(np.abs(rates[0] - rates[1]).max()),
    }


# --- ways in -----------------------------------------------------------------------------------
class RawFmu:
    """Calls of an FMU's C functions with arrays that lie ready, as a master in C makes them."""

    def __init__(self, slave: FMU2Slave, inputs: Sequence[int], outputs: Sequence[int]) -> None:
        self.set, self.get = slave.dll["fmi2SetReal"], slave.dll["fmi2GetReal"]
        self.do_step = slave.dll["fmi2DoStep"]
        self.component = ctypes.c_void_p(slave.component)
        self.inputs = (ctypes.c_uint * len(inputs))(*inputs)
        self.outputs = (ctypes.c_uint * len(outputs))(*outputs)
        self.given = (ctypes.c_double * len(inputs))()
        self.got = (ctypes.c_double * len(outputs))()
        self.count = (ctypes.c_size_t(len(inputs)), ctypes.c_size_t(len(outputs)))
        self.time = 0.0

    def step(self) -> None:
        """Set all inputs, step, get all outputs."""
        status = self.set(self.component, self.inputs, self.count[0], self.given)
        status += self.do_step(
            self.component, ctypes.c_double(self.time), ctypes.c_double(1.0), ctypes.c_int(1)
        )
        status += self.get(self.component, self.outputs, self.count[1], self.got)
        assert status == 0
        self.time += 1.0


class FmpyFmu:
    """The same by fmpy: lists in, lists out."""

    def __init__(self, slave: FMU2Slave, inputs: Sequence[int], outputs: Sequence[int]) -> None:
        self.slave, self.inputs, self.outputs = slave, list(inputs), list(outputs)
        self.given = [0.0] * len(inputs)
        self.time = 0.0

    def step(self) -> None:
        """Set all inputs, step, get all outputs."""
        self.slave.setReal(self.inputs, self.given)
        self.slave.doStep(self.time, 1.0)
        self.slave.getReal(self.outputs)
        self.time += 1.0


@contextmanager
def instances(path: Path, count: int) -> Iterator[tuple[list[FMU2Slave], list[int], list[int]]]:
    """Running instances of an FMU, its feed and motion, and its undersize and oversize."""
    description = read_model_description(str(path))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    classes = sum(name.startswith("feed.mass_fraction[") for name in reference)

    def stream(name: str) -> list[str]:
        fractions = (f"{name}.mass_fraction[{i}]" for i in range(1, classes + 1))
        return [f"{name}.mass_flow_rate", *fractions]

    inputs = [reference[name] for name in (*stream("feed"), "motion.frequency")]
    outputs = [reference[name] for name in (*stream("undersize"), *stream("oversize"))]
    folder = extract(str(path))
    slaves = []
    try:
        for _ in range(count):
            slave = FMU2Slave(
                guid=description.guid,
                unzipDirectory=folder,
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName="screen",
            )
            slave.instantiate()
            slaves.append(slave)
            slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
            slave.exitInitializationMode()
        yield slaves, inputs, outputs
    finally:
        for slave in slaves:
            slave.freeInstance()
        shutil.rmtree(folder, ignore_errors=True)


def way_costs(effort: Effort) -> dict[str, dict[str, float]]:
    """Cost of a step of 1 s with inputs set and outputs read, by the way in, us.

    Per way in, in a steady scene and with a new frequency every step.
    """
    config = ScreenConfig.default()
    start = [config.feed.mass_flow_rate, *config.feed.mass_fraction]
    found: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = build(config, Path(folder), "python")
        for change in ("steady scene", "frequency"):
            engine, screen, stepper = Scene(config), Scene(config), Scene(config)
            with instances(path, 2) as (slaves, inputs, outputs):
                raw = RawFmu(slaves[0], inputs, outputs)
                fmpy_way = FmpyFmu(slaves[1], inputs, outputs)

                def advance(screen: Screen = screen.screen) -> None:
                    screen.advance(1.0)

                def step(screen: Screen = stepper.screen) -> None:
                    screen.step(1.0)

                def give(values: Any, moving: bool = change == "frequency") -> Callable[[], None]:
                    rng = np.random.default_rng(1)

                    def set_inputs() -> None:
                        part = rng.uniform(-0.02, 0.02) if moving else 0.0
                        frequency = config.motion.frequency * (1.0 + part)
                        if hasattr(values, "motion_frequency"):
                            values.motion_frequency = frequency
                        else:
                            values[:] = [*start, frequency]

                    return set_inputs

                ways = {
                    "engine": Timed(engine.advance, give(engine.inputs)),
                    "Screen.advance": Timed(advance, give(screen.inputs)),
                    "Screen.step, with a result": Timed(step, give(stepper.inputs)),
                    "FMU, C calls": Timed(raw.step, give(raw.given)),
                    "FMU, fmpy": Timed(fmpy_way.step, give(fmpy_way.given)),
                }
                for way in ways.values():
                    way.batch = STEADY_BATCH if change == "steady scene" else 1
                    for _ in range(60):
                        way.before()
                        way.action()
                costs = in_turns(list(ways.values()), effort.repeat)
            for name, cost in zip(ways, costs, strict=True):
                found.setdefault(name, {})[change] = cost
    return found


def edge_cost(effort: Effort) -> dict[str, float]:
    """Cost of 40 values set, a steady step and 40 values got by C calls, and of the bare step, us.

    A screen of 34 classes has 40 inputs; a master gives them in the order of their references.
    """
    edges = (0.0, *(np.geomspace(0.5, 75.0, 34) * MM).tolist())
    feed = Feed(ScreenConfig.default().feed.mass_flow_rate, typical_fractions(edges))
    config = ScreenConfig(SizeClasses(edges), feed=feed)
    with tempfile.TemporaryDirectory() as folder:
        path = build(config, Path(folder), "python")
        variables = read_model_description(str(path)).modelVariables
        inputs = [v for v in variables if v.causality == "input"]
        outputs = [v for v in variables if v.causality == "output" and v.type == "Real"]
        assert len(inputs) == FORTY
        engine = Scene(config).run_in()
        with instances(path, 1) as (slaves, _, _):
            raw = RawFmu(
                slaves[0],
                sorted(v.valueReference for v in inputs),
                sorted(v.valueReference for v in outputs)[:FORTY],
            )
            for place, v in enumerate(sorted(inputs, key=lambda v: v.valueReference)):
                raw.given[place] = float(v.start)
            for _ in range(60):
                raw.step()
            timed = [Timed(engine.advance, batch=STEADY_BATCH), Timed(raw.step, batch=STEADY_BATCH)]
            bare, whole = in_turns(timed, effort.repeat)
    return {"engine": bare, "FMU, C calls": whole, "more": whole - bare}


def native_cost(effort: Effort) -> dict[str, float]:
    """Cost of the native runtime, driven by a program in C (tests/fmu/replay.c), processor time.

    An instance with its first step [ms], a steady step with 40 values set and 40 got [us], and a
    day in steps of 1 s [s]: under a steady feed, and under one that wanders.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = build(ScreenConfig.default(), Path(folder), "native")
        description = read_model_description(str(path))
        variables = description.modelVariables
        feed = next(v for v in variables if v.name == "feed.mass_flow_rate")
        real = [v for v in variables if v.type == "Real"]
        settable = [v for v in real if v.variability == "tunable" or v.causality == "input"]
        given = {v.valueReference: float(v.start) for v in (feed, *settable)}
        # Fewer than forty: the rest are the same ones again.
        names, values = ((list(row) * FORTY)[:FORTY] for row in (given, given.values()))
        outputs = [v.valueReference for v in real if v.causality == "output"][:FORTY]
        begun = ("X",)
        runs: dict[str, list[native.Call]] = {
            "start, ms": [("m", effort.repeat)],
            "40 and 40, us": [
                begun,
                ("M", 100, names, values, outputs, 0.0),
                ("M", effort.repeat * STEADY_BATCH, names, values, outputs, 0.0),
            ],
            "steady day, s": [begun, ("M", effort.day, names, values, outputs, 0.0)],
            "restless day, s": [begun, ("M", effort.day, names[:1], values[:1], outputs, RESTLESS)],
        }
        scale = (1e-3, 1.0, 1e-6 * DAY, 1e-6 * DAY)
        program = native.compiled(native.REPLAY, Path(folder, "replay"))
        library = native.unzipped_library(path, Path(folder, "unzipped"))
        found = {}
        for (name, calls), factor in zip(runs.items(), scale, strict=True):
            answer = native.replayed([program], library, calls, description.guid, Path(folder))
            found[name] = factor * struct.unpack("<d", answer[-8:])[0]
    return found


# --- targets -----------------------------------------------------------------------------------
def targets(result: Row) -> list[Row]:
    """What is wanted, what was measured, whether that is met."""
    default = result["steps"]["default"]["us"]
    rows = [
        ("steady step, engine, us", default["steady scene"], "steady_step_us"),
        (
            "steady step over one with everything new",
            default["steady scene"] / default["everything"],
            "steady_over_everything",
        ),
        ("new frequency every step, us", default["frequency"], "frequency_us"),
    ]
    for level, name in ((1e-3, "steady_1e-3_ms"), (1e-5, "steady_1e-5_ms")):
        # The cheapest tolerance whose true error is within the level.
        reached = [r["bare_us"] for r in result["steady"]["20 classes"] if r["error"] <= level]
        if reached:
            rows.append((f"20 classes, steady to {level:.0e}, ms", min(reached) / 1e3, name))
    for row in result["growth"]:
        if not row["refines"]:
            rows.append((f"slope of cost, {row['title']}", row["slope_upper_half"], "slope"))
    if result["edge"]:
        rows.append(
            ("40 set, 40 got by C calls over the engine, us", result["edge"]["more"], "edge_us")
        )
    names = ("native_start_ms", "native_edge_us", "native_steady_day_s", "native_restless_day_s")
    for (what, value), name in zip(result["native"].items(), names, strict=False):
        rows.append((f"native, {what}", value, name))
    return [
        {"what": what, "value": value, "target": TARGET[name], "met": value <= TARGET[name]}
        for what, value, name in rows
    ]


# --- report ------------------------------------------------------------------------------------
def by_number(row: Row, name: str) -> str:
    """What grows beside the number that it grows with."""
    pairs = zip(row["number"], row[name], strict=True)
    return "  ".join(f"{number:.0f}: {value:.0f}" for number, value in pairs)


def print_report(result: Row) -> None:
    """All tables."""
    print(f"{'step of 1 s, us (over the dearest)':<36}" + "".join(f"{s:>22}" for s in STEPS))
    for name, row in result["steps"].items():
        costs = row["us"]
        dearest = max(costs.values())
        cells = "".join(f"{c:>12.1f}{f'({c / dearest:.4f})':>10}" for c in costs.values())
        print(f"{name + ', ' + str(row['nodes']) + ' nodes':<36}{cells}")
    print(
        f"\n{'steady solution':<16}{'tolerance':>10}{'nodes':>7}{'error':>10}{'engine us':>12}"
        f"{'new motion us':>15}{'solve_steady us':>17}{'over engine':>13}"
    )
    for name, rows in result["steady"].items():
        for row in rows:
            print(
                f"{name:<16}{row['tolerance']:>10.0e}{row['nodes']:>7}{row['error']:>10.1e}"
                f"{row['bare_us']:>12.1f}{row['bare_new_motion_us']:>15.1f}"
                f"{row['solve_steady_us']:>17.1f}{row['solve_steady_us'] / row['bare_us']:>13.2f}"
            )
    print(f"\n{'cost grows as number^slope':<30}{'slope':>7}{'upper half':>12}   us at number")
    for row in result["growth"]:
        title = f"{row['title']:<30}{row['slope']:>7.2f}{row['slope_upper_half']:>12.2f}"
        print(f"{title}   {by_number(row, 'us')}")
        if "evaluations" in row:
            print(f"{'  evaluations of the rates':<52}{by_number(row, 'evaluations')}")
    print(
        f"\n{'skip':<20}{'scene':<28}{'on us':>9}{'off us':>9}{'off/on':>9}  "
        f"{'counted a step':<24}{'on':>8}{'off':>9}{'difference':>12}"
    )
    for row in result["skips"]:
        print(
            f"{row['switch']:<20}{row['scene']:<28}{row['on_us']:>9.1f}{row['off_us']:>9.1f}"
            f"{row['ratio']:>9.2f}  {row['counter']:<24}{row['counted_on']:>8.1f}"
            f"{row['counted_off']:>9.1f}{row['difference']:>12.1e}"
        )
    if result["ways"]:
        print(f"\n{'way in, step of 1 s':<30}{'steady us':>12}{'more':>8}{'frequency us':>15}")
        bare = result["ways"]["engine"]["steady scene"]
        for name, costs in result["ways"].items():
            still = costs["steady scene"]
            print(f"{name:<30}{still:>12.1f}{still - bare:>8.1f}{costs['frequency']:>15.1f}")
    if result["edge"]:
        told = ", ".join(f"{name} {cost:.1f}" for name, cost in result["edge"].items())
        print(f"34 classes, 40 values set, steady step, 40 values got, us: {told}")
    if result["native"]:
        told = ", ".join(f"{name} {cost:.3g}" for name, cost in result["native"].items())
        print(f"native runtime, by a program in C: {told}")
    print(f"\n{'target':<46}{'measured':>12}{'target':>10}")
    for row in result["targets"]:
        met = "met" if row["met"] else "MISSED"
        print(f"{row['what']:<46}{row['value']:>12.4g}{row['target']:>10.4g}  {met}")


def draw(result: Row, path: Path) -> None:
    """Six pictures: steps, after a change, steady solutions, growth, skips, ways in."""
    figure, axes = plt.subplots(2, 3, figsize=(17, 9.5), layout="constrained")
    steps, later, steady, grown, skipped, ways = axes.flat
    names = list(result["steps"])
    upright: Row = {"fontsize": 7, "rotation": 90, "padding": 2}
    for k, scene in enumerate(STEPS):
        costs = [result["steps"][name]["us"][scene] for name in names]
        places = np.arange(len(names)) + 0.16 * (k - 2)
        bars = steps.bar(places, costs, 0.15, label=scene, color=f"C{k}")
        steps.bar_label(bars, [f"{c:.2f}" if c < 10 else f"{c:.0f}" for c in costs], **upright)
    steps.set(yscale="log", ylabel="a step of 1 s [us]", title="Steps by what changes every step")
    steps.set_xticks(range(len(names)), names)
    steps.set_ylim(top=steps.get_ylim()[1] * 12)
    steps.legend(fontsize=8, ncols=3, loc="upper left")
    for name in names:
        row = result["steps"][name]["after_feed_change_us"]
        later.semilogy(np.arange(1, len(row) + 1), row, ".-", label=name)
    later.set(xlabel="steps of 1 s after a change of the feed", ylabel="the step [us]")
    later.set_title("From a change of the feed until steady")
    later.legend(fontsize=8)
    for k, (name, rows) in enumerate(result["steady"].items()):
        errors = [r["error"] for r in rows]
        steady.loglog([r["bare_us"] for r in rows], errors, "o-", color=f"C{k}", label=name)
        steady.loglog([r["solve_steady_us"] for r in rows], errors, "s:", color=f"C{k}", mfc="w")
    for level, name in ((1e-3, "steady_1e-3_ms"), (1e-5, "steady_1e-5_ms")):
        label = "target, 20 classes" if level == 1e-3 else None
        steady.plot(1e3 * TARGET[name], level, "k*", ms=11, label=label)
    steady.set(xlabel="time [us]: engine (solid), solve_steady (dotted)", title="Steady solutions")
    steady.set_ylabel("largest error of a recovery [1]")
    steady.legend(fontsize=8)
    for row in result["growth"]:
        label = (
            f"{row['title']}: slope {row['slope']:.2f}, upper half {row['slope_upper_half']:.2f}"
        )
        grown.loglog(row["number"], row["us"], ".-", label=label)
    lowest = min(min(row["us"]) for row in result["growth"])
    line = np.array([5.0, 500.0])
    grown.loglog(line, 0.6 * lowest * line / 5.0, "k--", lw=1, label="linear")
    grown.set(xlabel="number", ylabel="time [us]", title="Growth of the cost")
    grown.set_ylim(top=40 * max(max(row["us"]) for row in result["growth"]))
    grown.legend(fontsize=7.5, loc="upper left")
    labels = [f"{row['switch']}\n{row['scene']}" for row in result["skips"]]
    ratios = [row["ratio"] for row in result["skips"]]
    bars = skipped.barh(labels, ratios, color="C2")
    skipped.bar_label(bars, [f"{r:.3g}" for r in ratios], fontsize=8, padding=2)
    skipped.axvline(1.0, color="k", lw=1)
    skipped.set(xscale="log", xlabel="time without the skip over time with it", title="Skips")
    skipped.set_xlim(right=2.5 * max(ratios))
    skipped.tick_params(axis="y", labelsize=7.5)
    skipped.invert_yaxis()
    for k, scene in enumerate(("steady scene", "frequency") if result["ways"] else ()):
        costs = [row[scene] for row in result["ways"].values()]
        places = np.arange(len(costs)) + 0.4 * (k - 0.5)
        bars = ways.barh(places, costs, 0.38, color=f"C{2 * k}", label=scene)
        ways.bar_label(bars, [f"{c:.3g}" for c in costs], fontsize=8, padding=2)
    ways.set(xscale="log", xlabel="a step of 1 s, inputs and outputs [us]", title="Ways in")
    ways.set_yticks(range(len(result["ways"])), list(result["ways"]), fontsize=8)
    ways.invert_yaxis()
    if result["ways"]:
        ways.set_xlim(right=8 * max(max(row.values()) for row in result["ways"].values()))
        ways.legend(fontsize=8)
    for axis in (later, steady, grown):
        axis.grid(True, which="both", alpha=0.25)
    figure.savefig(path, dpi=110)
    plt.close(figure)


# --- the command -------------------------------------------------------------------------------
def main(
    repeat: int | None = None, output: Path | None = None, *, quick: bool = False, fmu: bool = True
) -> Row:
    """Measure, print, and write into `output` if it is given; `fmu`: also the ways in."""
    effort = QUICK if quick else Effort()
    if repeat is not None:
        effort = dataclasses.replace(effort, repeat=repeat)
    kinds = screens()
    result: Row = {
        "machine": platform.processor() or platform.machine(),
        "python": platform.python_version(),
        "quick": quick,
        "repeat": effort.repeat,
        "steps": {},
        "steady": {},
        "growth": [],
        "skips": [],
        "ways": {},
        "edge": {},
        "native": {},
    }
    tasks: list[tuple[str, Callable[[], object]]] = []
    for name, config in kinds.items():
        tasks.append(
            (
                f"steps, {name}",
                lambda n=name, c=config: result["steps"].update({n: step_costs(c, effort)}),
            )
        )
        tasks.append(
            (
                f"steady, {name}",
                lambda n=name, c=config: result["steady"].update({n: solution_costs(c, effort)}),
            )
        )
    for function, choice in (
        (class_growth, 0),
        (class_growth, 1),
        (layer_growth, False),
        (layer_growth, True),
        (package_growth, True),
        (package_growth, False),
    ):
        tasks.append(("growth", lambda f=function, c=choice: result["growth"].append(f(effort, c))))
    for skip in skips():
        tasks.append(
            (f"skip {skip.switch}", lambda s=skip: result["skips"].append(skip_cost(s, effort)))
        )
    if fmu:
        tasks.append(("ways in", lambda: result["ways"].update(way_costs(effort))))
        tasks.append(("40 and 40", lambda: result["edge"].update(edge_cost(effort))))
        tasks.append(("native", lambda: result["native"].update(native_cost(effort))))
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        whole = progress.add_task("", total=len(tasks))
        for name, task in tasks:
            progress.update(whole, description=name)
            task()
            progress.advance(whole)
    result["targets"] = targets(result)
    print_report(result)
    if output is not None:
        write_json(output, "step_cost", result)
        draw(result, output / "step_cost.png")
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, help="runs of which the median is taken")
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    parser.add_argument("--quick", action="store_true", help="a tiny version of every table")
    arguments = parser.parse_args()
    main(arguments.repeat, arguments.output, quick=arguments.quick)
