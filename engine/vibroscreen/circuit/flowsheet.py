"""A flowsheet: fresh feeds, units and products, and what leads where, checked once."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from vibroscreen import fields
from vibroscreen.circuit.crusher import ConeCrusher, JawCrusher
from vibroscreen.circuit.handling import Bin, Conveyor, Mixer, Splitter
from vibroscreen.circuit.screening import ScreenUnit
from vibroscreen.circuit.unit import Array, Name, Target, Unit
from vibroscreen.errors import ConfigError, Faults
from vibroscreen.fields import Number, Numbers, OfFile, Section, Sections, Text, nearest, said
from vibroscreen.keys import reading
from vibroscreen.size_classes import SizeClasses
from vibroscreen.stream import ROUND_OFF, Feed
from vibroscreen.units import MM

__all__ = ["Flowsheet", "FreshFeed", "Product"]

# Kinds of units by the key of their tables.
KINDS: dict[str, type[Unit]] = {
    "cone_crusher": ConeCrusher,
    "jaw_crusher": JawCrusher,
    "screen": ScreenUnit,
    "mixer": Mixer,
    "splitter": Splitter,
    "conveyor": Conveyor,
    "bin": Bin,
}
_SIZE = Number("at_sizes_mm", "m", MM, above=0.0, at_most=2.0)
_PART = Number("passing", at_least=0.0, at_most=1.0)


@dataclass(frozen=True, kw_only=True)
class FreshFeed(Feed):
    """What a circuit is fed: a Feed with a name, and the unit that it leads to."""

    name: str = said(dataclasses.MISSING, Name("name"))
    to: str = said(dataclasses.MISSING, Target("to"))


@dataclass(frozen=True, kw_only=True)
class Product:
    """What leaves a circuit, and the band that its passing curve has to stay in, if there is one.

    at_sizes [m], and the least and the largest passing [1] at each of them.
    """

    name: str = said(dataclasses.MISSING, Name("name"))
    at_sizes: tuple[float, ...] = said((), Numbers("at_sizes_mm", _SIZE, least=0))
    least_passing: tuple[float, ...] = said((), Numbers("least_passing", _PART, least=0))
    most_passing: tuple[float, ...] = said((), Numbers("most_passing", _PART, least=0))

    def __post_init__(self) -> None:
        fields.check_fields(self, self.name if isinstance(self.name, str) else "product")
        for field in ("least_passing", "most_passing"):
            given = len(getattr(self, field))
            if given not in (0, len(self.at_sizes)):
                raise ConfigError(
                    f"{self.name}.{field} has {given} values, at_sizes_mm has "
                    f"{len(self.at_sizes)}: give one at each size"
                )

    def meets(self, edges: Array, rates: Array) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Whether products [design, class; kg/s] stay in the band; linear inside a class."""
        total = rates.sum(axis=1)
        passing = np.concatenate((np.zeros((len(rates), 1)), np.cumsum(rates, axis=1)), axis=1)
        inside, round_off = total > 0.0, ROUND_OFF * total
        for place, size in enumerate(self.at_sizes):
            k = int(np.clip(np.searchsorted(edges, size) - 1, 0, edges.size - 2))
            part = np.clip((size - edges[k]) / (edges[k + 1] - edges[k]), 0.0, 1.0)
            finer = passing[:, k] + part * (passing[:, k + 1] - passing[:, k])
            if self.least_passing:
                inside &= finer >= self.least_passing[place] * total - round_off
            if self.most_passing:
                inside &= finer <= self.most_passing[place] * total + round_off
        return np.asarray(inside)


def _file_class() -> type:
    """The tables of a file; `Flowsheet` puts the units of all kinds in one row."""
    said_of = [
        (
            "size_classes",
            SizeClasses,
            said(dataclasses.MISSING, Section("size_classes", SizeClasses)),
        ),
        ("feeds", tuple, said(dataclasses.MISSING, Sections("feed", FreshFeed))),
        ("products", tuple, said(dataclasses.MISSING, Sections("product", Product))),
        ("name", str, said("circuit", Text("name"))),
        *(
            (key, tuple, said((), Sections(key, kind, optional=True)))
            for key, kind in KINDS.items()
        ),
    ]
    return dataclasses.make_dataclass("File", said_of, frozen=True)


_File: Any = _file_class()


