"""What many closed circuits cost: 10 000 designs of the closed crushing circuit, on all cores.

    python tests/benchmarks/circuits.py [--designs 10000] [--repeat 3] [--output DIR]

Feed rate and gradation, closed-side setting, aperture and frequency are drawn at random; screens are
solved to 1e-3, circuits closed to 1e-6 of their fresh feed. Beside it, in turn: ten times as many
plain steady states of the screen. Times on the clock, medians. Writes circuits.json and circuits.png.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import matplotlib.pyplot as plt
import numpy as np

from tests.benchmarks.output import write_json
from tests.places import ROOT
from vibroscreen import solve_steady_many
from vibroscreen.circuit import CircuitTable, Flowsheet, ScreenUnit, solve_circuit_many
from vibroscreen.units import MM, T_H

PLAIN = 10  # steady states for every circuit


def flowsheet() -> Flowsheet:
    """The closed circuit, its screen solved to 1e-3."""
    path = ROOT / "plant_examples" / "circuits" / "closed.toml"
    return Flowsheet.load(path).with_tolerance(1e-3)


def drawn(sheet: Flowsheet, count: int) -> dict[str, np.ndarray]:
    """Designs at random around the circuit."""
    rng = np.random.default_rng(0)
    sizes = rng.uniform(30.0, 45.0, count) * MM  # Rosin-Rammler, exponent 1.1, as the circuit's own
    passing = -np.expm1(-((sheet.edges / sizes[:, None]) ** 1.1))
    return {
        "fresh.mass_flow_rate": rng.uniform(240.0, 330.0, count) * T_H,
        "fresh.mass_fraction": np.diff(passing / passing[:, -1:], axis=1),
        "screen.motion.frequency": rng.uniform(14.5, 17.0, count),
        "screen.deck[1].panel[1].aperture": rng.uniform(15.0, 18.0, count) * MM,
        "crusher.closed_side_setting": rng.uniform(12.0, 15.0, count) * MM,
    }


def main(designs: int = 10_000, repeat: int = 3, output: Path | None = None) -> dict[str, object]:
    """Measure, print, and write into `output` if it is given."""
    sheet = flowsheet()
    values = drawn(sheet, designs)
    screen = sheet.unit["screen"]
    assert isinstance(screen, ScreenUnit)
    own = {
        "feed.mass_flow_rate": values["fresh.mass_flow_rate"],
        "feed.mass_fraction": values["fresh.mass_fraction"],
        "motion.frequency": values["screen.motion.frequency"],
        "deck[1].panel[1].aperture": values["screen.deck[1].panel[1].aperture"],
    }
    plain = {name: np.concatenate([column] * PLAIN) for name, column in own.items()}
    solve_circuit_many(sheet, {name: column[:2] for name, column in values.items()})
    seconds: dict[str, list[float]] = {"circuits": [], "steady states": []}
    table: CircuitTable | None = None
    for _ in range(repeat):
        start = time.perf_counter()
        table = solve_circuit_many(sheet, values)
        seconds["circuits"].append(time.perf_counter() - start)
        start = time.perf_counter()
        solve_steady_many(screen.config, plain)
        seconds["steady states"].append(time.perf_counter() - start)
    assert table is not None
    names, counts = np.unique(table.status, return_counts=True)
    medians = {name: statistics.median(found) for name, found in seconds.items()}
    ratio = statistics.median(np.divide(seconds["circuits"], seconds["steady states"]))
    result: dict[str, object] = {
        "designs": designs,
        "seconds": medians,
        "ratio": ratio,
        "turns": float(table.turns.mean()),
        "status": dict(zip(names.tolist(), counts.tolist(), strict=True)),
        "worst": float(table.residual[table.closed].max()),
    }
    told = ", ".join(f"{count} {name}" for name, count in zip(names, counts, strict=True))
    print(f"{designs} closed circuits: {medians['circuits']:.2f} s ({told})")
    print(f"{result['turns']:.1f} turns each, closed to {result['worst']:.1e} of the fresh feed")
    print(f"{PLAIN * designs} plain steady states: {medians['steady states']:.2f} s")
    print(f"circuits over steady states: {ratio:.2f}")
    if output is not None:
        write_json(output, "circuits", result)
        figure, axis = plt.subplots(figsize=(6, 3), layout="constrained")
        axis.hist(table.turns, bins=np.arange(0.5, table.turns.max() + 1.5), color="#4a6fa5")
        axis.set(xlabel="turns until a circuit is closed", ylabel="designs")
        figure.savefig(output / "circuits.png", dpi=120)
        plt.close(figure)
    return result


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--designs", type=int, default=10_000)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    arguments = parser.parse_args()
    main(arguments.designs, arguments.repeat, arguments.output)
