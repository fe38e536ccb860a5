"""The cost of the engine beside that of a DEM of the same plate and the same deck.

    python tests/benchmarks/dem_scale.py [--repeat N] [--output DIR]

About cost only. How near the model comes to the DEM is another matter: its constants (velocities of
passage and percolation, dilation, contact depth) are defaults here, not fitted to anything. DEM
simulates a few thousand spheres, the engine knows their sizes and a plane bed; what DEM shows
beyond that has its price. Writes dem_scale.json.
"""

from __future__ import annotations

import argparse
import csv
import math
import platform
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from tests.benchmarks.output import write_json
from tests.benchmarks.work_precision import median_seconds, seconds
from vibroscreen import Feed, Motion, Screen, ScreenConfig
from vibroscreen.sections import Bed, Deck, Displacement, Material, Panel, Segregation
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import DEG, MM

Row = dict[str, Any]
DATA = Path(__file__).resolve().parents[2] / "engine" / "validation" / "data"
BATCH = DATA / "dem_batch_sieving.csv"
SPHERE = 2650.0  # kg/m3, of a sphere
SOLIDS = 0.58  # solids fraction at rest (README.md of DATA)

# Case S1 of dem_batch_sieving.csv: LIGGGHTS 3.8.0, one core, 2317 spheres, 4 s of sieving.
S1_SECONDS, S1_TIME, S1_PLATE = 69.0, 4.0, 0.110
S1_AMPLITUDE, S1_FREQUENCY, APERTURE, OPEN_AREA = 3.0 * MM, 15.0, 8.0 * MM, 0.529

# Case B0 of dem_deck_cases.csv and dem_deck_streams.csv (LIGGGHTS 3.8.0, one core; the screen
# behind a feed plate): linear 45 deg, 4 mm, 15 Hz; measured feed, velocity and recovery.
B0_SECONDS, B0_SPHERES, B0_TIME = 587.2, 7457, 11.0
B0_LENGTH, B0_WIDTH, B0_AMPLITUDE, B0_VELOCITY = 0.66, 0.066, 4.0 * MM, 0.2147  # m, m, m, m/s
B0_SIZE = (3.0, 4.0, 5.0, 6.0, 7.0, 7.5, 9.0, 12.0)  # mm
B0_FEED = (0.04265, 0.08552, 0.10253, 0.12754, 0.11273, 0.08387, 0.12614, 0.17146)  # kg/s
B0_RECOVERY = 0.7382  # of what is finer than the aperture


def classes_of(sizes: tuple[float, ...]) -> SizeClasses:
    """Narrow classes around single sizes [mm] (their arithmetic means), empty ones between."""
    edges = [0.0]
    for size in sizes:
        edges += [0.999 * size, 1.001 * size]
    return SizeClasses(tuple(d * MM for d in edges), subdivision=1)


def spread(values: tuple[float, ...]) -> tuple[float, ...]:
    """Mass fractions of `classes_of`: nothing in the classes between."""
    total = math.fsum(values)
    return tuple(part for value in values for part in (0.0, value / total))


def bed_of_spheres(classes: SizeClasses, feed: Feed, panel: Panel, width: float) -> ScreenConfig:
    """A screen of the DEM's plate under a bed as dense as its own, contact layer a coarse sphere."""
    return ScreenConfig(
        classes,
        decks=(Deck(width, (panel,)),),
        material=Material(SPHERE * SOLIDS),
        displacement=Displacement("prescribed", B0_VELOCITY),
        segregation=Segregation("exchange"),
        bed=Bed(contact_depth=8.0 * MM),
        feed=feed,
    )


