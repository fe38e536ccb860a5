"""Does the calibrated plate answer to stroke, feed, slope and opening as a screen does?

The plate of the particle simulations (`screens/dem_plate.toml`), one number varied at a time, and
the sentence that practice would say of each curve. Nothing is fitted here and nothing was measured:
the curves show what the model makes of settings far from those that it was fitted to.

Run `python engine/validation/practice_curves.py`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from evidence import PICTURES, SCREENS, Section, table
from vibroscreen import Motion, Screen, ScreenConfig
from vibroscreen.sections import Displacement
from vibroscreen.units import DEG, GRAVITY, MM

Array = NDArray[np.float64]
Change = Callable[[ScreenConfig], ScreenConfig]
VELOCITY = 0.21  # m/s, of the bed where it is held: that of the plate as it is
HELD, FREE = "velocity of the bed held", "velocity by `bed`"


@dataclass(frozen=True)
class Curve:
    """A number that is varied over `values`, and what practice says of it.

    place(config, value) is the screen with that value. sizes: recovery is that of the grains finer
    than it [m]; the aperture unless given. also: other settings of the screen, by their name.
    """

    name: str
    values: tuple[float, ...]
    says: str
    place: Callable[[ScreenConfig, float], ScreenConfig]
    sizes: float | None = None
    also: tuple[tuple[str, Change], ...] = ()


def shaken(
    config: ScreenConfig,
    amplitude: float | None = None,
    frequency: float | None = None,
    angle: float | None = None,
) -> ScreenConfig:
    """The same with another linear motion: amplitude [m], frequency [Hz], throw angle [rad]."""
    now = config.motion
    motion = Motion.linear(
        now.amplitude if amplitude is None else amplitude,
        now.frequency if frequency is None else frequency,
        now.throw_angle if angle is None else angle,
    )
    return config.replace(motion=motion)


def thrown(config: ScreenConfig, throw: float) -> ScreenConfig:
    """The same at another throw number of a level deck, by the stroke."""
    now = config.motion
    speed = 2.0 * math.pi * now.frequency
    return shaken(config, throw * GRAVITY / (speed**2 * math.sin(now.throw_angle)))


def fed(config: ScreenConfig, factor: float) -> ScreenConfig:
    """The same with so many times the feed."""
    rate = factor * config.feed.mass_flow_rate
    return config.replace(feed=dataclasses.replace(config.feed, mass_flow_rate=rate))


def opened(config: ScreenConfig, aperture: float) -> ScreenConfig:
    """The same with another aperture [m] and the velocity of passage that goes with it."""
    factor = math.sqrt(aperture / config.decks[0].panels[0].aperture)
    values = {
        "deck[1].panel[1].aperture": aperture,
        "passage.velocity": factor * config.value_of("passage.velocity"),
    }
    return config.with_values(values)


def setting(name: str) -> Callable[[ScreenConfig, float], ScreenConfig]:
    """How a number of the configuration is set."""
    return lambda config, value: config.with_values({name: value})


def spaced(start: float, stop: float, count: int = 21) -> tuple[float, ...]:
    """Evenly spaced values."""
    return tuple(float(value) for value in np.linspace(start, stop, count))


WIDE_STROKE = (("stroke 12 mm", lambda config: shaken(config, 6.0 * MM)),)
HALF_FEED = (("half the feed", lambda config: fed(config, 0.5)),)
CURVES = (
    Curve(
        "throw number",
        spaced(0.75, 6.0, 22),
        "best at 3 to 3.5, nothing where the deck hardly throws",
        thrown,
        also=HALF_FEED,
    ),
    Curve(
        "stroke, mm",
        spaced(2.0, 16.0),
        "a wider stroke helps, until the bed flies too long",
        lambda config, value: shaken(config, amplitude=0.5 * value * MM),
        also=HALF_FEED,
    ),
    Curve(
        "frequency, Hz",
        spaced(6.0, 26.0),
        "faster helps, until the bed misses the deck",
        lambda config, value: shaken(config, frequency=value),
        also=HALF_FEED,
    ),
    Curve(
        "throw angle, degrees",
        spaced(20.0, 90.0),
        "best at 30 to 45 degrees: steeper ones convey less",
        lambda config, value: shaken(config, angle=value * DEG),
    ),
    Curve(
        "feed, of the base feed",
        spaced(0.05, 2.0, 27),
        "overfed it collapses; a wide stroke on a bare deck loses too",
        fed,
        also=WIDE_STROKE,
    ),
    Curve(
        "inclination, degrees",
        spaced(0.0, 16.0),
        "steeper is thinner, then too fast for near-size",
        lambda config, value: setting("deck[1].panel[1].inclination")(config, value * DEG),
    ),
    Curve(
        "open area",
        spaced(0.15, 0.75),
        "more open area, more passes; ever less is gained",
        setting("deck[1].panel[1].open_area"),
    ),
    Curve(
        "aperture, mm (recovery below 5.5 mm)",
        spaced(6.0, 16.0),
        "the wider the opening, the less is lost of the fines",
        lambda config, value: opened(config, value * MM),
        sizes=5.25 * MM,
    ),
    Curve(
        "width, mm",
        spaced(30.0, 200.0),
        "a wider deck carries a thinner bed",
        lambda config, value: setting("deck[1].width")(config, value * MM),
    ),
    Curve(
        "length, m",
        spaced(0.1, 2.5),
        "length brings efficiency, ever less of it",
        setting("deck[1].panel[1].length"),
    ),
)


def base() -> ScreenConfig:
    """The plate as it is shipped."""
    return ScreenConfig.load(SCREENS / "dem_plate.toml")


def held(config: ScreenConfig) -> ScreenConfig:
    """The same with a bed that rides at VELOCITY whatever is varied."""
    config = config.with_values({"deck[1].panel[1].velocity_factor": 1.0})
    return config.replace(displacement=Displacement("prescribed", VELOCITY))


def recovery(config: ScreenConfig, sizes: float | None = None) -> float:
    """Recovery of what is finer than the aperture, or than `sizes` [m]."""
    result = Screen(config).solve_steady()
    limit = config.decks[0].panels[0].aperture if sizes is None else sizes
    fraction = np.array(config.feed.mass_fraction) * (config.size_classes.mean < limit)
    return float(result.recovery @ fraction / fraction.sum())


def lines(curve: Curve) -> dict[str, Array]:
    """Recoveries over the values of a curve: velocity held, by `bed`, and with other settings."""

    screens = [curve.place(base(), value) for value in curve.values]

    def over(*changes: Change) -> Array:
        found = []
        for screen in screens:
            for change in changes:
                screen = change(screen)
            found.append(recovery(screen, curve.sizes))
        return np.array(found)

    alone = {HELD: over(held), FREE: over()}
    return alone | {f"{name}, {HELD}": over(change, held) for name, change in curve.also}


def draw(found: dict[str, dict[str, Array]], path: Path) -> None:
    """All curves on one page, each under the sentence of practice."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(17, 8), layout="constrained")
    for axes, curve in zip(figure.subplots(2, 5, sharey=True).flat, CURVES, strict=True):
        for (name, values), style in zip(
            found[curve.name].items(), ("C0", "C1--", "C2:"), strict=False
        ):
            label = name.removesuffix(f", {HELD}").replace("`", "")
            axes.plot(curve.values, values, style, label=label)
        axes.set(xlabel=curve.name, ylim=(0.0, 1.02))
        axes.set_title(fill(curve.says, 36), fontsize=9)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    figure.supylabel("undersize recovered")
    figure.savefig(path, dpi=100)


