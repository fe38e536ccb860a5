"""What a study varies: a circuit, axes or a sampling plan, written in TOML, checked once."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import vibroscreen
from vibroscreen import fields
from vibroscreen.circuit.flowsheet import Flowsheet
from vibroscreen.circuit.screening import ScreenUnit
from vibroscreen.circuit.unit import Array, numbers_of
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError, Faults
from vibroscreen.fields import (
    Choice,
    FileOf,
    Number,
    Numbers,
    OfFile,
    Sections,
    Text,
    nearest,
    said,
)
from vibroscreen.screen import settings_of
from vibroscreen.stream import Feed

__all__ = ["Axis", "Study", "ascending", "fingerprint", "keys_of"]

PLANS = ("grid", "random", "latin", "sobol")
MOST_DESIGNS = 10_000_000
_ANY = Number("values")


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A number that a study varies, under the key and in the unit of its file.

    key: the name of the unit and the key of its table, such as `crusher.closed_side_setting_mm` or
    `screen.deck[1].panel[1].aperture_mm`. Either `values`, or from `low` to `high`, in a grid in
    `count` equal steps.
    """

    key: str = said(dataclasses.MISSING, Text("key"))
    values: tuple[float, ...] = said((), Numbers("values", _ANY))
    low: float | None = said(None, Number("from", optional=True))
    high: float | None = said(None, Number("to", optional=True))
    count: int = said(11, Number("count", whole=True, at_least=2, at_most=10_000))

    def __post_init__(self) -> None:
        given = {"values": self.values or None, "from": self.low, "to": self.high}
        there = [name for name, value in given.items() if value is not None]
        if there not in (["values"], ["from", "to"]):
            raise ConfigError(
                f"{self.key} has {' and '.join(there) or 'no values'}: give values, or from and to"
            )
        ascending(self.key, self.low, self.high)

    @property
    def grid(self) -> Array:
        """Values of a full grid, in the unit of the key."""
        if self.values:
            return np.array(self.values)
        return np.asarray(np.linspace(self.low or 0.0, self.high or 0.0, self.count))

    def drawn(self, share: Array) -> Array:
        """Values at shares of the axis [0, 1): of a list the one that lies there."""
        if self.values:
            return np.asarray(np.array(self.values)[(share * len(self.values)).astype(int)])
        low, high = self.low or 0.0, self.high or 0.0
        return np.asarray(low + share * (high - low))


@dataclass(frozen=True, kw_only=True)
class Study(OfFile):
    """A circuit and what is varied of it.

    plan: "grid" of all axes, or `designs` drawn "random", as a "latin" hypercube, or along a
    "sobol" sequence, from `seed`. tolerance: of the screens while many are solved [1]; the
    best design is solved again with the tolerance of its own file. Raises ConfigError.
    """

    circuit: Flowsheet = said(
        dataclasses.MISSING,
        FileOf("circuit", {"circuit": Flowsheet}, "a circuit", "the study"),
    )
    axes: tuple[Axis, ...] = said(dataclasses.MISSING, Sections("axis", Axis))
    plan: str = said("grid", Choice("plan", lambda: PLANS))
    designs: int = said(1000, Number("designs", whole=True, at_least=1, at_most=MOST_DESIGNS))
    seed: int = said(0, Number("seed", whole=True, at_least=0))
    tolerance: float = said(1e-3, Number("tolerance", at_least=1e-8, at_most=1e-2))
    name: str = said("study", Text("name"))

    def __post_init__(self) -> None:
        fields.check_fields(self, "")
        known, faults = keys_of(self.circuit), Faults()
        for axis in self.axes:
            if axis.key not in known:
                faults.append(
                    f"axis.key = {axis.key!r} is no number of the circuit: the nearest is "
                    f"{nearest(axis.key, known)!r}"
                )
        if self.plan == "grid" and self.count > MOST_DESIGNS:
            faults.append(
                f"the grid has {self.count} designs, more than {MOST_DESIGNS}: give fewer values, "
                'or draw some (plan = "sobol", designs = ...)'
            )
        faults.tell()

    @property
    def count(self) -> int:
        """How many designs there are."""
        if self.plan != "grid":
            return self.designs
        count = 1
        for axis in self.axes:
            count *= axis.grid.size
        return count

    @property
    def fast(self) -> Flowsheet:
        """The circuit with the tolerance of the study."""
        return self.circuit.with_tolerance(self.tolerance)

    def table(self) -> dict[str, Array]:
        """Values of all designs by key, in the unit of the key; the same in every process."""
        if self.plan == "grid":
            grids = np.meshgrid(*(axis.grid for axis in self.axes), indexing="ij")
            return {a.key: g.ravel() for a, g in zip(self.axes, grids, strict=True)}
        if self.plan == "random":
            shares = np.random.default_rng(self.seed).random((self.designs, len(self.axes)))
        else:
            from scipy.stats import qmc

            kind = qmc.LatinHypercube if self.plan == "latin" else qmc.Sobol
            sampler = kind(len(self.axes), rng=np.random.default_rng(self.seed))
            if self.plan == "sobol":
                powers = int(np.ceil(np.log2(self.designs)))
                shares = sampler.random_base2(powers)[: self.designs]
            else:
                shares = sampler.random(self.designs)
        return {axis.key: axis.drawn(shares[:, k]) for k, axis in enumerate(self.axes)}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the axes as `solve_circuit_many` takes them."""
        known = keys_of(self.circuit)
        return tuple(known[axis.key][0] for axis in self.axes)

    def values(self, table: Mapping[str, Array]) -> dict[str, Array]:
        """Columns of `table` as `solve_circuit_many` takes them: by name, in SI units."""
        known = keys_of(self.circuit)
        return {known[key][0]: known[key][1] * column for key, column in table.items()}


def keys_of(subject: ScreenConfig | Flowsheet) -> dict[str, tuple[str, float]]:
    """Numbers that may differ between designs, by key: name, and factor to SI.

    Those of the duty of a screen in a circuit are the circuit's.
    """
    if isinstance(subject, ScreenConfig):
        return {
            f"{number.section}.{number.entry.key}": (number.name, number.entry.factor)
            for number in settings_of(subject)
            if number
            and not number.whole
            and isinstance(number.entry, Number)
            and number.section != "solver"
            and not number.section.startswith("size_class")
            and not number.field.startswith("mass_fraction")
        }
    rate = fields.entries(Feed)["mass_flow_rate"]
    assert isinstance(rate, Number)
    found = {
        f"{feed.name}.{rate.key}": (f"{feed.name}.mass_flow_rate", rate.factor)
        for feed in subject.feeds
    }
    for unit in subject.units:
        if isinstance(unit, ScreenUnit):
            for key, (name, factor) in keys_of(unit.config).items():
                if not key.startswith("feed."):
                    found[f"{unit.name}.{key}"] = (f"{unit.name}.{name}", factor)
        else:
            for field, entry in numbers_of(type(unit)).items():
                found[f"{unit.name}.{entry.key}"] = (f"{unit.name}.{field}", entry.factor)
    return found


def ascending(key: str, low: float | None, high: float | None) -> None:
    """Refuse a range that does not go up, with ConfigError."""
    if low is not None and high is not None and not low < high:
        raise ConfigError(f"{key}: from = {low:g} is not less than to = {high:g}: swap them")


def fingerprint(told: object) -> str:
    """What tells one study or search from another, the version of the engine included."""
    whole = repr((told, vibroscreen.__version__)).encode()
    return hashlib.sha256(whole).hexdigest()[:16]
