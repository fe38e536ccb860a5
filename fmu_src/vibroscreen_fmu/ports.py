"""Every FMI variable of a screen: name, place, type, unit, limits and meaning.

The value reference of a variable is its place in the buffer, counted from the first parameter:
parameters, inputs and outputs lie there in a row. What is said of a parameter or an input comes
from its field (`vibroscreen.variables`), of an output too (`vibroscreen.figures`). Where decks have
different numbers of panels, the buffer has room that no panel fills: references are skipped there.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from vibroscreen.config import ScreenConfig
from vibroscreen.fields import Choice
from vibroscreen.figures import BETWEEN, BOX, DECK, Figure
from vibroscreen.kernels.state import DIMENSION
from vibroscreen.layout import Layout
from vibroscreen.screen import fill, nodes_of, settings_of
from vibroscreen.variables import Variable
from vibroscreen_fmu.port import Enumeration, Port

__all__ = ["ports"]

Place = tuple[str, *tuple[int, ...]]


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
    tells: str
    share: bool = False
    alarm: bool = False


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
            description=output.tells,
            causality="output",
            variability="discrete" if output.alarm else "continuous",
            kind="Boolean" if output.alarm else "Real",
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
    # All panels share the type of their openings.
    words = re.sub(r"\[\d+\]", "", number.name).split(".")
    title = "".join(word.capitalize() for word in words)
    return Enumeration(title, tuple(zip(names, (*entry.meanings, *own), strict=True)))


def _outputs(config: ScreenConfig) -> Iterator[_Output]:
    for k, figure in enumerate(BOX):
        yield _Output(figure.name, ("output", k), figure.unit, figure.tells, alarm=figure.alarm)
    for stream, text in _STREAMS.items():
        yield from _fractions(config, stream, (f"{stream}_fraction",), text)
    for k in range(len(config.decks) - 1):
        below = k + 2  # the deck that it leaves over
        yield from _of_deck(BETWEEN, f"intermediate[{k + 1}]", ("intermediate", k), below)
        text = f"Mass fraction of class {{}} in what leaves over deck {below}"
        yield from _fractions(config, f"intermediate[{k + 1}]", ("intermediate_fraction", k), text)
    for d in range(len(config.decks)):
        yield from _of_deck(DECK, f"deck[{d + 1}]", ("deck_result", d), d + 1)


def _of_deck(row: Iterable[Figure], title: str, place: Place, deck: int) -> Iterator[_Output]:
    """Figures of a deck, or of what leaves over it."""
    for k, figure in enumerate(row):
        text = figure.tells.format(deck)
        yield _Output(f"{title}.{figure.name}", (*place, k), figure.unit, text)


def _fractions(config: ScreenConfig, stream: str, place: Place, text: str) -> Iterator[_Output]:
    """Composition of a stream; `text` says it for a class, `place` is that of the stream."""
    for i in range(config.size_classes.count):
        name = f"{stream}.mass_fraction[{i + 1}]"
        yield _Output(name, (*place, i), "1", text.format(i + 1), share=True)