def batch() -> tuple[ScreenConfig, float, int]:
    """Case S1: screen, areal mass [kg/m2] and number of spheres."""
    lines = [line for line in BATCH.read_text().splitlines() if not line.startswith("#")]
    count: dict[float, int] = {}
    for row in csv.DictReader(lines):
        if row["case"] == "S1":
            count[float(row["d_mm"])] = int(row["N0"])
    sizes = tuple(sorted(count))
    masses = tuple(SPHERE * math.pi / 6.0 * (d * MM) ** 3 * count[d] for d in sizes)
    panel = Panel(S1_PLATE, 0.0, APERTURE, OPEN_AREA)
    feed = Feed(1.0, spread(masses))
    config = bed_of_spheres(classes_of(sizes), feed, panel, S1_PLATE)
    return config, math.fsum(masses) / S1_PLATE**2, sum(count.values())


def sieve(screen: Screen, areal_mass: float) -> float:
    """The batch for 4 s, looked at every 0.05 s as the DEM is; recovery of the undersize [1]."""
    times = np.linspace(0.05, S1_TIME, 80).tolist()
    motion = Motion.linear(S1_AMPLITUDE, S1_FREQUENCY, 90.0 * DEG)
    fraction = screen.config.feed.mass_fraction
    passed = screen.sieve_batch(areal_mass, fraction, motion, times)[-1] @ np.asarray(fraction)
    fine = screen.config.size_classes.mean < APERTURE
    return float(passed / np.asarray(fraction)[fine].sum())


def deck() -> ScreenConfig:
    """Case B0, with the velocity of its bed."""
    panel = Panel(B0_LENGTH, 0.0, APERTURE, OPEN_AREA)
    feed = Feed(math.fsum(B0_FEED), spread(B0_FEED))
    config = bed_of_spheres(classes_of(B0_SIZE), feed, panel, B0_WIDTH)
    return config.replace(motion=Motion.linear(B0_AMPLITUDE, S1_FREQUENCY, 45.0 * DEG))


def main(repeat: int = 21, output: Path | None = None) -> Row:
    """Run both cases, print, and write into `output` if it is given."""
    config, areal_mass, spheres = batch()
    plate = Screen(config)
    sieved = median_seconds(lambda: sieve(plate, areal_mass), repeat)
    screen = Screen(deck())
    empty = screen.state
    steps = round(B0_TIME / 0.1)
    spent = []
    for _ in range(repeat):
        screen.state = empty
        spent.append(seconds(lambda: [screen.step(0.1) for _ in range(steps)]))
    result = screen.result()
    steady = median_seconds(screen.solve_steady, repeat)
    rows = [
        ("S1 batch, 4 s", S1_SECONDS, spheres, "sieve_batch", sieved, sieve(plate, areal_mass)),
        (
            "B0 deck, 11 s",
            B0_SECONDS,
            B0_SPHERES,
            f"{steps} steps of 0.1 s",
            float(np.median(spent)),
            result.undersize_recovery,
        ),
        (
            "B0 deck, steady",
            B0_SECONDS,
            B0_SPHERES,
            "solve_steady",
            steady,
            screen.solve_steady().undersize_recovery,
        ),
    ]
    names = ("case", "dem_s", "spheres", "engine", "engine_s", "undersize_recovery")
    found: Row = {
        "machine": platform.processor() or platform.machine(),
        "constants_fitted": False,
        "rows": [dict(zip(names, row, strict=True)) | {"ratio": row[1] / row[4]} for row in rows],
    }
    print(f"{'case':<18}{'DEM s':>8}{'spheres':>9}  {'engine':<20}{'ms':>9}{'DEM/engine':>14}")
    for row in found["rows"]:
        print(
            f"{row['case']:<18}{row['dem_s']:>8.0f}{row['spheres']:>9}  {row['engine']:<20}"
            f"{1e3 * row['engine_s']:>9.3f}{row['ratio']:>14,.0f}"
        )
    print("Cost only: the constants of the model are defaults, not fitted to the DEM.")
    if output is not None:
        write_json(output, "dem_scale", found)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=21)
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    arguments = parser.parse_args()
    main(arguments.repeat, arguments.output)
