"""Every FMI variable of a screen, said once: name, place, type, unit, limits and meaning.

The value reference of a variable is its place in the buffer, counted from the first parameter:
parameters, inputs and outputs lie there in a row. Names, units and limits that the engine knows are
taken from it; rows follow decks, panels and size classes, so that more of them are only more rows.
Where decks have different numbers of panels, the buffer has room that no panel fills: references
are skipped there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vibroscreen import registry
from vibroscreen.config import Bed, ScreenConfig
from vibroscreen.fields import Choice, Entry, Number, Numbers, Section, entries
from vibroscreen.kernels.state import (
    DECK_BED,
    DIMENSION,
    INPUT,
    INTERMEDIATE,
    OUTPUT,
    PANEL,
    PARAMETER,
    Layout,
)
from vibroscreen.kernels.step import INPUT_LIMITS, ROUND_OFF
from vibroscreen.registry import BUILT_IN
from vibroscreen.screen import VARIABLE, fill, nodes_of
from vibroscreen_fmu.port import Enumeration, Port, Steps

__all__ = ["ENUMERATIONS", "ports"]

Limits = tuple[float | None, float | None]
Place = tuple[str, *tuple[int, ...]]


def _enumeration(name: str, items: tuple[str, ...], *meanings: str) -> Enumeration:
    return Enumeration(name, tuple(zip(items, meanings, strict=True)))


def _choices(entry: Entry) -> tuple[str, ...]:
    assert isinstance(entry, Choice)
    return entry.names()


ENUMERATIONS = {
    "passage.law": _enumeration(
        "PassageLaw",
        BUILT_IN["passage"],
        "every grain tries an opening alone",
        "a fine grain may pass together with another one",
        "grains bounce, are guided by the rim and crowd in the openings",
    ),
    "segregation.model": _enumeration(
        "SegregationModel",
        BUILT_IN["segregation"],
        "the bed has the same composition at every height",
        "a given share of the bed is sorted, the rest is mixed",
        "layers exchange grains as fine ones percolate through the gaps between coarse ones",
        "the finest grains lie on the screen at once",
    ),
    "displacement.model": _enumeration(
        "DisplacementModel",
        BUILT_IN["displacement"],
        "the bed moves at displacement.velocity",
        "the bed moves as a rigid body on the vibrating deck",
        "the bed moves as grains that land softly and slip by speed",
    ),
    "bed.initial": _enumeration(
        "InitialBed",
        _choices(entries(Bed)["initial"]),
        "the decks are empty at the start",
        "the decks are full of the feed given at the start",
    ),
}


@dataclass(frozen=True)
class _Meaning:
    """What a reader is told about a variable, and how it behaves."""

    description: str
    variability: str = "fixed"
    kind: str = "Real"
    display: bool = True


_TUNABLE = "tunable"

_PARAMETERS = {
    "bulk_density": _Meaning("Mass of the bed over the volume it fills"),
    "friction_deck": _Meaning("Friction coefficient between bed and deck", _TUNABLE),
    "friction_internal": _Meaning("Friction coefficient inside the bed", _TUNABLE),
    "rolling": _Meaning(
        "Share of the deck's grip that rolling grains take, used by the displacement model bed",
        _TUNABLE,
    ),
    "passage_law": _Meaning("How the chance of a grain to pass follows from its size"),
    "passage_velocity": _Meaning(
        "Velocity at which grains fall through the openings; scales how fast the screen works",
        _TUNABLE,
    ),
    "passage_rim": _Meaning(
        "How far the rim of an opening guides a grain in, used by the passage law bounce", _TUNABLE
    ),
    "passage_passing_time": _Meaning(
        "Time for which a grain takes up an opening, used by the passage law bounce", _TUNABLE
    ),
    "passage_drift": _Meaning(
        "How the bed carries grains over the openings, used by the passage law bounce", _TUNABLE
    ),
    "passage_damping": _Meaning(
        "How a deep bed keeps grains from bouncing, used by the passage law bounce", _TUNABLE
    ),
    "passage_lift": _Meaning(
        "How high the vibration throws the bed, used by the passage law bounce", _TUNABLE
    ),
    "passage_stirring": _Meaning(
        "How riding on frees bed and openings, used by the passage law bounce", _TUNABLE
    ),
    "passage_calming": _Meaning(
        "How much lower a deep bed is thrown, used by the passage law bounce", _TUNABLE
    ),
    "passage_depletion": _Meaning(
        "How a deep bed runs short of passing grains at the deck, used by the passage law bounce",
        _TUNABLE,
    ),
    "passage_levelling": _Meaning(
        "Contact depth over the most that the deck shakes of a bed, used by the passage law bounce",
        _TUNABLE,
    ),
    "segregation_model": _Meaning("How fine grains find their way down through the bed"),
    "segregation_velocity": _Meaning(
        "Velocity at which fine grains percolate down through the bed", _TUNABLE
    ),
    "segregation_dilation": _Meaning(
        "Extra distance between grains by shaking; opens the gaps for fine grains", _TUNABLE
    ),
    "segregation_relative_dilation": _Meaning(
        "Extra distance between grains by shaking, over their mean size", _TUNABLE
    ),
    "segregation_mixing": _Meaning(
        "Velocity at which layers exchange grains whatever their size", _TUNABLE
    ),
    "segregation_proportion": _Meaning(
        "Sorted share of the bed, used by the segregation model proportional", _TUNABLE
    ),
    "displacement_model": _Meaning("How the velocity of the bed along the deck is found"),
    "contact_depth": _Meaning("Depth of the layer from which grains can reach the openings"),
    "layer_depth": _Meaning("Depth of the layers above, the mixing length of the bed"),
    "initial": _Meaning(
        "What lies on the decks at the start; 2: when initialisation ends the screen is in the "
        "steady state of the feed and the vibration given until then"
    ),
    "vibrating_mass": _Meaning("Mass of the vibrating box"),
    "bearing_friction": _Meaning("Friction coefficient of the exciter's bearings"),
    "bearing_diameter": _Meaning("Diameter at which the bearings rub"),
    "drive_efficiency": _Meaning("Mechanical over electric power of the drive"),
    "tolerance": _Meaning(
        "Bound on the numerical error of a recovery; also what a host gives as tolerance"
    ),
    "subdivision": _Meaning(
        "Sizes that stand for a class: 1 its mean, 0 chosen by the engine", "constant", "Integer"
    ),
}
_PANELS = {
    "length": _Meaning("Length of the panel along the deck", display=False),
    "inclination": _Meaning("Inclination of the panel, positive down to the discharge", _TUNABLE),
    "aperture": _Meaning("Clear opening of the screening medium"),
    "open_area": _Meaning(
        "Useful openings over the area of the panel; less when they blind", _TUNABLE
    ),
    "velocity_factor": _Meaning(
        "Factor on the velocity of the bed that the displacement model gives", _TUNABLE
    ),
}
_INPUTS = {
    "feed_rate": _Meaning("Feed to the top deck"),
    "frequency": _Meaning("Frequency of the vibration"),
    "amplitude": _Meaning("Amplitude of the vibration: semi-major axis, half the stroke"),
    "throw_angle": _Meaning("Direction of the vibration over the top deck's first panel"),
    "ellipticity": _Meaning(
        "Shape of the orbit: 0 linear, 1 circular with the flow, -1 circular against it"
    ),
    "displacement_velocity": _Meaning(
        "Velocity of the bed along the deck, used by the displacement model prescribed"
    ),
}


def _alarm(description: str) -> _Meaning:
    return _Meaning(description, "discrete", "Boolean")


# Outputs: name, unit and meaning.
_OUTPUTS = {
    "undersize_rate": (
        "undersize.mass_flow_rate",
        "kg/s",
        _Meaning("What falls through the lowest deck, mean over the last step"),
    ),
    "oversize_rate": (
        "oversize.mass_flow_rate",
        "kg/s",
        _Meaning("What leaves over the top deck, mean over the last step"),
    ),
    "feed_mass": ("feed.mass", "kg", _Meaning("Fed since the start")),
    "undersize_mass": ("undersize.mass", "kg", _Meaning("Undersize since the start")),
    "oversize_mass": ("oversize.mass", "kg", _Meaning("Oversize since the start")),
    "hold_up": ("bed.hold_up", "kg", _Meaning("What lies on all decks")),
    "depth_feed": ("bed.depth_feed", "m", _Meaning("Depth of the top deck's bed at the feed end")),
    "depth_discharge": (
        "bed.depth_discharge",
        "m",
        _Meaning("Depth of the top deck's bed at the discharge"),
    ),
    "transport_velocity": (
        "bed.transport_velocity",
        "m/s",
        _Meaning("Velocity of the bed along the first panel of the top deck"),
    ),
    "throw_number": (
        "motion.throw_number",
        "1",
        _Meaning("Largest acceleration normal to the deck over that of gravity; throws above 1"),
    ),
    "undersize_recovery": (
        "performance.undersize_recovery",
        "1",
        _Meaning(
            "Share of what is fed finer than the top deck's smallest aperture that fell through "
            "the lowest deck in the last step"
        ),
    ),
    "efficiency": (
        "performance.efficiency",
        "1",
        _Meaning(
            "Efficiency of the top deck: share of what is fed finer than its smallest aperture "
            "that passed this deck in the last step; without feed the last one stays"
        ),
    ),
    "cut_size": (
        "performance.cut_size",
        "m",
        _Meaning("Size of which half leaves over the top deck"),
    ),
    "ecart_probable": (
        "performance.ecart_probable",
        "m",
        _Meaning(
            "Half the distance between the sizes of which 75 % and 25 % leave over the top deck"
        ),
    ),
    "drive_power": (
        "drive.power",
        "W",
        _Meaning("Electric power of the drive, under the load at the end of the step"),
    ),
    "balance_error": (
        "balance.error",
        "kg",
        _Meaning("Fed less discharged less held since the start: round-off only"),
    ),
    "alarm_bed_depth": (
        "alarm.bed_depth",
        "1",
        _alarm("The bed of a deck is deeper than four apertures at the discharge"),
    ),
    "alarm_capacity": (
        "alarm.capacity",
        "1",
        _alarm("The bed of a deck is deeper than the layers of the model can hold"),
    ),
    "alarm_transport": (
        "alarm.transport",
        "1",
        _alarm(
            "The vibration does not convey the bed down a deck, or the displacement model bed is "
            "used outside of what it was checked for"
        ),
    ),
    "alarm_performance": (
        "alarm.performance",
        "1",
        _alarm("Cut size or ecart probable lie outside of the size classes"),
    ),
}
# Outputs of the stream over every lower deck, and of the bed on every deck: the last part of the
# name, unit and meaning; decks are counted from the top.
_INTERMEDIATE = {
    "rate": ("mass_flow_rate", "kg/s", "What leaves over deck {}, mean over the last step"),
    "mass": ("mass", "kg", "Left over deck {} since the start"),
}
_DECK_BED = {
    "hold_up": ("hold_up", "kg", "What lies on deck {}"),
    "depth_feed": ("depth_feed", "m", "Depth of the bed on deck {} at the feed end"),
    "depth_discharge": ("depth_discharge", "m", "Depth of the bed on deck {} at the discharge"),
    "transport_velocity": (
        "transport_velocity",
        "m/s",
        "Velocity of the bed along the first panel of deck {}",
    ),
}
_LIMITS_OF_INPUT = {
    INPUT[index]: (0.0 if least == -ROUND_OFF else least, most)
    for index, least, most in INPUT_LIMITS
}
_STREAMS = {
    "undersize": "Mass fraction of class {} in what falls through the lowest deck",
    "oversize": "Mass fraction of class {} in what leaves over the top deck",
}
_FRACTION_LIMITS = (0.0, 1.0)
_NO_LIMITS: Limits = (None, None)


@dataclass(frozen=True)
class _Row:
    """A variable before it has a place: which number of which field of the buffer it is."""

    name: str
    place: Place
    causality: str
    unit: str
    meaning: _Meaning
    limits: Limits = _NO_LIMITS
    path: Steps = ()


def ports(config: ScreenConfig) -> tuple[Port, ...]:
    """The FMI variables of a screen in the order of their value references."""
    nodes = nodes_of(config)
    # Room for the state does not matter here: it lies behind the variables.
    given = {
        "classes": config.size_classes.count,
        "nodes": nodes.count,
        "decks": len(config.decks),
        "panels": max(len(deck.panels) for deck in config.decks),
    }
    layout = Layout(dict.fromkeys(DIMENSION, 1) | given)
    buffer = layout.buffer()
    fill(layout, buffer, config, nodes)
    first = layout.section["parameters"].start

    def port(row: _Row) -> Port:
        title, *index = row.place
        place = layout.offset[title] + int(np.ravel_multi_index(index, layout.shape[title]))
        enumeration = _choices_of(row, float(buffer[place]))
        return Port(
            name=row.name,
            reference=place - first,
            description=row.meaning.description,
            causality=row.causality,
            variability=row.meaning.variability,
            kind="Enumeration" if enumeration else row.meaning.kind,
            unit=row.unit,
            display=row.meaning.display,
            least=row.limits[0],
            most=row.limits[1],
            start=None if row.causality == "output" else float(buffer[place]),
            enumeration=enumeration,
            path=row.path,
        )

    rows = (*_parameters(config), *_inputs(config), *_outputs(config))
    return tuple(sorted(map(port, rows), key=lambda port: port.reference))


def _choices_of(row: _Row, chosen: float) -> Enumeration | None:
    """The choices of a variable: what is built in, and what a user registered up to `chosen`."""
    built_in = ENUMERATIONS.get(row.name)
    if built_in is None or chosen <= len(built_in.items):
        return built_in
    own = registry.names(row.name.partition(".")[0])[len(built_in.items) : int(chosen)]
    return Enumeration(built_in.name, (*built_in.items, *((name, "one's own") for name in own)))


def _parameters(config: ScreenConfig) -> Iterator[_Row]:
    for index, scalar in enumerate(PARAMETER):
        name, unit, _ = VARIABLE["parameter", scalar]
        meaning = _PARAMETERS[scalar]
        causality = "local" if meaning.variability == "constant" else "parameter"
        path: Steps = tuple(name.split("."))
        limits = _limits(path)
        yield _Row(name, ("parameter", index), causality, unit or "1", meaning, limits, path)
    for i in range(config.size_classes.count):
        for title, edge in (("lower", i), ("upper", i + 1)):
            meaning = _Meaning(f"{title.capitalize()} limit of size class {i + 1}")
            path = ("size_classes", "edges", edge)
            name = f"size_class[{i + 1}].{title}"
            yield _Row(name, (title, i), "parameter", "m", meaning, _limits(path), path)
    for d, deck in enumerate(config.decks):
        path = ("decks", d, "width")
        meaning = _Meaning(f"Width of deck {d + 1}, counted from the top", display=False)
        name = f"deck[{d + 1}].width"
        yield _Row(name, ("width", d), "parameter", "m", meaning, _limits(path), path)
        for p in range(len(deck.panels)):
            for index, scalar in enumerate(PANEL):
                short, unit, _ = VARIABLE["panel", scalar]
                path = ("decks", d, "panels", p, scalar)
                name = f"deck[{d + 1}].panel[{p + 1}].{short}"
                place = ("panel", d, p, index)
                meaning = _PANELS[scalar]
                yield _Row(name, place, "parameter", unit or "1", meaning, _limits(path), path)


def _inputs(config: ScreenConfig) -> Iterator[_Row]:
    for index, scalar in enumerate(INPUT):
        name, unit, _ = VARIABLE["input", scalar]
        meaning = _continuous(_INPUTS[scalar])
        limits = _LIMITS_OF_INPUT[scalar]
        yield _Row(name, ("input", index), "input", unit or "1", meaning, limits)
    for i in range(config.size_classes.count):
        text = f"Mass fraction of class {i + 1} in the feed; ignored while nothing is fed"
        meaning = _continuous(_Meaning(text))
        name = f"feed.mass_fraction[{i + 1}]"
        yield _Row(name, ("fraction", i), "input", "1", meaning, _FRACTION_LIMITS)


def _outputs(config: ScreenConfig) -> Iterator[_Row]:
    for index, scalar in enumerate(OUTPUT):
        name, unit, meaning = _OUTPUTS[scalar]
        yield _Row(name, ("output", index), "output", unit, _continuous(meaning))
    for stream, text in _STREAMS.items():
        yield from _fractions(config, stream, (f"{stream}_fraction",), text)
    for k in range(len(config.decks) - 1):
        below = k + 2  # the deck that it leaves over
        for index, scalar in enumerate(INTERMEDIATE):
            short, unit, text = _INTERMEDIATE[scalar]
            name, meaning = f"intermediate[{k + 1}].{short}", _Meaning(text.format(below))
            yield _Row(name, ("intermediate", k, index), "output", unit, _continuous(meaning))
        text = f"Mass fraction of class {{}} in what leaves over deck {below}"
        yield from _fractions(config, f"intermediate[{k + 1}]", ("intermediate_fraction", k), text)
    for d in range(len(config.decks)):
        for index, scalar in enumerate(DECK_BED):
            short, unit, text = _DECK_BED[scalar]
            name, meaning = f"deck[{d + 1}].bed.{short}", _Meaning(text.format(d + 1))
            yield _Row(name, ("deck_bed", d, index), "output", unit, _continuous(meaning))


def _fractions(config: ScreenConfig, stream: str, place: Place, text: str) -> Iterator[_Row]:
    """Composition of a stream; `text` says it for a class, `place` is that of the stream."""
    for i in range(config.size_classes.count):
        meaning = _continuous(_Meaning(text.format(i + 1)))
        name = f"{stream}.mass_fraction[{i + 1}]"
        yield _Row(name, (*place, i), "output", "1", meaning, _FRACTION_LIMITS)


def _continuous(meaning: _Meaning) -> _Meaning:
    """What is no parameter changes from step to step, continuously if it is real."""
    if meaning.kind != "Real":
        return meaning
    return _Meaning(meaning.description, "continuous", meaning.kind, meaning.display)


def entry_at(path: Steps) -> Entry | None:
    """What the configuration says of the value at a path."""
    kind: type = ScreenConfig
    entry: Entry | None = None
    for step in path:
        if isinstance(step, str):
            entry = entries(kind)[step]
            if isinstance(entry, Section):
                kind = entry.kind
    return entry.item if isinstance(entry, Numbers) else entry


def _limits(path: Steps) -> Limits:
    """Limits that the configuration sets to the value at `path`."""
    entry = entry_at(path)
    if not isinstance(entry, Number):
        return _NO_LIMITS
    least = entry.at_least if entry.at_least is not None else entry.above
    most = entry.at_most if entry.at_most is not None else entry.below
    return least, most
