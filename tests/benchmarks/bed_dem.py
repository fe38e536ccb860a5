"""How fast does a bed of spheres ride? A small particle simulation (DEM) of a vibrating plate.

The set-up of `dem_conveying.csv` in engine/validation/data, which was run in LIGGGHTS: spheres of
3.6, 4.4 and 5.0 mm (mass 0.3, 0.4, 0.3), 2650 kg/m3, on a flat plate of 50 x 25 mm, periodic, in
the frame of the plate's mean position. Contacts: Hertz, E = 10 MPa, Poisson's ratio 0.3, tangential
history with Coulomb's limit, rolling friction 0.3 at constant torque, the same between spheres and
on the plate. The bed settles for 0.3 s, then the plate vibrates for 3 s from rest; the velocity of
the second half of the last two seconds counts.

`python tests/benchmarks/bed_dem.py` runs every row of `bed_velocity_dem.csv` there anew and writes
its velocities: some 10 s a row. Beds are chaotic: seeds differ by about 5 %. `--rows 20` runs the
first twenty and prints them beside those of the file.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
import pandas as pd
from spheres import plate_wave, simulate

DATA = Path(__file__).resolve().parents[2] / "engine" / "validation" / "data"
CASES = DATA / "bed_velocity_dem.csv"
PATCH = np.array([0.050, 0.025])  # m, periodic
FLAT = np.array([0.0, 1.0, 0.0])
DIAMETERS, MASS_SHARES = np.array([3.6e-3, 4.4e-3, 5.0e-3]), (0.3, 0.4, 0.3)
ROLLING = 0.3
STEP = 4e-5  # s, a fifth of the Rayleigh time
SETTLE, RUN = 0.3, 3.0  # s


def bed_velocity(case: pd.Series) -> tuple[float, float]:
    """Velocity of the bed of a row of the file in the second and third second [m/s]."""
    random = np.random.default_rng(int(case.seed))
    number = int(case.N)
    shares = np.array(MASS_SHARES) / DIAMETERS**3
    radius = random.choice(DIAMETERS, size=number, p=shares / shares.sum()) / 2.0
    pitch = 5.2e-3
    columns, rows = (int(period / pitch) for period in PATCH)
    level, rest = np.divmod(np.arange(number), columns * rows)
    row, column = np.divmod(rest, columns)
    place = np.column_stack(
        [
            (column + 0.5) * PATCH[0] / columns,
            (row + 0.5) * PATCH[1] / rows,
            (level + 0.6) * pitch,
        ]
    )
    place[:, :2] += random.uniform(-1e-4, 1e-4, (number, 2))
    velocity, spin = random.normal(0.0, 0.02, (number, 3)), np.zeros((number, 3))
    wave = plate_wave(case.A_mm / 1000.0, case.f_Hz, math.radians(case.beta_deg), case.ellipticity)
    spheres = (place, velocity, spin, radius, np.full(number, np.inf))
    given = (np.array([case.mu, case.restitution, ROLLING, ROLLING], float), PATCH, FLAT)
    settling = round(SETTLE / STEP)
    simulate(*spheres, 0.0 * wave, 0.0, *given, np.array([STEP, settling, settling]))
    clock = np.array([STEP, round(RUN / STEP), round(1.0 / STEP)])
    mean = simulate(*spheres, wave, math.radians(case.alpha_deg), *given, clock)
    return float(mean[1, 0]), float(mean[2, 0])


def main() -> None:
    """Run the cases of the file anew."""
    parser = argparse.ArgumentParser(description="Velocity of beds of spheres on vibrating plates.")
    parser.add_argument("--rows", type=int, help="run so many rows and print them only")
    rows = parser.parse_args().rows
    cases = pd.read_csv(CASES, comment="#")
    for index, case in cases.head(rows or len(cases)).iterrows():
        velocities = bed_velocity(case)
        known = case.v_second_half
        print(f"{case.case}: {velocities[1]:.4f} m/s, in the file {known:.4f} m/s", flush=True)
        cases.loc[index, ["v_first_half", "v_second_half"]] = np.round(velocities, 4)
    if rows is None:
        notes = [line for line in CASES.read_text().splitlines() if line.startswith("#")]
        CASES.write_text("\n".join([*notes, cases.to_csv(index=False)]))


if __name__ == "__main__":
    main()
