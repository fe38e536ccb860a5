"""Particle simulation (DEM) of spheres on a vibrating plate, flat or with square openings.

Contacts: Hertz, E = 10 MPa, Poisson's ratio 0.3, tangential history with Coulomb's limit, rolling
friction at constant torque; periodic along and across the plate, in the frame of its mean position.
Used by `bed_dem.py` (how fast a bed rides) and `ride_dem.py` (what passes while it rides).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

GRAVITY = 9.81
DENSITY, YOUNG, POISSON = 2650.0, 1e7, 0.3
SKIN = 0.8e-3  # m
NEIGHBOURS = 64
WALLS = 5  # contacts of a sphere with the plate: its top, and the four sides of an opening
BELOW = 6e-3  # m below the top of the plate, where a sphere has passed
# stiffness of two equal materials in normal and tangential direction
E_PAIR = YOUNG / (2.0 * (1.0 - POISSON**2))
G_PAIR = YOUNG / (2.0 * (1.0 + POISSON)) / (2.0 * (2.0 - POISSON))


@njit(cache=True)
def nearest_image(distance, period):
    """Distance to the nearest of the periodic images."""
    return distance - period * math.floor(distance / period + 0.5)


@njit(cache=True)
def find_neighbours(place, radius, passed, patch, partner, count, shear):
    """List the pairs that may meet before the next search; contacts keep their shear."""
    old_partner, old_count, old_shear = partner.copy(), count.copy(), shear.copy()
    for i in range(radius.size):
        count[i] = 0
        if passed[i] < math.inf:
            continue
        for j in range(i + 1, radius.size):
            reach = radius[i] + radius[j] + SKIN
            height = place[i, 2] - place[j, 2]
            if abs(height) > reach or passed[j] < math.inf:
                continue
            along = nearest_image(place[i, 0] - place[j, 0], patch[0])
            across = nearest_image(place[i, 1] - place[j, 1], patch[1])
            if along**2 + across**2 + height**2 < reach**2:
                partner[i, count[i]] = j
                shear[i, count[i]] = 0.0
                for k in range(old_count[i]):
                    if old_partner[i, k] == j:
                        shear[i, count[i]] = old_shear[i, k]
                count[i] += 1


@njit(cache=True)
def moved_apart(place, searched, passed):
    """Square of the farthest that a sphere has moved against the mean of all [m2]."""
    drift = np.zeros(3)
    here = 0
    for i in range(passed.size):
        if passed[i] == math.inf:
            drift += place[i] - searched[i]
            here += 1
    drift /= max(here, 1)
    farthest = 0.0
    for i in range(passed.size):
        if passed[i] == math.inf:
            farthest = max(farthest, np.sum((place[i] - searched[i] - drift) ** 2))
    return farthest


@njit(cache=True)
def cross(a, b, out):
    """Cross product."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def contact_force(overlap, radius, mass, normal, velocity, shear, friction, damping, step, force):
    """Force of a contact into `force`, with effective radius and mass; returns the elastic part.

    velocity is that of the surfaces against each other; shear, the tangential spring, is updated.
    """
    root = math.sqrt(radius * overlap)
    stiff_normal, stiff_shear = 2.0 * E_PAIR * root, 8.0 * G_PAIR * root
    closing = velocity[0] * normal[0] + velocity[1] * normal[1] + velocity[2] * normal[2]
    elastic = 4.0 / 3.0 * E_PAIR * root * overlap
    push = elastic - damping * math.sqrt(stiff_normal * mass) * closing
    off_plane = 0.0
    for c in range(3):
        shear[c] += (velocity[c] - closing * normal[c]) * step
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
def to_the_plate(wall, x, y, z, openings, normal):
    """Distance of a centre at x, y, z over the plate's top from one of its walls, inf if not there.

    openings: side of a square opening (0: a flat plate), pitch, thickness of the plate [m].
    """
    half = 0.5 * openings[0]
    x, y = nearest_image(x, openings[1]), nearest_image(y, openings[1])
    inside = abs(x) < half and abs(y) < half
    if inside != (wall > 0):
        return math.inf
    normal[:] = 0.0
    normal[2] = z - min(0.0, max(-openings[2], z)) if half > 0.0 else z
    if wall > 0:
        axis = (wall - 1) // 2
        normal[axis] = (x if axis == 0 else y) + (half if wall % 2 == 0 else -half)
    distance = math.sqrt(np.sum(normal**2))
    if distance == 0.0:
        return math.inf
    normal /= distance
    return distance


