"""What a step of the engine costs: steady scene, controller at work, feed that never rests.

    python tests/benchmarks/step_cost.py [--repeat 200] [--output DIR]

Medians in microseconds on this machine, and their ratios to the dearest; steady solutions against
their error, which is measured against a solution at a tolerance of 1e-8. Writes step_cost.json and
step_cost.png.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from vibroscreen import Screen, ScreenConfig
from vibroscreen.config import Solver
from vibroscreen.kernels import layout as lay


def median_us(action: Callable[[], object], repeat: int) -> float:
    """Median time of an action, us."""
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return 1e6 * statistics.median(times)


def step_costs(config: ScreenConfig, repeat: int) -> dict[str, float]:
    """Cost of a step of 1 s in three scenes, us."""
    screen = Screen(config)
    rng = np.random.default_rng(1)
    inputs, fraction = screen.view("input"), screen.view("fraction")
    duty = np.array(config.feed.mass_fraction)

    def same() -> None:
        screen.advance(1.0)

    def new_frequency() -> None:
        inputs[lay.FREQUENCY] = config.motion.frequency + rng.uniform(-0.3, 0.3)
        screen.advance(1.0)

    def new_everything() -> None:
        mix = duty * rng.uniform(0.8, 1.2, duty.size)
        fraction[:] = mix / mix.sum()
        inputs[lay.FEED_RATE] = config.feed.mass_flow_rate * rng.uniform(0.8, 1.2)
        new_frequency()

    costs = {}
    for name, action in (
        ("steady scene", same),
        ("frequency changes", new_frequency),
        ("feed and frequency change", new_everything),
    ):
        for _ in range(40):
            action()
        costs[name] = median_us(action, repeat)
    return costs


def solution_costs(config: ScreenConfig, repeat: int) -> list[dict[str, float]]:
    """Cost and error of steady solutions by tolerance."""
    reference = Screen(config.replace(solver=Solver(1e-8))).solve_steady().recovery
    rows = []
    for tolerance in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
        screen = Screen(config.replace(solver=Solver(tolerance)))
        error = float(np.abs(screen.solve_steady().recovery - reference).max())
        cost = median_us(screen.solve_steady, max(5, repeat // 5))
        rows.append({"tolerance": tolerance, "error": error, "us": cost})
    return rows


def main(repeat: int = 200, output: Path | None = None) -> dict[str, object]:
    """Measure, print, and write into `output` if it is given."""
    config = ScreenConfig.default()
    steps, solutions = step_costs(config, repeat), solution_costs(config, repeat)
    dearest = max(steps.values())
    print(f"{'step of 1 s':<28}{'us':>10}{'ratio':>10}")
    for name, cost in steps.items():
        print(f"{name:<28}{cost:>10.1f}{cost / dearest:>10.4f}")
    print(f"\n{'steady solution, tolerance':<28}{'us':>10}{'error':>12}")
    for row in solutions:
        print(f"{row['tolerance']:<28.0e}{row['us']:>10.0f}{row['error']:>12.1e}")
    result: dict[str, object] = {"step_us": steps, "steady": solutions}
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        (output / "step_cost.json").write_text(json.dumps(result, indent=2) + "\n")
        draw(steps, solutions, output / "step_cost.png")
    return result


def draw(steps: dict[str, float], solutions: list[dict[str, float]], path: Path) -> None:
    """Bars of the step costs, and error against time of the steady solutions."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    left.barh(list(steps), list(steps.values()), color="#4a6fa5")
    left.set(xscale="log", xlabel="cost of a step of 1 s [us]")
    right.loglog([r["us"] for r in solutions], [r["error"] for r in solutions], "o-")
    right.set(xlabel="steady solution [us]", ylabel="largest error of a recovery [1]")
    right.grid(True, which="both", alpha=0.3)
    figure.savefig(path, dpi=120)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=200)
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    arguments = parser.parse_args()
    main(arguments.repeat, arguments.output)
