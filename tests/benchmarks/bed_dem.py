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
from numba import njit

DATA = Path(__file__).resolve().parents[2] / "engine" / "validation" / "data"
CASES = DATA / "bed_velocity_dem.csv"
GRAVITY = 9.81
LENGTH, WIDTH = 0.050, 0.025  # m, of the periodic patch
DIAMETERS, MASS_SHARES, DENSITY = np.array([3.6e-3, 4.4e-3, 5.0e-3]), (0.3, 0.4, 0.3), 2650.0
YOUNG, POISSON, ROLLING = 1e7, 0.3, 0.3
STEP = 4e-5  # s, a fifth of the Rayleigh time
SETTLE, RUN = 0.3, 3.0  # s
SKIN = 0.8e-3  # m
NEIGHBOURS = 64
# stiffness of two equal materials in normal and tangential direction
E_PAIR = YOUNG / (2.0 * (1.0 - POISSON**2))
G_PAIR = YOUNG / (2.0 * (1.0 + POISSON)) / (2.0 * (2.0 - POISSON))


@njit(cache=True)
def find_neighbours(place, radius, partner, count, shear):
    """List the pairs that may meet before the next search; contacts keep their shear."""
    old_partner, old_shear = partner.copy(), shear.copy()
    for i in range(radius.size):
        known = count[i]
        found = 0
        for j in range(i + 1, radius.size):
            reach = radius[i] + radius[j] + SKIN
            height = place[i, 2] - place[j, 2]
            if abs(height) > reach:
                continue
            along = place[i, 0] - place[j, 0]
            along -= LENGTH * math.floor(along / LENGTH + 0.5)
            across = place[i, 1] - place[j, 1]
            across -= WIDTH * math.floor(across / WIDTH + 0.5)
            if along**2 + across**2 + height**2 < reach**2:
                partner[i, found] = j
                shear[i, found] = 0.0
                for k in range(known):
                    if old_partner[i, k] == j:
                        shear[i, found] = old_shear[i, k]
                found += 1
        count[i] = found


