"""Every FMI variable of a screen: name, place, type, unit, limits and meaning.

The value reference of a variable is its place in the buffer, counted from the first parameter:
parameters, inputs and outputs lie there in a row. What is said of a parameter or an input comes
from its field (`vibroscreen.variables`); outputs are said here. Where decks have different numbers
of panels, the buffer has room that no panel fills: references are skipped there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vibroscreen.config import ScreenConfig
from vibroscreen.fields import Choice
from vibroscreen.kernels.state import DECK_BED, DIMENSION, INTERMEDIATE, OUTPUT, Layout
from vibroscreen.screen import fill, nodes_of, settings_of
from vibroscreen.variables import Variable
from vibroscreen_fmu.port import Enumeration, Port

__all__ = ["ports"]

Place = tuple[str, *tuple[int, ...]]


@dataclass(frozen=True)
class _Meaning:
    """What a reader is told about an output, and how it behaves."""

    description: str
    variability: str = "continuous"
    kind: str = "Real"


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
_STREAMS = {
    "undersize": "Mass fraction of class {} in what falls through the lowest deck",
    "oversize": "Mass fraction of class {} in what leaves over the top deck",
}


@dataclass(frozen=True)
class _Output:
    """An output before it has a place: which number of which field of the buffer it is."""

    name: str
    place: Place
    unit: str
    meaning: _Meaning
    share: bool = False


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
    settings = enumerate(settings_of(config))
    said = [_port(number, k, float(buffer[first + k])) for k, number in settings if number]

    def port(output: _Output) -> Port:
        title, *index = output.place
        place = layout.offset[title] + int(np.ravel_multi_index(index, layout.shape[title]))
        return Port(
            name=output.name,
            reference=place - first,
            description=output.meaning.description,
            causality="output",
            variability=output.meaning.variability,
            kind=output.meaning.kind,
            unit=output.unit,
            least=0.0 if output.share else None,
            most=1.0 if output.share else None,
        )

    found = [*said, *map(port, _outputs(config))]
    return tuple(sorted(found, key=lambda port: port.reference))


def _port(number: Variable, reference: int, start: float) -> Port:
    """The FMI variable of a parameter or an input."""
    entry = number.entry
    variability = entry.variability
    least = most = enumeration = None
    kind, display = "Enumeration", True
    if isinstance(entry, Choice):
        enumeration = _choices(number, entry, start)
    else:
        kind = "Integer" if entry.whole else "Real"
        least, most = entry.bounds
        # Lengths that are given in metres are shown in metres.
        display = entry.unit != "m" or entry.factor != 1.0
    return Port(
        name=number.name,
        reference=reference,
        description=entry.tells,
        causality={"constant": "local", "continuous": "input"}.get(variability, "parameter"),
        variability=variability,
        kind=kind,
        unit=number.unit,
        display=display,
        least=least,
        most=most,
        start=start,
        enumeration=enumeration,
        path=() if variability == "continuous" else number.path,
    )


def _choices(number: Variable, entry: Choice, chosen: float) -> Enumeration:
    """The choices of a variable: what is built in, and what a user registered up to `chosen`."""
    names = entry.names()[: max(len(entry.meanings), int(chosen))]
    own = ("one's own",) * (len(names) - len(entry.meanings))
    title = "".join(word.capitalize() for word in number.name.split("."))
    return Enumeration(title, tuple(zip(names, (*entry.meanings, *own), strict=True)))


def _outputs(config: ScreenConfig) -> Iterator[_Output]:
    for index, scalar in enumerate(OUTPUT):
        name, unit, meaning = _OUTPUTS[scalar]
        yield _Output(name, ("output", index), unit, meaning)
    for stream, text in _STREAMS.items():
        yield from _fractions(config, stream, (f"{stream}_fraction",), text)
    for k in range(len(config.decks) - 1):
        below = k + 2  # the deck that it leaves over
        for index, scalar in enumerate(INTERMEDIATE):
            short, unit, text = _INTERMEDIATE[scalar]
            name, meaning = f"intermediate[{k + 1}].{short}", _Meaning(text.format(below))
            yield _Output(name, ("intermediate", k, index), unit, meaning)
        text = f"Mass fraction of class {{}} in what leaves over deck {below}"
        yield from _fractions(config, f"intermediate[{k + 1}]", ("intermediate_fraction", k), text)
    for d in range(len(config.decks)):
        for index, scalar in enumerate(DECK_BED):
            short, unit, text = _DECK_BED[scalar]
            name, meaning = f"deck[{d + 1}].bed.{short}", _Meaning(text.format(d + 1))
            yield _Output(name, ("deck_bed", d, index), unit, meaning)


def _fractions(config: ScreenConfig, stream: str, place: Place, text: str) -> Iterator[_Output]:
    """Composition of a stream; `text` says it for a class, `place` is that of the stream."""
    for i in range(config.size_classes.count):
        meaning = _Meaning(text.format(i + 1))
        name = f"{stream}.mass_fraction[{i + 1}]"
        yield _Output(name, (*place, i), "1", meaning, share=True)