def best(curve: Curve, values: Array) -> str:
    """Where a line has its best, if that lies inside."""
    at = int(np.nanargmax(values))
    return f"{curve.values[at]:.3g}" if 0 < at < len(values) - 1 else "at the end"


def write(pictures: Path) -> str:
    """Section of VALIDATION.md."""
    found = {curve.name: lines(curve) for curve in CURVES}
    draw(found, pictures / "practice_curves.png")
    rows = [
        (
            curve.name,
            curve.says,
            *(f"{found[curve.name][HELD][k]:.2f}" for k in (0, len(curve.values) // 2, -1)),
            best(curve, found[curve.name][HELD]),
            best(curve, found[curve.name][FREE]),
        )
        for curve in CURVES
    ]
    head = ("varied", "practice", "first", "middle", "last", "best", "best, v of `bed`")
    return f"""\
The calibrated plate, one number varied at a time, and what practice says of it. Nothing is fitted
or measured here: these are the trends of the model, far beyond the cases that it was fitted to. The
bed rides at {VELOCITY:g} m/s, that of the plate as it is, or as fast as the model `bed` says.
Undersize recovered at the first, the middle and the last value, and where it is best:

{table(head, rows)}
![Recovery over what can be set](practice_curves.png)
"""


SECTION = Section("What practice would say", "python engine/validation/practice_curves.py", write)


def main(
    pictures: Annotated[Path, typer.Option(help="Folder of the picture.")] = PICTURES,
) -> None:
    """Draw the curves and print the table."""
    pictures.mkdir(parents=True, exist_ok=True)
    print(write(pictures))


if __name__ == "__main__":
    typer.run(main)
