"""The standard size of a screen for a duty: the smallest that recovers what is wanted.

A duty is the file of a screen: feed, gradation, decks with their media, motion. Widths and lengths
are tried over a list of makers' sizes; all of a box's panels keep their shares of its length.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.screen import Screen
from vibroscreen.sizing_rules import rules_of
from vibroscreen.steady import SteadyResult
from vibroscreen.sweep import solve_steady_many
from vibroscreen.units import GRAVITY, KN, KW, MM

__all__ = ["LENGTHS", "WIDTHS", "Choice", "choose", "resized"]

# Sizes that makers list, m: 4 to 14 ft wide, 8 to 28 ft long in steps of 2 ft, rounded as in metric
# lists.
WIDTHS = (1.2, 1.5, 1.8, 2.1, 2.4, 3.0, 3.6, 4.2)
LENGTHS = (2.4, 3.0, 3.6, 4.2, 4.8, 5.4, 6.0, 6.6, 7.2, 7.8, 8.4)
SHARP = 1e-5
FAR = 1.5  # areas that differ by more are told of
# Springs of vibrating screens give way by some 30 to 60 mm under the weight; an assumption.
SPRING_DEFLECTION = 50.0 * MM


@dataclass(frozen=True)
class Choice:
    """The size that was chosen, and what else there is.

    config: the screen of that size; steady: its steady state at a tolerance of 1e-5. smaller: the
    next smaller size, which recovers too little or carries too deep a bed, None if there is none.
    table: all sizes by area. vsma_area: what VSMA asks for at 95 % [m2], of the deck that asks for
    most. support_force: amplitude of the force on the supports [N] of a box on springs that its
    weight compresses by 50 mm.
    """

    config: ScreenConfig
    steady: SteadyResult
    smaller: pd.Series[Any] | None
    table: pd.DataFrame
    vsma_area: float
    support_force: float

    @property
    def beside_vsma(self) -> str:
        """Why the area is not within a factor of 1.5 of VSMA's; "" where it is."""
        deck = self.config.decks[0]
        ratio = deck.width * deck.length / self.vsma_area if self.vsma_area > 0.0 else 1.0
        if 1.0 / FAR <= ratio <= FAR:
            return ""
        names = [str(name) for name in self.table if str(name).endswith(".efficiency")]
        like = self.table.iloc[int((self.table["area_m2"] - self.vsma_area).abs().argmin())]
        found = ", ".join(f"{name.removesuffix('.efficiency')} {like[name]:.3f}" for name in names)
        size = f"{like['width_m']:g} x {like['length_m']:g} m"
        if ratio < 1.0:
            return f"the model already recovers that much: a deck near VSMA's area, {size}, {found}"
        return (
            f"on a deck near VSMA's area, {size}, the model recovers {found}: grains a little "
            "finer than the opening take most of the length"
        )


def resized(config: ScreenConfig, width: float, length: float) -> ScreenConfig:
    """The same screen on decks of another width and length [m]; the box weighs by its area."""
    first = config.decks[0]
    share = width * length / (first.width * first.length)
    decks = tuple(
        dataclasses.replace(
            deck,
            width=width,
            panels=tuple(
                dataclasses.replace(panel, length=panel.length * length / deck.length)
                for panel in deck.panels
            ),
        )
        for deck in config.decks
    )
    mass = config.drive.vibrating_mass * share
    drive = dataclasses.replace(config.drive, vibrating_mass=mass)
    return config.replace(decks=decks, drive=drive)


def choose(
    config: ScreenConfig, efficiency: float = 0.95, bed_over_aperture: float | None = None
) -> Choice:
    """The smallest standard size on which every deck recovers `efficiency` of its undersize.

    bed_over_aperture: the deepest bed at the discharge in apertures; unless given, what the alarm
    for bed depth allows. The smallest is that of least area, of equal areas the narrower. Raises
    InputError where no size does, and says what the largest one reaches.
    """
    if not 0.0 < efficiency < 1.0:
        raise InputError(
            f"efficiency = {efficiency:g} is out of range (above 0 to below 1): give a share, 0.95 "
            "for 95 %",
            "efficiency",
        )
    sizes = sorted(
        ((w, length) for w in WIDTHS for length in LENGTHS if length > w),
        key=lambda size: (size[0] * size[1], size[0]),
    )
    sharp = config.with_values({"solver.tolerance": min(SHARP, config.solver.tolerance)})
    designs = [resized(sharp, *size) for size in sizes]
    solved = solve_steady_many(designs, refused="mark")
    table = pd.DataFrame({"width_m": [w for w, _ in sizes], "length_m": [n for _, n in sizes]})
    table["area_m2"] = table["width_m"] * table["length_m"]
    for deck in solved.decks:
        table[f"deck[{deck.deck}].efficiency"] = deck.efficiency
        table[f"deck[{deck.deck}].bed_over_aperture"] = deck.depth_over_aperture_discharge
    table["drive_power_kw"] = solved.drive_power / KW
    table["exciter_force_kn"] = solved.exciter_force / KN
    recovers = np.all([deck.efficiency >= efficiency for deck in solved.decks], axis=0)
    if bed_over_aperture is None:
        carries = (solved.alarms & 1) == 0  # alarm.bed_depth is the first
    else:
        depths = [deck.depth_over_aperture_discharge for deck in solved.decks]
        carries = np.all([depth <= bed_over_aperture for depth in depths], axis=0)
    good = recovers & carries & ~np.isin(np.arange(len(sizes)), list(solved.refused))
    table["fits"] = good
    if not good.any():
        raise InputError(_none(table, efficiency, solved.refused), "efficiency")
    place = int(np.argmax(good))
    chosen = designs[place].with_values({"solver.tolerance": config.solver.tolerance})
    rate = config.feed.mass_flow_rate
    steady = Screen(designs[place]).solve_steady()
    stiffness = chosen.drive.vibrating_mass * GRAVITY / SPRING_DEFLECTION
    return Choice(
        chosen,
        steady,
        table.iloc[place - 1] if place else None,
        table,
        max(rules.area_at_95 for rules in rules_of(designs[place])) if rate > 0.0 else 0.0,
        stiffness * chosen.motion.amplitude,
    )


def _none(table: pd.DataFrame, efficiency: float, refused: object) -> str:
    """What is said where no size does."""
    names = [str(name) for name in table if str(name).endswith(".efficiency")]
    least = table[names].min(axis=1).to_numpy()
    if not np.isfinite(least).any():
        return f"no size can be run: {refused}"
    best = table.iloc[int(np.nanargmax(least))]
    reached = ", ".join(f"{name} {best[name]:.3f}" for name in names)
    return (
        f"efficiency = {efficiency:g} is reached by no standard size with a bed that is not too "
        f"deep; {best['width_m']:g} x {best['length_m']:g} m reaches {reached}: ask for less, "
        "split the feed over two screens, or change mesh or motion"
    )