@njit(cache=True)
def simulate(place, velocity, spin, radius, passed, wave, slope, contact, patch, openings, clock):
    """Move the spheres; mean velocity along the plate and load of each interval of the clock.

    place, velocity and spin [sphere, 3] are updated, and passed [sphere], the time at which a sphere
    has passed (inf before); wave: circular frequency, then cos and sin along and normal of the plate
    [m]; contact: friction, restitution, rolling between spheres and on the plate; patch: periods
    along and across [m]; clock: step [s], steps in all, steps of an interval.
    """
    number, step, every = radius.size, clock[0], round(clock[2])
    mass = 4.0 / 3.0 * math.pi * DENSITY * radius**3
    logarithm = math.log(contact[1])
    damping = -2.0 * math.sqrt(5.0 / 6.0) * logarithm / math.sqrt(logarithm**2 + math.pi**2)
    partner = np.zeros((number, NEIGHBOURS), np.int64)
    count = np.zeros(number, np.int64)
    shear, plate_shear = np.zeros((number, NEIGHBOURS, 3)), np.zeros((number, WALLS, 3))
    force, torque = np.zeros((number, 3)), np.zeros((number, 3))
    normal, surface, turn = np.zeros(3), np.zeros(3), np.zeros(3)
    push, moment, plate, nothing = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    searched = place.copy()
    find_neighbours(place, radius, passed, patch, partner, count, shear)
    mean = np.zeros((round(clock[1]) // every, 2))
    for now in range(mean.shape[0] * every):
        if moved_apart(place, searched, passed) > 0.98 * (0.5 * SKIN) ** 2:
            find_neighbours(place, radius, passed, patch, partner, count, shear)
            searched[:] = place
        sine, cosine = math.sin(wave[0] * now * step), math.cos(wave[0] * now * step)
        shift, height = wave[1] * cosine + wave[2] * sine, wave[3] * cosine + wave[4] * sine
        plate[0] = wave[0] * (wave[2] * cosine - wave[1] * sine)
        plate[2] = wave[0] * (wave[4] * cosine - wave[3] * sine)
        force[:, 0] = mass * GRAVITY * math.sin(slope)
        force[:, 1] = 0.0
        force[:, 2] = -mass * GRAVITY * math.cos(slope)
        torque[:] = 0.0
        for i in range(number):
            if passed[i] < math.inf:
                continue
            above = place[i, 2] - height
            for k in range(count[i] + (WALLS if above < radius[i] else 0)):
                on_plate = k >= count[i]
                j = i if on_plate else partner[i, k]
                spring = plate_shear[i, k - count[i]] if on_plate else shear[i, k]
                if on_plate:
                    x = place[i, 0] - shift
                    overlap = radius[i] - to_the_plate(
                        k - count[i], x, place[i, 1], above, openings, normal
                    )
                    effective_radius, effective_mass = radius[i], mass[i]
                else:
                    if passed[j] < math.inf:
                        continue
                    normal[:] = place[i] - place[j]
                    normal[0] = nearest_image(normal[0], patch[0])
                    normal[1] = nearest_image(normal[1], patch[1])
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
                    overlap, effective_radius, effective_mass, normal, surface, spring,
                    contact[0], damping, step, push,
                )  # fmt: skip
                cross(normal, push, moment)
                for c in range(3):
                    force[i, c] += push[c]
                    torque[i, c] -= arm_i * moment[c]
                    turn[c] = spin[i, c] if on_plate else spin[i, c] - spin[j, c]
                    if not on_plate:
                        force[j, c] -= push[c]
                        torque[j, c] -= arm_j * moment[c]
                resist = contact[3 if on_plate else 2] * elastic * effective_radius
                add_rolling(turn, normal, resist, torque[i], nothing if on_plate else torque[j])
            if above >= radius[i]:
                plate_shear[i] = 0.0
        travel, load = 0.0, 0.0
        for i in range(number):
            if passed[i] < math.inf:
                continue
            for c in range(3):
                velocity[i, c] += step * force[i, c] / mass[i]
                spin[i, c] += step * torque[i, c] / (0.4 * mass[i] * radius[i] ** 2)
                place[i, c] += step * velocity[i, c]
            travel += mass[i] * velocity[i, 0]
            load += mass[i]
            if openings[0] > 0.0 and place[i, 2] - height < -BELOW:
                passed[i] = now * step
        if load > 0.0:
            mean[now // every, 0] += travel / (load * every)
        mean[now // every, 1] += load / (patch[0] * patch[1] * every)
    return mean


def plate_wave(amplitude: float, frequency: float, angle: float, ellipticity: float) -> np.ndarray:
    """Motion of the plate for `simulate`: amplitude [m], frequency [Hz], throw angle [rad]."""
    along = (-ellipticity * math.sin(angle), math.cos(angle))
    normal = (ellipticity * math.cos(angle), math.sin(angle))
    wave = amplitude * np.array([0.0, *along, *normal])
    wave[0] = 2.0 * math.pi * frequency
    return wave
