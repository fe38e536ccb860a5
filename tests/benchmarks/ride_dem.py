"""What passes of a bed that rides? A particle simulation of the plate of the DEM decks, periodic.

The plate of `dem_deck_*.csv`: square openings of 8 mm, bars and thickness 3 mm; spheres of 3 to 12 mm
with its contacts: friction 0.5, restitution 0.3, rolling 0.1 between spheres and free on the plate. A
mixed bed, settled on the closed plate, rides on a periodic patch at about the velocity that it will
have, so a run is one package of a deck, and takes seconds where a deck takes minutes.

`python tests/benchmarks/ride_dem.py` runs every case of `ride_dem.csv` there anew and writes what it
finds; `--only CM.i10` runs one and prints it beside the file. Beds are chaotic: seeds differ by 0.03 in
a recovery and by 5 % in the velocity.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pandas as pd
from spheres import DENSITY, plate_wave, simulate

CASES = Path(__file__).resolve().parents[2] / "engine" / "validation" / "data" / "ride_dem.csv"
SIZES = np.array([3.0, 4.0, 5.0, 6.0, 7.0, 7.5, 9.0, 12.0])  # mm
OPENINGS = np.array([8e-3, 11e-3, 3e-3])
CLOSED = np.array([0.0, 11e-3, 3e-3])
SOLIDS = 0.58  # of a settled bed
STEP, EVERY = 2.5e-5, 0.2  # s


def ride(case: pd.Series, seed: int) -> pd.DataFrame:
    """Velocity of the bed in each interval, and what part of each size has passed at its end."""
    random = np.random.default_rng(seed)
    patch = 1e-3 * np.array([case.length_mm, case.width_mm], float)
    share = np.array([case[f"feed_{d:g}"] for d in SIZES], float)
    share /= share.sum()
    mass = SOLIDS * DENSITY * case.depth_mm * 1e-3 * patch.prod() * share
    one = math.pi / 6.0 * DENSITY * (SIZES * 1e-3) ** 3
    number = np.floor(mass / one + random.uniform(0.0, 1.0, SIZES.size)).astype(int)
    size = random.permutation(np.repeat(SIZES, number))
    pitch = SIZES[-1] * 1e-3
    columns, rows = (int(period / pitch) for period in patch)
    level, rest = np.divmod(np.arange(size.size), columns * rows)
    row, column = np.divmod(rest, columns)
    place = np.column_stack(
        [
            (column + 0.5) * patch[0] / columns,
            (row + 0.5) * patch[1] / rows,
            (level + 0.6) * pitch,
        ]
    )
    place[:, :2] += random.uniform(-3e-4, 3e-4, (size.size, 2))
    velocity, spin = random.normal(0.0, 0.05, (size.size, 3)), np.zeros((size.size, 3))
    passed = np.full(size.size, np.inf)
    spheres = (place, velocity, spin, 0.5e-3 * size, passed)
    contact = np.array([0.5, 0.3, 0.1, case.rolling_deck], float)
    wave = plate_wave(case.A_mm * 1e-3, case.f_Hz, math.radians(case.beta_deg), case.ellipticity)
    falling = round((0.35 + math.sqrt(2.0 * place[:, 2].max() / 9.81)) / STEP)
    simulate(*spheres, 0.0 * wave, 0.0, contact, patch, CLOSED, np.array([STEP, falling, falling]))
    velocity *= 0.1
    velocity[:, 0] += case.start_m_s
    clock = np.array([STEP, round(case.seconds / STEP), round(EVERY / STEP)])
    mean = simulate(*spheres, wave, math.radians(case.alpha_deg), contact, patch, OPENINGS, clock)
    time = EVERY * np.arange(1, len(mean) + 1)
    found = pd.DataFrame({"time_s": time, "v_m_s": mean[:, 0]})
    for d in SIZES[SIZES < 8.0]:
        found[f"passed_{d:g}"] = [(passed[size == d] < t).mean() for t in time]
    return found.round(4)


def main() -> None:
    """Run the cases of the file anew."""
    parser = argparse.ArgumentParser(description="What passes of beds that ride.")
    parser.add_argument("--only", help="case to run and to print")
    only = parser.parse_args().only
    rows = pd.read_csv(CASES, comment="#")
    given = list(rows.columns[: rows.columns.get_loc("time_s")])
    parts = []
    for _, case in rows[given].drop_duplicates().iterrows():
        if only in (None, case.case):
            runs = [ride(case, seed) for seed in range(1, int(case.seeds) + 1)]
            mean = sum(runs[1:], start=runs[0]) / len(runs)
            parts.append(pd.DataFrame([case[given]] * len(mean)).reset_index(drop=True).join(mean))
            print(parts[-1].drop(columns=given[1:]).round(3).to_string(), flush=True)
    if only is None:
        notes = [line for line in CASES.read_text().splitlines() if line.startswith("#")]
        CASES.write_text("\n".join([*notes, pd.concat(parts).round(4).to_csv(index=False)]))
    else:
        print(rows[rows.case == only].drop(columns=given[1:]).to_string())


if __name__ == "__main__":
    main()
