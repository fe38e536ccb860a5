"""Every number of a screen that the engine holds and an FMU offers, by name, from its field.

A number of a section is `section.field` for people (`passage.velocity`) and `section_field` for
kernels (`parameter.passage_velocity`). To give a law one more constant takes two places: a field
in `sections.py`, and the law that reads it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from vibroscreen.fields import Choice, Number, Numbers, entries
from vibroscreen.motion import Motion
from vibroscreen.sections import (
    Bed,
    Deck,
    Displacement,
    Drive,
    Material,
    Panel,
    Passage,
    Segregation,
    Solver,
)
from vibroscreen.size_classes import SizeClasses
from vibroscreen.stream import Feed

__all__ = ["INPUTS", "PANELS", "PARAMETERS", "Steps", "Variable", "setting"]

Steps = tuple[str | int, ...]


@dataclass(frozen=True)
class Variable:
    """A number: the section and the field that say it, and what the field says.

    steps: where it sits in a ScreenConfig, if that is not the field of the section.
    """

    section: str
    field: str
    entry: Number | Choice
    steps: Steps = ()

    @property
    def path(self) -> Steps:
        """Where it sits in a ScreenConfig."""
        return self.steps or (self.section, self.field)

    @property
    def name(self) -> str:
        """What people call it."""
        return f"{self.section}.{self.field}" if self.section else self.field

    @property
    def scalar(self) -> str:
        """What kernels call it."""
        return self.name.replace(".", "_")

    @property
    def limits(self) -> tuple[float, float]:
        """Least and largest value that the engine takes."""
        if not isinstance(self.entry, Number):
            return 1.0, float(len(self.entry.meanings))
        least, most = self.entry.limits
        return least - self.entry.slack, most + self.entry.slack

    @property
    def whole(self) -> bool:
        """Whether it is a whole number."""
        return not isinstance(self.entry, Number) or self.entry.whole

    @property
    def unit(self) -> str:
        """Its unit, "1" for none."""
        return self.entry.unit if isinstance(self.entry, Number) else "1"

    def range(self, most: float) -> str:
        """The limits in words, in brackets; `most` is the largest number of a choice."""
        return self.entry.range if isinstance(self.entry, Number) else f" (1 to {most:.0f})"

    def cure(self, text: str, value: float, most: float) -> str:
        """What to do about a value of which `text` (errors.TEXT) is told; `most` as of `range`."""
        if isinstance(self.entry, Number):
            return self.entry.cure_of(text, value)
        return self.plain_cure(most)

    def plain_cure(self, most: float) -> str:
        """What to do about a value that is just out of range; `most` as of `range`."""
        if isinstance(self.entry, Number):
            return self.entry.plain_cure
        numbered = enumerate(self.entry.names()[: int(most)], start=1)
        return f"give {', '.join(f'{number} {name}' for number, name in numbered)}"


def _of(section: str, kind: type) -> Iterator[Variable]:
    """The numbers of a section that the engine holds."""
    for field, entry in entries(kind).items():
        if isinstance(entry, Number | Choice) and entry.variability:
            yield Variable(section, field, entry)


_SECTIONS: dict[str, type] = {
    "feed": Feed,
    "motion": Motion,
    "material": Material,
    "passage": Passage,
    "segregation": Segregation,
    "displacement": Displacement,
    "bed": Bed,
    "drive": Drive,
    "solver": Solver,
    "size_classes": SizeClasses,
}
_ALL = [variable for name, kind in _SECTIONS.items() for variable in _of(name, kind)]


def _row(*, inputs: bool) -> tuple[Variable, ...]:
    return tuple(v for v in _ALL if (v.entry.variability == "continuous") == inputs)


PARAMETERS = _row(inputs=False)
INPUTS = _row(inputs=True)
PANELS = tuple(_of("", Panel))
(_WIDTH,) = _of("", Deck)


def _item(kind: type, field: str) -> Number:
    """What is said of each number of a list."""
    numbers = entries(kind)[field]
    assert isinstance(numbers, Numbers)
    return numbers.item


_EDGE, _FRACTION = _item(SizeClasses, "edges"), _item(Feed, "mass_fraction")


def setting(classes: int, panels: Sequence[int]) -> Iterator[Variable | None]:
    """Parameters and inputs of a screen in the order of the buffer (`state.SECTIONS`).

    panels: how many each deck has; None stands where the buffer has room for one that is not there.
    """
    yield from PARAMETERS
    for edge, side in enumerate(("lower", "upper")):
        for i in range(classes):
            tells = f"{side.capitalize()} limit of the size class"
            entry = replace(_EDGE, tells=tells)
            where = ("size_classes", "edges", i + edge)
            yield Variable(f"size_class[{i + 1}]", side, entry, where)
    for d in range(len(panels)):
        yield Variable(f"deck[{d + 1}]", "width", _WIDTH.entry, ("decks", d, "width"))
    for d, count in enumerate(panels):
        for p in range(max(panels)):
            for panel in PANELS:
                section = f"deck[{d + 1}].panel[{p + 1}]"
                steps = ("decks", d, "panels", p, panel.field)
                there = Variable(section, panel.field, panel.entry, steps)
                yield there if p < count else None
    yield from INPUTS
    for i in range(classes):
        yield Variable("feed", f"mass_fraction[{i + 1}]", _FRACTION)