@dataclass(frozen=True)
class Flowsheet(OfFile):
    """Feeds, units and products of a circuit; every outlet leads to a unit or a product by name.

    Any number of streams may lead to one place: they are mixed there. All streams have the same
    size classes, the screens too. Raises ConfigError that tells all that is wrong.
    """

    size_classes: SizeClasses
    feeds: tuple[FreshFeed, ...]
    units: tuple[Unit, ...]
    products: tuple[Product, ...]
    name: str = "circuit"

    def __post_init__(self) -> None:
        classes = self.size_classes
        units = tuple(u.on(classes) if isinstance(u, ScreenUnit) else u for u in self.units)
        object.__setattr__(self, "units", units)
        faults = Faults(self._faults())
        faults.tell()

    # --- from a file -----------------------------------------------------------------------------
    @classmethod
    def from_dict(cls, tree: Mapping[str, Any], folder: str | Path = "") -> Flowsheet:
        """Flowsheet from the tree of a TOML file; file names are relative to `folder`."""
        with reading(_File, tree):
            file = fields.read_table(_File, tree, "", Path(folder))
        units = tuple(unit for key in KINDS for unit in getattr(file, key))
        return cls(file.size_classes, file.feeds, units, file.products, file.name)

    def with_values(self, values: Mapping[str, float]) -> Flowsheet:
        """The same circuit with other numbers by name, SI, checked again.

        Names are those of `solve_circuit_many`, such as `crusher.closed_side_setting`. Raises
        ConfigError.
        """
        own: dict[str, dict[str, Any]] = {}
        for full, value in values.items():
            name, _, field = full.partition(".")
            own.setdefault(name, {})[field] = value
        units = tuple(unit.with_values(own.get(unit.name, {})) for unit in self.units)
        feeds = tuple(dataclasses.replace(feed, **own.get(feed.name, {})) for feed in self.feeds)
        return dataclasses.replace(self, units=units, feeds=feeds)

    def with_tolerance(self, tolerance: float) -> Flowsheet:
        """The same circuit, its screens solved to that tolerance [1]."""
        screens = (unit.name for unit in self.units if isinstance(unit, ScreenUnit))
        return self.with_values({f"{name}.solver.tolerance": tolerance for name in screens})

    # --- the graph -------------------------------------------------------------------------------
    @cached_property
    def edges(self) -> Array:
        """Limits of the size classes [m], shape [N + 1]."""
        return np.array(self.size_classes.edges)

    @cached_property
    def unit(self) -> dict[str, Unit]:
        """Units by name."""
        return {unit.name: unit for unit in self.units}

    @cached_property
    def leaving(self) -> dict[tuple[str, str], str]:
        """The product that a unit's outlet makes, by unit and outlet, where it leads to one."""
        products = {product.name for product in self.products}
        return {
            (unit.name, outlet): target
            for unit in self.units
            for outlet, target in unit.targets.items()
            if target in products
        }

    @cached_property
    def cut(self) -> tuple[str, ...]:
        """The fewest units without whose feed no loop is left: there the loops are cut."""
        names = list(self.unit)
        for count in range(len(names) + 1):
            for chosen in combinations(names, count):
                try:
                    TopologicalSorter(self._sources(chosen)).prepare()
                except CycleError:
                    continue
                return chosen
        raise AssertionError("every graph without its arcs has no loop")

    @cached_property
    def order(self) -> tuple[str, ...]:
        """Units in the order of the streams, once the loops are cut."""
        return tuple(TopologicalSorter(self._sources(self.cut)).static_order())

    def _sources(self, cut: tuple[str, ...]) -> dict[str, list[str]]:
        """Units that lead to each unit; to those that are cut none does."""
        sources: dict[str, list[str]] = {name: [] for name in self.unit}
        for unit in self.units:
            for target in unit.targets.values():
                if target in sources and target not in cut:
                    sources[target].append(unit.name)
        return sources

    # --- what is wrong ---------------------------------------------------------------------------
    def _faults(self) -> Iterator[str]:
        products = [product.name for product in self.products]
        counted = Counter(
            [feed.name for feed in self.feeds] + list(map(_name, self.units)) + products
        )
        for name, count in counted.items():
            if count > 1:
                yield f"name = {name!r} is given {count} times: give each its own"
        classes = self.size_classes.count
        for feed in self.feeds:
            if len(feed.mass_fraction) != classes:
                yield (
                    f"{feed.name}.mass_fraction has {len(feed.mass_fraction)} values, the circuit "
                    f"has {classes} size classes: give one fraction a class, or the passing at "
                    "every limit"
                )
        known = [*self.unit, *products]
        leads = [(feed.name, "to", feed.to) for feed in self.feeds]
        leads += [(u.name, outlet, to) for u in self.units for outlet, to in u.targets.items()]
        for name, outlet, target in leads:
            if target not in known:
                yield (
                    f"{name}.{outlet} = {target!r} is neither a unit nor a product: did you mean "
                    f"{nearest(target, known)!r}?"
                )
        reached = self._reached([feed.to for feed in self.feeds])
        for name in known:
            if name not in reached:
                yield f"{name}: no feed leads here: let an outlet lead to it, or leave it out"
        for name in reached:
            if name in self.unit and not self._reached([name]) & set(products):
                yield f"{name}: nothing leads from here to a product: lead an outlet to one"

    def _reached(self, start: list[str]) -> set[str]:
        """What can be reached from some units, these with it."""
        reached: set[str] = set()
        ahead = list(start)
        while ahead:
            name = ahead.pop()
            if name not in reached:
                reached.add(name)
                ahead += self.unit[name].targets.values() if name in self.unit else ()
        return reached


def _name(unit: Unit) -> str:
    return unit.name
