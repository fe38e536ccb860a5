"""A steady state in words, and for machines: the document of `solve --json`, its schema, a table.

The keys of figures follow from `figures.py`: the name in Python and the unit, as keys of a screen
file have it; without a unit it is a share of one or a ratio. null is what there is nothing of.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import vibroscreen
from vibroscreen.cli.terminal import finite
from vibroscreen.config import ScreenConfig
from vibroscreen.fields import from_si
from vibroscreen.figures import ALARMS, DECK, BoxFigures, Figure, figures_of
from vibroscreen.sizing_rules import Rules, rules_of
from vibroscreen.steady import SteadyResult
from vibroscreen.units import DEG, KN, KW, MM, RPM, T_H

__all__ = [
    "Product",
    "calibration",
    "described",
    "document",
    "figure",
    "labels_of",
    "rests_on",
    "rows",
    "schema",
    "streams_of",
    "two_lines",
]

Array = NDArray[np.float64]

FORMAT = 1
# Unit in SI: what keys end in, and what it is of the unit in SI.
UNITS = {
    "1": ("", 1.0),
    "kg": ("_kg", 1.0),
    "m/s": ("_m_s", 1.0),
    "m": ("_mm", MM),
    "kg/s": ("_t_h", T_H),
    "W": ("_kw", KW),
    "N": ("_kn", KN),
}
# Of a steady state only what a run through time has means nothing.
BOX = tuple(figure for figure in figures_of(BoxFigures) if figure.scalar != "balance_error")
RULES = {
    "area_m2": "Area of the deck",
    "vsma_area_m2": "Area that VSMA's factors ask for at an efficiency of 0.95",
    "vsma_efficiency": "Efficiency at which VSMA finds the area enough; 0.95 stands for 0.95 or "
    "more, null for less than 0.70",
    "karra_cut_size_mm": "Cut size by Karra's model",
    "karra_efficiency": "Efficiency by Karra's model",
}


def key_of(figure: Figure) -> str:
    """The key of a figure in the document."""
    return figure.scalar + UNITS[figure.unit][0]


class Product(NamedTuple):
    """Feed or a product: rate [kg/s], mass fractions, sizes that 80 % and half are finer than [m].

    Sizes of the feed are read from straight lines between the limits of its classes.
    """

    rate: float
    fraction: Array
    p80: float
    p50: float

    @property
    def passing(self) -> Array:
        """Finer than every limit of the classes [1]."""
        finer: Array = np.minimum(np.concatenate([[0.0], np.cumsum(self.fraction)]), 1.0)
        return finer


def streams_of(steady: SteadyResult) -> dict[str, Product]:
    """Feed and products by name, from the top of the box down."""
    feed, sizes = steady.feed, [steady.feed_p80, steady.feed_p50]
    found = {"feed": Product(feed.mass_flow_rate, np.array(feed.mass_fraction), *sizes)}
    over = [(steady.oversize, steady.oversize_p80, steady.oversize_p50)]
    over += zip(steady.intermediate, steady.intermediate_p80, steady.intermediate_p50, strict=True)
    for k, (stream, *sizes) in enumerate(over):
        name = f"intermediate[{k}]" if k else "oversize"
        found[name] = Product(stream.mass_flow_rate, stream.mass_fraction, *sizes)
    under = steady.undersize
    sizes = [steady.undersize_p80, steady.undersize_p50]
    found["undersize"] = Product(under.mass_flow_rate, under.mass_fraction, *sizes)
    return found


def described(config: ScreenConfig) -> str:
    """Size, apertures, vibration and feed in a line."""
    top, motion = config.decks[0], config.motion
    apertures = " / ".join(
        "+".join(dict.fromkeys(f"{panel.aperture / MM:g}" for panel in deck.panels))
        for deck in config.decks
    )
    return (
        f"{figure(top.length)} x {figure(top.width)} m, {apertures} mm, "
        f"{figure(top.panels[0].inclination / DEG)} deg, stroke "
        f"{figure(2.0 * motion.amplitude / MM)} mm at {figure(motion.frequency / RPM)} 1/min, "
        f"{figure(config.feed.mass_flow_rate / T_H)} t/h"
    )


def figure(value: float, digits: int = 4) -> str:
    """A number with so many digits, a dash for none; never a power of ten."""
    if not math.isfinite(value):
        return "-"
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text else text


def rests_on(config: ScreenConfig) -> str:
    """What the numbers of the model were fitted to, in a sentence."""
    named = config.calibration
    error = "" if named.rmse is None else f", error of a recovery {named.rmse:g}"
    survey = "; vibroscreen calibrate fits them to a survey" if named.shipped else ""
    return f'"{named.name}", fitted to {named.fitted_to or "nothing that is said"}{error}{survey}'


def labels_of(decks: int) -> list[str]:
    """What people call feed and products of a box, in the order of `streams_of`."""
    if decks == 1:
        return ["feed", "oversize", "undersize"]
    return ["feed", *(f"over deck {k}" for k in range(1, decks + 1)), f"through deck {decks}"]


def two_lines(label: str) -> str:
    """A label over two lines of the head of a table."""
    return label.replace(" ", "\n", 1) if " " in label else f"\n{label}"


# --- the document --------------------------------------------------------------------------------
def document(steady: SteadyResult) -> dict[str, Any]:
    """A steady state as `schema` describes it, for `json.dumps`."""
    config = steady.config
    fed = steady.feed.mass_flow_rate
    streams = {
        name: {
            "rate_t_h": finite(stream.rate / T_H),
            "share_of_feed": finite(stream.rate / fed),
            "p80_mm": finite(stream.p80 / MM),
            "p50_mm": finite(stream.p50 / MM),
            "mass_fraction": [finite(value) for value in stream.fraction],
            "passing": [finite(value) for value in stream.passing],
        }
        for name, stream in streams_of(steady).items()
    }
    return {
        "format": FORMAT,
        "version": vibroscreen.__version__,
        "name": config.name,
        "edges_mm": [from_si(edge, MM) for edge in config.size_classes.edges],
        "streams": streams,
        "recovery": [finite(value) for value in steady.recovery],
        "decks": [
            {
                "deck": deck.deck,
                **_figures(deck, DECK),
                "sizing_rules": _rules(rules),
            }
            for deck, rules in zip(steady.decks, rules_of(config), strict=True)
        ],
        "box": _figures(steady, BOX),
        "calibration": calibration(config),
        "alarms": [{"name": name, "reason": why} for name, why in steady.alarm_reasons.items()],
    }


def calibration(config: ScreenConfig) -> dict[str, Any]:
    """What the numbers of the model rest on, for `json.dumps`."""
    named = config.calibration
    return {
        "name": named.name,
        "fitted_to": named.fitted_to,
        "rmse": named.rmse,
        "beyond": config.beyond_calibration(),
    }


def _figures(result: object, figures: Iterable[Figure]) -> dict[str, float | None]:
    return {
        key_of(figure): finite(getattr(result, figure.scalar) / UNITS[figure.unit][1])
        for figure in figures
    }


def _rules(rules: Rules) -> dict[str, Any]:
    values = (
        rules.area,
        rules.area_at_95,
        rules.vsma_recovery,
        rules.cut_size / MM,
        rules.karra_recovery,
    )
    told = dict(zip(RULES, map(finite, values), strict=True))
    return {**told, "beyond": list(rules.beyond)}


# --- its schema ----------------------------------------------------------------------------------
def schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of the document: every key is there, no other."""
    share = {"type": "number", "minimum": 0, "maximum": 1}
    number = {"type": ["number", "null"]}
    stream = _table(
        rate_t_h=_told(number, "Rate"),
        share_of_feed=_told(number, "Rate over that of the feed"),
        p80_mm=_told(number, "Size that 80 % is finer than"),
        p50_mm=_told(number, "Size that half is finer than"),
        mass_fraction=_told(_list(share), "Share of every class, finest first"),
        passing=_told(_list(share), "Finer than every limit of the classes, finest first"),
    )
    rules = {key: _told(number, text) for key, text in RULES.items()}
    beyond = _told(_list({"type": "string"}), "What lies beyond the rules, a sentence each")
    deck = _table(
        deck=_told({"type": "integer", "minimum": 1}, "Its number, from the top"),
        **{key_of(f): _told(number, f.tells.format("k")) for f in DECK},
        sizing_rules=_table(**rules, beyond=beyond),
    )
    named = dict.fromkeys(("feed", "oversize", "undersize"), stream)
    alarms = _table(
        name=_told({"enum": [alarm.name for alarm in ALARMS]}, "Its name, as in an FMU"),
        reason=_told({"type": "string"}, "Why it is set"),
    )
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Steady state of a vibrating screen, as printed by vibroscreen solve --json",
        **_table(
            format=_told({"const": FORMAT}, "Number of this format"),
            version=_told({"type": "string"}, "Version of vibroscreen that wrote it"),
            name=_told({"type": "string"}, "Name of the screen"),
            edges_mm=_told(_list({"type": "number"}), "Limits of the size classes, finest first"),
            streams={
                **_table(**named),
                "description": "Feed and products by NAME: feed, oversize (over deck 1), "
                "intermediate[k] (over deck k + 1), undersize (through the lowest deck)",
                "patternProperties": {r"^intermediate\[\d+\]$": stream},
            },
            recovery=_told(_list(share), "Part of every class that reaches the undersize"),
            decks=_told(_list(deck), "Figures of every deck, top deck first"),
            box=_table(**{key_of(f): _told(number, f.tells) for f in BOX}),
            calibration=_table(
                name=_told({"type": "string"}, "Named set of the numbers of the model"),
                fitted_to=_told({"type": "string"}, "What they were fitted to"),
                rmse=_told(number, "Root mean square error of a recovery there"),
                beyond=_told(_list({"type": "string"}), "What lies beyond it, a sentence each"),
            ),
            alarms=_told(_list(alarms), "Alarms that are set"),
        ),
    }


def _table(**properties: Any) -> dict[str, Any]:
    keys = list(properties)
    return {
        "type": "object",
        "properties": properties,
        "required": keys,
        "additionalProperties": False,
    }


def _list(items: Any) -> dict[str, Any]:
    return {"type": "array", "items": items}


def _told(kind: Mapping[str, Any], text: str) -> dict[str, Any]:
    return {"description": text, **kind}


# --- the table -----------------------------------------------------------------------------------
def rows(steady: SteadyResult) -> list[list[str]]:
    """Head and a row a class: limits [mm], feed and products [t/h], recovery."""
    classes, streams = steady.config.size_classes, streams_of(steady)
    head = ["lower_mm", "upper_mm", *(f"{name}_t_h" for name in streams), "recovery"]
    limits = zip(classes.lower, classes.upper, strict=True)
    return [
        head,
        *(
            [
                f"{from_si(low, MM):g}",
                f"{from_si(high, MM):g}",
                *(f"{s.rate * s.fraction[k] / T_H:.10g}" for s in streams.values()),
                f"{steady.recovery[k]:.10g}",
            ]
            for k, (low, high) in enumerate(limits)
        ),
    ]
