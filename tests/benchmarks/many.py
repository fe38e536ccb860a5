"""What many steady states cost: 10 000 designs of the default screen, one core against all.

    python tests/benchmarks/many.py [--designs 10000] [--repeat 3] [--output DIR]

Aperture, inclination, frequency, feed rate and passage velocity vary from design to design, so each
has its own nodes and displacement. Times on the clock, medians, one core and all in turn. Writes
many.json and many.png.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.progress import Progress

from tests.benchmarks.output import write_json
from vibroscreen import ScreenConfig, solve_steady_many
from vibroscreen.sections import Solver


def drawn(count: int) -> dict[str, np.ndarray]:
    """Designs at random around the default screen."""
    rng = np.random.default_rng(0)
    return {
        "deck[1].panel[1].aperture": rng.uniform(0.012, 0.020, count),
        "deck[1].panel[1].inclination": rng.uniform(0.0, 0.15, count),
        "motion.frequency": rng.uniform(14.0, 17.0, count),
        "feed.mass_flow_rate": rng.uniform(60.0, 120.0, count),
        "passage.velocity": rng.uniform(0.05, 0.2, count),
    }


def main(designs: int = 10_000, repeat: int = 3, output: Path | None = None) -> dict[str, object]:
    """Measure, print, and write into `output` if it is given."""
    config = ScreenConfig.default().replace(solver=Solver(1e-3))
    values = drawn(designs)
    solve_steady_many(config, {name: column[:2] for name, column in values.items()})
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    seconds: dict[int, list[float]] = {1: [], cores: []}
    ratios = []
    same = True
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("designs", total=2 * repeat * designs)
        for _ in range(repeat):
            tables = {}
            for threads in (1, cores):
                start = time.perf_counter()
                tables[threads] = solve_steady_many(config, values, threads=threads)
                seconds[threads].append(time.perf_counter() - start)
                progress.advance(task, designs)
            ratios.append(seconds[1][-1] / seconds[cores][-1])
            same = same and bool((tables[1].recovery == tables[cores].recovery).all())
    medians = {str(n): statistics.median(found) for n, found in seconds.items()}
    result: dict[str, object] = {
        "designs": designs,
        "cores": cores,
        "seconds": medians,
        "ratio": statistics.median(ratios),
        "same_bits": same,
    }
    for n, found in medians.items():
        print(
            f"{designs} designs to 1e-3 on {n} core(s): {found:.2f} s, {1e6 * found / designs:.0f} us each"
        )
    print(f"one core over {cores}: {result['ratio']:.2f}, the same bits: {same}")
    if output is not None:
        write_json(output, "many", result)
        figure, axis = plt.subplots(figsize=(5, 2.2), layout="constrained")
        axis.barh([f"{n} core(s)" for n in medians], list(medians.values()), color="#4a6fa5")
        axis.set(xlabel=f"{designs} steady states [s]")
        figure.savefig(output / "many.png", dpi=120)
        plt.close(figure)
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--designs", type=int, default=10_000)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    arguments = parser.parse_args()
    main(arguments.designs, arguments.repeat, arguments.output)
