"""What a week of plant time costs: two-stage crushing by FMUs, under a feed that never rests.

    python tests/benchmarks/week.py [--quick] [--output DIR]

The circuit of plant_examples/circuits/two_stage.toml, one FMU a unit, the screen's native, stepped by
fmpy in steps of a minute, as belt scales and historians of plants give their means. The rate of the
feed wanders by 10 % with a memory of ten minutes, its gradation with one of an hour. Screens are
solved to 1e-3, as in studies. Told: seconds on the clock and of the processor, and the balance of the
whole circuit: what was fed less what left, and less what is held on screen and belt and on its way
from unit to unit. --quick: two hours. Writes week.json and week.png.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(1, str(Path(__file__).resolve().parents[2] / "plant_examples"))

import matplotlib.pyplot as plt
import numpy as np

import two_stage
from components.coupling import Coupled
from tests.benchmarks.output import write_json
from vibroscreen.circuit import Flowsheet
from vibroscreen.stream import Feed
from vibroscreen.units import HOUR, KWH_T, MINUTE, T_H, TONNE
from vibroscreen_fmu.circuit.ssp import Circuit, write_circuit

WEEK, SHORT, STEP = 168 * HOUR, 2 * HOUR, MINUTE
RATE = (0.10, 10 * MINUTE)  # standard deviation of the rate over its mean, and memory
SIZE = (0.15, HOUR)  # of the exponent by which the gradation leans to the coarse
DRIVES = ("jaw", "cone", "screen", "belt")
TOLERANCE = 1e-3


@dataclass(frozen=True)
class Run:
    """A week or less: fed, made by product and held at the end [kg], energy [J], rates by step."""

    fed: float
    made: dict[str, float]
    held: float
    energy: float
    history: np.ndarray  # kg/s: fed, then the products
    seconds: float
    processor: float

    @property
    def balance_error(self) -> float:
        """Fed less made and held, over what was fed, 1."""
        return (self.fed - math.fsum(self.made.values()) - self.held) / self.fed


def flowsheet() -> Flowsheet:
    """The circuit, its screen solved to 1e-3."""
    return two_stage.TODAY.with_tolerance(TOLERANCE)


def wandering(deviation: float, memory: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """A noise that forgets with a memory [s], at every step."""
    keeps, now, noise = math.exp(-STEP / memory), 0.0, np.empty(count)
    for k, kick in enumerate(rng.normal(size=count)):
        now = noise[k] = keeps * now + math.sqrt(1.0 - keeps**2) * deviation * kick
    return noise


def feeds(sheet: Flowsheet, count: int) -> list[Feed]:
    """The feed of every step; one seed."""
    rng, (rock,) = np.random.default_rng(0), sheet.feeds
    rates = rock.mass_flow_rate * np.maximum(1.0 + wandering(*RATE, count, rng), 0.0)
    middle = 0.5 * (sheet.edges[1:] + sheet.edges[:-1])
    parts = rock.mass_fraction * middle ** wandering(*SIZE, count, rng)[:, None]
    fractions = parts / parts.sum(axis=1, keepdims=True)
    return [Feed(float(q), tuple(f.tolist())) for q, f in zip(rates, fractions, strict=True)]


def run(sheet: Flowsheet, circuit: Circuit, fed: list[Feed]) -> Run:
    """Step through all feeds from empty."""
    order, places = list(circuit.fmus), range(1, circuit.classes + 1)
    rates = np.empty((len(fed), 1 + len(sheet.leaving)))
    energy = 0.0
    start, worked = time.perf_counter(), time.process_time()
    with ExitStack() as stack:
        plant = Coupled(circuit, stack)
        for row, feed in zip(rates, fed, strict=True):
            given = {f"feed.mass_fraction[{i}]": feed.mass_fraction[i - 1] for i in places}
            plant.set("jaw", {"feed.mass_flow_rate": feed.mass_flow_rate, **given})
            plant.step(STEP)
            made = [plant.get(unit, f"{out}.mass_flow_rate")[0] for unit, out in sheet.leaving]
            row[:] = feed.mass_flow_rate, *made
            energy += STEP * sum(plant.get(unit, "drive.power")[0] for unit in DRIVES)
        held = plant.get("screen", "bed.hold_up") + plant.get("belt", "held.mass")
        # What an element before it in the order gets, it takes in the next step.
        held += [
            STEP * plant.get(source, f"{output}.mass_flow_rate")[0]
            for source, output, target, _ in circuit.streams
            if order.index(source) >= order.index(target)
        ]
    seconds, processor = time.perf_counter() - start, time.process_time() - worked
    total, *made = (STEP * math.fsum(column) for column in rates.T)
    products = dict(zip(sheet.leaving.values(), made, strict=True))
    return Run(total, products, math.fsum(held), energy, rates, seconds, processor)


def draw(found: Run, path: Path) -> None:
    """Rates, means of an hour."""
    each = min(len(found.history), round(HOUR / STEP))
    whole = found.history[: len(found.history) // each * each]
    hours = whole.reshape(-1, each, whole.shape[1])
    figure, axis = plt.subplots(figsize=(7.4, 3.6), layout="constrained")
    for name, column in zip(("rock", *found.made), hours.mean(axis=1).T, strict=True):
        axis.plot(np.arange(column.size) / 24, column / T_H, label=name, lw=1.0)
    axis.set(xlabel="plant time, days", ylabel="t/h, means of an hour", ylim=(0.0, None))
    axis.legend(ncols=4)
    figure.savefig(path, dpi=120)
    plt.close(figure)


def main(plant_time: float = WEEK, output: Path | None = None) -> Run:
    """Measure, print, and write into `output` if it is given."""
    sheet = flowsheet()
    fed = feeds(sheet, round(plant_time / STEP))
    with tempfile.TemporaryDirectory() as folder:
        found = run(sheet, write_circuit(sheet, Path(folder)), fed)
    made = ", ".join(f"{name}: {mass / TONNE:.1f} t" for name, mass in found.made.items())
    product = math.fsum(found.made.values())
    print(f"{len(fed)} steps of {STEP:g} s, {plant_time / HOUR:g} h of plant time")
    print(f"{found.seconds:.0f} s on the clock, {found.processor:.0f} s of the processor")
    print(f"fed {found.fed / TONNE:.1f} t; {made}; held {found.held / TONNE:.3f} t")
    print(f"balance of the circuit: {found.balance_error:.1e} of what was fed")
    print(f"energy of all drives: {found.energy / product / KWH_T:.3f} kWh/t")
    if output is not None:
        result = {
            "plant_time": plant_time,
            "seconds": found.seconds,
            "processor": found.processor,
            "fed_t": found.fed / TONNE,
            "made_t": {name: mass / TONNE for name, mass in found.made.items()},
            "balance_error": found.balance_error,
        }
        write_json(output, "week", result)
        draw(found, output / "week.png")
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two hours in place of a week")
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    arguments = parser.parse_args()
    main(SHORT if arguments.quick else WEEK, arguments.output)
