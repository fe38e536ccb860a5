"""Where numbers that are fitted to surveys usually lie: where the sets that are shipped have them.

Numbers go with the aperture (`number_sets`), so it is their parts of it that are compared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from functools import cache

from vibroscreen import number_sets
from vibroscreen.config import ScreenConfig
from vibroscreen.sections import BESIDE, Deck, Material, Panel
from vibroscreen.size_classes import SizeClasses
from vibroscreen.units import GRAVITY

__all__ = ["unusual"]

# The sets are few: what lies beyond them all by more than this factor is unusual.
BEYOND = 3.0
# Of a grain in the bed over the aperture, for what goes with grains.
GRAIN = 0.5


def _rate(aperture: float) -> float:
    return math.sqrt(GRAVITY * aperture)


def _length(aperture: float) -> float:
    return aperture


# Numbers of both kinds, in SI and as a part of this; its name, and how much of it is 1 of the part.
SCALES: dict[str, tuple[Callable[[float], float], str, float]] = {
    "passage.velocity": (_rate, "sqrt(g aperture)", 1.0),
    "segregation.velocity": (_rate, "sqrt(g aperture)", 1.0),
    "segregation.dilation": (_length, "the aperture", GRAIN),
    "bed.contact_depth": (_length, "the aperture", 1.0),
}


def unusual(config: ScreenConfig, variables: Collection[str], run: str = "") -> Iterator[str]:
    """Sentences about those of the variables that lie far from where they usually do."""
    aperture = config.decks[0].panels[0].aperture
    for name, (_, scale, _) in SCALES.items():
        told = [one for one in (name, BESIDE[name]) if one in variables]
        if not told:
            continue
        part, (least, most) = _part(config, name, aperture), _span(name)
        if not least / BEYOND <= part <= most * BEYOND:
            values = " and ".join(f"{one} = {config.value_of(one):.3g}" for one in told)
            where = f" in run {run!r}" if run else ""
            side = "below" if part < least else "above"
            yield (
                f"{values} is {part:.2g} of {scale}{where}, far {side} what is usual: fits to "
                f"other screens have {least:.2g} to {most:.2g} of it; look at the units of the "
                "survey, and at what else of the screen is not as it was"
            )


def _part(config: ScreenConfig, name: str, aperture: float) -> float:
    """A number with the part of it that goes with the aperture, over its scale."""
    scale, _, unit = SCALES[name]
    own = config.value_of(name)
    if name == "passage.velocity":
        own = config.passage.velocity_at(aperture)
    return own / scale(aperture) + unit * config.value_of(BESIDE[name])


@cache
def _span(name: str) -> tuple[float, float]:
    """Least and most of a number over its scale, over the sets that are shipped."""
    found = []
    for named in number_sets.names():
        for aperture in number_sets.found(named).range.aperture or ():
            panel = Panel(aperture=aperture, open_area=0.5)
            config = ScreenConfig(
                SizeClasses((0.0, aperture, 4.0 * aperture)),
                decks=(Deck(panels=(panel,)),),
                material=Material(calibration=named),
            )
            found.append(_part(config, name, aperture))
    return min(found), max(found)
