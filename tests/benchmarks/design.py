"""What a search for the best screen costs beyond the optimiser: 10 000 designs by particle swarm.

    python tests/benchmarks/design.py [--population 100] [--generations 100] [--output DIR]

The search is that of plant_examples/searches/quarry.toml, by a swarm and by differential evolution.
Beside it, in turn, the same optimiser with as many variables, conditions and designs of a formula
that costs nothing. Processor time of all cores and time on the clock, medians. Writes design.json.
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from tests.benchmarks.output import write_json
from tests.places import ROOT
from vibroscreen.design import Search, search
from vibroscreen.design.search import generations

ALGORITHMS = ("pso", "de")


def optimiser_alone(what: Search) -> None:
    """The optimiser of a search over a sphere under as many conditions, which all hold."""

    def sphere(shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        costs = ((shares - 0.5) ** 2).sum(axis=1, keepdims=True)
        return costs, np.full((len(shares), 1 + len(what.conditions)), -1.0)

    for _ in generations(what, sphere):
        pass


def timed(call: Callable[[], object]) -> tuple[float, float]:
    """Processor time and time on the clock [s] of a call."""
    before = time.process_time(), time.perf_counter()
    call()
    return time.process_time() - before[0], time.perf_counter() - before[1]


def main(
    population: int = 100, generations: int = 100, repeat: int = 3, output: Path | None = None
) -> dict[str, dict[str, float]]:
    """Measure, print, and write into `output` if it is given."""
    whole = Search.load(ROOT / "plant_examples" / "searches" / "quarry.toml")
    result: dict[str, dict[str, float]] = {}
    for name in ALGORITHMS:
        what = dataclasses.replace(
            whole, algorithm=name, population=population, generations=generations
        )
        few = dataclasses.replace(what, population=4, generations=2)
        search(few), optimiser_alone(few)
        evaluations, ours, alone = 0, [], []
        for _ in range(repeat):
            found = []
            ours.append(timed(lambda w=what, f=found: f.append(search(w))))
            alone.append(timed(lambda w=what: optimiser_alone(w)))
            evaluations = found[0].evaluations
        beyond = np.subtract(ours, alone)
        result[name] = {
            "evaluations": evaluations,
            "cpu_s": statistics.median(cpu for cpu, _ in ours),
            "optimiser_cpu_s": statistics.median(cpu for cpu, _ in alone),
            "beyond_cpu_s": float(np.median(beyond[:, 0])),
            "beyond_s": float(np.median(beyond[:, 1])),
        }
        told = result[name]
        print(
            f"{name}: {evaluations} designs, {told['cpu_s']:.2f} s of processor time, "
            f"{told['optimiser_cpu_s']:.2f} s of it the optimiser's own: {told['beyond_cpu_s']:.2f}"
            f" s beyond it, {told['beyond_s']:.2f} s on the clock"
        )
    if output is not None:
        write_json(output, "design", result)
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--population", type=int, default=100)
    parser.add_argument("--generations", type=int, default=100)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    given = parser.parse_args()
    main(given.population, given.generations, given.repeat, given.output)