@njit(cache=True)
def cross(a, b, out):
    """Cross product."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def contact_force(overlap, radius, mass, normal, velocity, shear, friction, restitution, force):
    """Force of a contact into `force`, with effective radius and mass; returns the elastic part.

    velocity is that of the surfaces against each other; shear, the tangential spring, is updated.
    """
    root = math.sqrt(radius * overlap)
    stiff_normal, stiff_shear = 2.0 * E_PAIR * root, 8.0 * G_PAIR * root
    logarithm = math.log(restitution)
    damping = -2.0 * math.sqrt(5.0 / 6.0) * logarithm / math.sqrt(logarithm**2 + math.pi**2)
    closing = velocity[0] * normal[0] + velocity[1] * normal[1] + velocity[2] * normal[2]
    elastic = 4.0 / 3.0 * E_PAIR * root * overlap
    push = elastic - damping * math.sqrt(stiff_normal * mass) * closing
    off_plane = 0.0
    for c in range(3):
        shear[c] += (velocity[c] - closing * normal[c]) * STEP
        off_plane += shear[c] * normal[c]
    length = 0.0
    for c in range(3):
        shear[c] -= off_plane * normal[c]
        length += shear[c] ** 2
    length = math.sqrt(length)
    drag = damping * math.sqrt(stiff_shear * mass)
    if stiff_shear * length > friction * abs(push):
        for c in range(3):
            shear[c] *= friction * abs(push) / (stiff_shear * length)
        drag = 0.0
    for c in range(3):
        slip = velocity[c] - closing * normal[c]
        force[c] = push * normal[c] - stiff_shear * shear[c] - drag * slip
    return elastic


@njit(cache=True)
def add_rolling(turn, normal, torque, torque_i, torque_j):
    """Rolling friction of constant torque against the relative spin `turn`, twisting left out."""
    size = math.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    if size == 0.0:
        return
    twist = (turn[0] * normal[0] + turn[1] * normal[1] + turn[2] * normal[2]) / size
    for c in range(3):
        part = torque * (turn[c] / size - twist * normal[c])
        torque_i[c] -= part
        torque_j[c] += part


@njit(cache=True)
def simulate(place, velocity, spin, radius, wave, slope, friction, restitution, seconds, every):
    """Move the spheres; mean velocity of the bed along the plate in each interval of `every` steps.

    wave = circular frequency, then along cos, along sin, normal cos, normal sin of the plate [m];
    place, velocity and spin [sphere, 3] are updated.
    """
    number = radius.size
    mass = 4.0 / 3.0 * math.pi * DENSITY * radius**3
    partner = np.zeros((number, NEIGHBOURS), np.int64)
    count = np.zeros(number, np.int64)
    shear, plate_shear = np.zeros((number, NEIGHBOURS, 3)), np.zeros((number, 3))
    force, torque = np.zeros((number, 3)), np.zeros((number, 3))
    normal, surface, turn = np.zeros(3), np.zeros(3), np.zeros(3)
    push, moment, plate, nothing = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    searched = place.copy()
    find_neighbours(place, radius, partner, count, shear)
    steps = round(seconds / STEP)
    mean = np.zeros(steps // every)
    for step in range(mean.size * every):
        if np.max(np.sum((place - searched) ** 2, axis=1)) > 0.98 * (0.5 * SKIN) ** 2:
            find_neighbours(place, radius, partner, count, shear)
            searched[:] = place
        sine, cosine = math.sin(wave[0] * step * STEP), math.cos(wave[0] * step * STEP)
        height = wave[3] * cosine + wave[4] * sine
        plate[0] = wave[0] * (wave[2] * cosine - wave[1] * sine)
        plate[2] = wave[0] * (wave[4] * cosine - wave[3] * sine)
        force[:, 0] = mass * GRAVITY * math.sin(slope)
        force[:, 1] = 0.0
        force[:, 2] = -mass * GRAVITY * math.cos(slope)
        torque[:] = 0.0
        for i in range(number):
            for k in range(count[i] + 1):
                on_plate = k == count[i]
                j = i if on_plate else partner[i, k]
                spring = plate_shear[i] if on_plate else shear[i, k]
                if on_plate:
                    overlap = radius[i] - (place[i, 2] - height)
                    normal[0], normal[1], normal[2] = 0.0, 0.0, 1.0
                    effective_radius, effective_mass = radius[i], mass[i]
                else:
                    normal[:] = place[i] - place[j]
                    normal[0] -= LENGTH * math.floor(normal[0] / LENGTH + 0.5)
                    normal[1] -= WIDTH * math.floor(normal[1] / WIDTH + 0.5)
                    distance = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
                    overlap = radius[i] + radius[j] - distance
                    normal /= distance
                    effective_radius = radius[i] * radius[j] / (radius[i] + radius[j])
                    effective_mass = mass[i] * mass[j] / (mass[i] + mass[j])
                if overlap <= 0.0:
                    spring[:] = 0.0
                    continue
                arm_i = radius[i] - 0.5 * overlap
                arm_j = 0.0 if on_plate else radius[j] - 0.5 * overlap
                for c in range(3):
                    turn[c] = arm_i * spin[i, c] + arm_j * spin[j, c]
                cross(turn, normal, surface)
                for c in range(3):
                    other = plate[c] if on_plate else velocity[j, c]
                    surface[c] = velocity[i, c] - other - surface[c]
                elastic = contact_force(
                    overlap,
                    effective_radius,
                    effective_mass,
                    normal,
                    surface,
                    spring,
                    friction,
                    restitution,
                    push,
                )
                cross(normal, push, moment)
                for c in range(3):
                    force[i, c] += push[c]
                    torque[i, c] -= arm_i * moment[c]
                    turn[c] = spin[i, c] if on_plate else spin[i, c] - spin[j, c]
                    if not on_plate:
                        force[j, c] -= push[c]
                        torque[j, c] -= arm_j * moment[c]
                resist = ROLLING * elastic * effective_radius
                add_rolling(turn, normal, resist, torque[i], nothing if on_plate else torque[j])
        travel = 0.0
        for i in range(number):
            for c in range(3):
                velocity[i, c] += STEP * force[i, c] / mass[i]
                spin[i, c] += STEP * torque[i, c] / (0.4 * mass[i] * radius[i] ** 2)
                place[i, c] += STEP * velocity[i, c]
            travel += mass[i] * velocity[i, 0]
        mean[step // every] += travel / (np.sum(mass) * every)
    return mean


def bed_velocity(case: pd.Series) -> tuple[float, float]:
    """Velocity of the bed of a row of the file in the second and third second [m/s]."""
    random = np.random.default_rng(int(case.seed))
    number = int(case.N)
    shares = np.array(MASS_SHARES) / DIAMETERS**3
    radius = random.choice(DIAMETERS, size=number, p=shares / shares.sum()) / 2.0
    pitch = 5.2e-3
    columns, rows = int(LENGTH / pitch), int(WIDTH / pitch)
    level, rest = np.divmod(np.arange(number), columns * rows)
    row, column = np.divmod(rest, columns)
    place = np.column_stack(
        [(column + 0.5) * LENGTH / columns, (row + 0.5) * WIDTH / rows, (level + 0.6) * pitch]
    )
    place[:, :2] += random.uniform(-1e-4, 1e-4, (number, 2))
    velocity, spin = random.normal(0.0, 0.02, (number, 3)), np.zeros((number, 3))
    angle = math.radians(case.beta_deg)
    amplitude, frequency = case.A_mm / 1000.0, 2.0 * math.pi * case.f_Hz
    wave = amplitude * np.array(
        [
            0.0,
            -case.ellipticity * math.sin(angle),
            math.cos(angle),
            case.ellipticity * math.cos(angle),
            math.sin(angle),
        ]
    )
    wave[0] = frequency
    slope = math.radians(case.alpha_deg)
    still = np.array([frequency, 0.0, 0.0, 0.0, 0.0])
    contacts = (float(case.mu), float(case.restitution))
    every = round(1.0 / STEP)
    simulate(place, velocity, spin, radius, still, 0.0, *contacts, SETTLE, round(SETTLE / STEP))
    _, second, third = simulate(place, velocity, spin, radius, wave, slope, *contacts, RUN, every)
    return float(second), float(third)


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
