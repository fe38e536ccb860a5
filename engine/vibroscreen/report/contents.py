"""What a report shows of a screen: its steady state, how that stands, and pictures of it."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vibroscreen import registry
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.fields import Choice, Number, entries, nearest
from vibroscreen.practice import GREEN, RED, Finding, findings, sizing_rules
from vibroscreen.report import pictures
from vibroscreen.report.specification import Reading, Specification
from vibroscreen.results import DeckResult
from vibroscreen.sizing_rules import Rules
from vibroscreen.steady import Array, SteadyResult
from vibroscreen.units import DEG, KN, KW, MM, PERCENT, RPM, T_H

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["BOX", "DECK", "Sheet", "Shown"]


class Shown(NamedTuple):
    """A figure of a result, as a report names it and in which unit of `UNITS`."""

    scalar: str
    label: str
    unit: str = ""


# What a unit of a report is in SI; digits that are shown.
UNITS = {
    **dict.fromkeys(("", "kg", "m", "m2", "m/s", "kg/m3"), 1.0),
    **{"%": PERCENT, "mm": MM, "deg": DEG, "t/h": T_H, "kW": KW, "kN": KN, "1/min": RPM},
}
DIGITS = 4
NOTHING = "\N{EN DASH}"
DECK = (
    Shown("feed_rate", "comes to it", "t/h"),
    Shown("undersize_rate", "passes", "t/h"),
    Shown("oversize_rate", "leaves over it", "t/h"),
    Shown("efficiency", "efficiency: undersize that passes", "%"),
    Shown("misplaced_undersize", "undersize left in what leaves over it", "%"),
    Shown("misplaced_oversize", "oversize in what passes", "%"),
    Shown("cut_size", "cut size d50", "mm"),
    Shown("ecart_probable", "ecart probable", "mm"),
    Shown("imperfection", "imperfection"),
)
LOAD = (
    Shown("depth_feed", "bed at the feed end", "mm"),
    Shown("depth_discharge", "bed at the discharge", "mm"),
    Shown("depth_over_aperture_discharge", "the same in apertures"),
    Shown("transport_velocity", "velocity of the bed, first panel", "m/s"),
    Shown("hold_up", "lies on it", "kg"),
    Shown("throw_number", "throw number, first panel"),
)
RULES = (
    Shown("area", "area", "m2"),
    Shown("area_at_95", "VSMA: area for 95 %", "m2"),
    Shown("load", "the same over the area"),
    Shown("vsma_recovery", "VSMA: efficiency, its table has 70 to 95", "%"),
    Shown("karra_recovery", "Karra: efficiency", "%"),
    Shown("cut_size", "Karra: cut size d50", "mm"),
)
BOX = (
    Shown("drive_power", "power of the drive", "kW"),
    Shown("exciter_force", "force of the exciter", "kN"),
    Shown("acceleration_number", "acceleration K"),
    Shown("hold_up", "lies on all decks", "kg"),
)


def text_of(value: float, unit: str = "") -> str:
    """A number in a unit of a report, with four digits, or one behind the point of per cent.

    A dash stands for what there is nothing of.
    """
    number = value / UNITS[unit]
    if not np.isfinite(number):
        return NOTHING
    if unit == "%":
        return f"{number:.1f}"
    return np.format_float_positional(number, DIGITS, unique=False, fractional=False, trim="-")


# What matplotlib would say of a picture, and where it places things to a millionth of a pixel.
METADATA = ("Creator", "Date", "Format", "Type")
ATTRIBUTE = re.compile(r'"[^"]*"')


class Picture(NamedTuple):
    """A picture as a page holds it, its name, and what it says."""

    source: str
    name: str
    says: str


def _picture(figure: Figure, name: str, says: str) -> Picture:
    """A matplotlib figure as SVG in a data URI: an image runs nothing and keeps its ids."""
    out = io.StringIO()
    with pictures.styled():
        figure.savefig(out, format="svg", dpi=200, metadata=dict.fromkeys(METADATA))
    short = re.sub(r"\n\s*", "\n", ATTRIBUTE.sub(_rounded, out.getvalue()))
    text = base64.b64encode(short.encode()).decode("ascii")
    return Picture(f"data:image/svg+xml;base64,{text}", name, says)


def _rounded(attribute: re.Match[str]) -> str:
    """The value of an attribute with two digits behind each point: a hundredth of a pixel."""
    return re.sub(r"(\.\d\d)\d+", r"\1", attribute[0])


class Setting(NamedTuple):
    """A number or choice of the model: the key of the file, its value there, what it means."""

    key: str
    value: str
    tells: str


@dataclass(frozen=True, eq=False)
class Sheet:
    """One screen of a report. mark: which of two it is, as pages and pictures call it."""

    steady: SteadyResult
    specification: tuple[Specification, ...] = ()
    mark: str = ""

    def __post_init__(self) -> None:
        for band in self.specification:
            if band.product not in self.steady.streams:
                known = self.steady.streams
                raise InputError(
                    f"specification: {band.product!r} is no product of this screen: did you mean "
                    f"{nearest(band.product, known)!r}? It has {', '.join(known)}"
                )

    @property
    def config(self) -> ScreenConfig:
        """The screen."""
        return self.steady.config

    @cached_property
    def readings(self) -> tuple[tuple[str, tuple[Reading, ...]], ...]:
        """Products with a specification, and how they stand to it."""
        edges, streams = self.steady.size_classes.edges, self.steady.streams
        return tuple(
            (band.product, band.readings(edges, streams[band.product]))
            for band in self.specification
        )

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """How the screen stands to good practice, and its products to their specification."""
        return (*findings(self.steady), *self._products())

    def _products(self) -> Iterator[Finding]:
        for product, readings in self.readings:
            missed = [
                f"{text_of(r.passing, '%')} % finer than {text_of(r.size, 'mm')} mm, not "
                f"{text_of(r.least, '%')} to {text_of(r.most, '%')} %"
                for r in readings
                if not r.met
            ]
            told = "; ".join(missed) or f"within its limits at {len(readings)} sizes"
            yield Finding(
                RED if missed else GREEN, f"{pictures.product_name(product)}, specification", told
            )

    @property
    def decks(self) -> tuple[DeckResult[float], ...]:
        """Results of every deck."""
        return self.steady.decks

    @cached_property
    def rules(self) -> tuple[Rules, ...]:
        """What the sizing rules say of every deck."""
        return sizing_rules(self.steady)

    @cached_property
    def outside(self) -> list[str]:
        """What lies outside of what the numbers of the model were fitted to."""
        return self.config.beyond_calibration()

    @property
    def calibrated(self) -> bool:
        """Whether a set of the user's own was fitted to all of this."""
        return not (self.config.calibration.shipped or self.outside)

    @property
    def motion(self) -> str:
        """The vibration in words."""
        motion = self.config.motion
        frequency, per_minute = motion.frequency, text_of(motion.frequency, "1/min")
        swings = f"{text_of(frequency)} Hz ({per_minute} 1/min)"
        if motion.harmonic:
            return f"{len(motion.harmonic)} harmonics of {swings}"
        shape = {0.0: "linear", 1.0: "circular, with the flow", -1.0: "circular, against the flow"}
        kind = shape.get(motion.ellipticity, f"elliptical ({motion.ellipticity:.3g})")
        way = f"{text_of(motion.throw_angle, 'deg')} deg over the first panel"
        stroke = f"{kind}, stroke {text_of(2.0 * motion.amplitude, 'mm')} mm at {swings}"
        return stroke if abs(motion.ellipticity) == 1.0 else f"{stroke}, {way}"

    @property
    def sizes(self) -> dict[str, tuple[float, ...]]:
        """P80 and P50 of the feed and of the products in their order [m]."""
        steady = self.steady
        fine = (steady.undersize_p80, *steady.intermediate_p80, steady.oversize_p80)
        half = (steady.undersize_p50, *steady.intermediate_p50, steady.oversize_p50)
        return {"P80": (steady.feed_p80, *fine), "P50": (steady.feed_p50, *half)}

    # --- pictures ----------------------------------------------------------------------------
    def _drawn(self, draw: Callable[..., None], name: str, says: str, *more: Any) -> Picture:
        return _picture(pictures.picture(draw, self.steady, *more), name, says)

    @cached_property
    def sketch(self) -> Picture:
        """The decks from the side."""
        height = pictures.sketch_height(self.config)
        figure = pictures.picture(pictures.draw_sketch, self.config, self.steady, height=height)
        return _picture(
            figure,
            "The screen from the side",
            "From the side. Lengths and slopes are to scale; the distance between decks and the "
            "size of the stroke are not.",
        )

    @cached_property
    def gradation(self) -> Picture:
        """Gradations of feed and products."""
        says = "Gradations at the limits of the size classes."
        figure = pictures.picture(
            pictures.draw_gradation, self.steady, self.specification, height=1.15 * pictures.HEIGHT
        )
        return _picture(figure, "Gradations", says)

    @cached_property
    def partition(self) -> Picture:
        """Partition of each deck."""
        says = "Partition: of each size that comes to a deck, the part that leaves over it. "
        says += "Dotted: its aperture; diamond: its cut size d50."
        return self._drawn(pictures.draw_partition, "Partition curves", says)

    @cached_property
    def recovery(self) -> Picture:
        """Undersize recovered along each deck."""
        says = "Of the undersize that comes to a deck, the share that has passed it up to a place."
        return self._drawn(pictures.draw_recovery, "Recovery along the decks", says)

    @cached_property
    def bed(self) -> Picture:
        """Depth of the bed along each deck."""
        says = "Depth of the bed. Dash at the discharge: what good practice allows."
        return self._drawn(pictures.draw_bed, "Depth of the bed along the decks", says)

    @cached_property
    def maps(self) -> tuple[Picture, ...]:
        """Where fines and near-size grains lie in the bed of each deck; none without layers."""
        if not registry.model("segregation", self.config.segregation.model).layered:
            return ()
        return tuple(
            self._drawn(
                pictures.draw_map, f"Map of the bed of deck {deck.deck}", says, deck.deck, classes
            )
            for deck in self.steady.decks
            if deck.feed_rate > 0.0
            for says, classes in _mapped(self.steady.size_classes.upper, deck.aperture)
        )

    # --- what it rests on --------------------------------------------------------------------
    @cached_property
    def settings(self) -> tuple[Setting, ...]:
        """Choices and numbers of the model that act, as the file has them."""
        return tuple(self._settings())

    def _settings(self) -> Iterator[Setting]:
        for name in ("material", "displacement", "passage", "segregation", "bed", "solver"):
            section = getattr(self.config, name)
            known = getattr(section, "effective", {})
            for field, entry in entries(type(section)).items():
                value = known.get(field, getattr(section, field))
                if isinstance(entry, Choice) and entry.tells:
                    meaning = dict(zip(entry.names(), entry.meanings, strict=False)).get(value, "")
                    yield Setting(f"{name}.{entry.key}", value, f"{entry.tells}: {meaning}")
                elif isinstance(entry, Number) and entry.tells and value and self._acts(entry):
                    shown = f"{entry.write(value):.6g}"
                    yield Setting(f"{name}.{entry.key}", shown, entry.tells)

    def _acts(self, entry: Number) -> bool:
        """Whether a number is of the models that were chosen, as far as its text says."""
        chosen = {
            "passage law": self.config.passage.law,
            "segregation model": self.config.segregation.model,
            "displacement model": self.config.displacement.model,
        }
        for family, name in chosen.items():
            _, there, of = entry.tells.partition(f"used by the {family} ")
            if there and of.split()[0] != name:
                return False
        return True


def _mapped(upper: Array, aperture: float) -> Iterator[tuple[str, slice]]:
    """Classes whose place in the bed is drawn: those below half the aperture, the last below it."""
    half, whole = (
        int(np.searchsorted(upper, share * aperture * (1.0 + 1e-9), "right"))
        for share in (0.5, 1.0)
    )
    if half > 0:
        yield "Fines, finer than half the aperture.", slice(0, half)
    if whole > half:
        yield "Near-size grains, the class below the aperture.", slice(whole - 1, whole)


def settings_of(sheets: Sequence[Sheet]) -> Iterator[tuple[str, str, list[str]]]:
    """Settings of one or more screens by key: the key, what it means, the value of each."""
    by_key = [{one.key: one for one in sheet.settings} for sheet in sheets]
    for key in dict.fromkeys(key for one in by_key for key in one):
        told = next(one[key].tells for one in by_key if key in one)
        yield key, told, [one[key].value if key in one else NOTHING for one in by_key]
