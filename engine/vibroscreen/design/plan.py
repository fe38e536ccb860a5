"""What a search may change, what must hold and what is wanted, written in TOML, checked once."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vibroscreen import fields
from vibroscreen.circuit.flowsheet import Flowsheet
from vibroscreen.circuit.results import CLOSED, solve_circuit_many
from vibroscreen.circuit.screening import ScreenUnit
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError, Faults
from vibroscreen.fields import (
    Choice,
    Entry,
    FileOf,
    Number,
    Numbers,
    OfFile,
    Sections,
    Text,
    fields_alone,
    nearest,
    said,
)
from vibroscreen.study.plan import ascending, keys_of
from vibroscreen.sweep import Sweep

__all__ = ["SHARP", "SLACK", "Condition", "Goal", "Search", "Total", "Variable"]

Array = NDArray[np.float64]

ALGORITHMS = ("pso", "de", "nsga2")
SHARP = 1e-5  # tolerance at which a design is solved before it is reported
SLACK = 1e-6  # by how much of its limit a condition may be missed
# Alarms of a screen that no good design sets.
ABSURD = ("alarm.capacity", "alarm.transport", "alarm.plausibility")
# Names of results by their unit, as people say them: what a name ends in, and the factor.
UNITS = {"_m": ("_mm", 1e3), "_w": ("_kw", 1e-3), "_kg_s": ("_t_h", 3.6), "_n": ("_kn", 1e-3)}
SHORT = {"K": "acceleration_number"}
BED = ("bed_over_aperture", "depth_over_aperture_discharge")


class _Keys(Entry):
    """A list of keys."""

    key = "keys"

    def check(self, name: str, value: Any) -> tuple[str, ...]:
        keys = fields.as_tuple(value)
        if keys is None or len(keys) < 2 or not all(isinstance(key, str) for key in keys):
            raise ConfigError(f"{name} = {value!r} is not a list of two or more keys: give them")
        return keys


class _Yes(Entry):
    """True or false."""

    def __init__(self, key: str) -> None:
        self.key = key

    def check(self, name: str, value: Any) -> bool:
        if not isinstance(value, bool):
            raise ConfigError(f"{name} = {value!r} is neither true nor false: write one of them")
        return value


class _Options(Entry):
    """Rows of a catalogue: values by key that go together, such as a medium or a kind of motion."""

    key = "options"

    def check(self, name: str, value: Any) -> tuple[dict[str, float], ...]:
        rows = tuple(value or ())
        for row in rows:
            if not isinstance(row, Mapping) or set(row) != set(rows[0]) or not row:
                raise ConfigError(
                    f"{name} = {value!r} is no catalogue: give tables that have the same keys, "
                    'such as {"deck[1].panel[1].aperture_mm" = 16}'
                )
        return tuple({key: float(number) for key, number in row.items()} for row in rows)


@dataclass(frozen=True, kw_only=True)
class Variable:
    """What a search may change: a number from `low` to `high`, or one of `choices` or `options`.

    key: as of a file, `deck[1].panel[1].aperture_mm`, or `screen.` before it in a circuit; for
    options a name of your own. whole: in steps of one.
    """

    key: str = said(dataclasses.MISSING, Text("key"))
    low: float | None = said(None, Number("from", optional=True))
    high: float | None = said(None, Number("to", optional=True))
    whole: bool = said(False, _Yes("whole"))
    choices: tuple[float, ...] = said((), Numbers("choices", Number("choices"), least=0))
    options: tuple[dict[str, float], ...] = said((), _Options())

    def __post_init__(self) -> None:
        given = [
            self.low is not None and self.high is not None,
            bool(self.choices),
            bool(self.options),
        ]
        if sum(given) != 1:
            raise ConfigError(f"{self.key}: give from and to, or choices, or options")
        ascending(self.key, self.low, self.high)

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys that it sets."""
        return tuple(self.options[0]) if self.options else (self.key,)

    def values(self, share: Array) -> dict[str, Array]:
        """Values by key at shares of its range, 0 to 1."""
        if self.options or self.choices:
            count = len(self.options or self.choices)
            place = np.minimum((share * count).astype(int), count - 1)
            if self.choices:
                return {self.key: np.array(self.choices)[place]}
            return {key: np.array([row[key] for row in self.options])[place] for key in self.keys}
        low, high = self.low or 0.0, self.high or 0.0
        if self.whole:
            return {self.key: np.minimum(low + np.floor(share * (high - low + 1.0)), high)}
        return {self.key: low + share * (high - low)}


@dataclass(frozen=True, kw_only=True)
class Condition:
    """A result or a variable that must be at least, or at the most, a limit."""

    of: str = said(dataclasses.MISSING, Text("of"))
    at_least: float | None = said(None, Number("at_least", optional=True))
    at_most: float | None = said(None, Number("at_most", optional=True))

    def __post_init__(self) -> None:
        if (self.at_least is None) == (self.at_most is None):
            raise ConfigError(f"condition on {self.of}: give at_least or at_most")

    @property
    def limit(self) -> float:
        """The limit."""
        return self.at_least if self.at_least is not None else self.at_most or 0.0

    @property
    def text(self) -> str:
        """The condition in words."""
        return f"{self.of} {'at least' if self.at_least is not None else 'at most'} {self.limit:g}"

    def missed(self, value: Array) -> Array:
        """How far values are beyond the limit, over it; negative where they are within."""
        beyond = value - self.limit if self.at_least is None else self.limit - value
        return np.asarray(np.where(np.isfinite(value), beyond / max(abs(self.limit), 1e-9), 1e3))


@dataclass(frozen=True, kw_only=True)
class Goal:
    """What is to be as small, or as large, as can be."""

    minimise: str | None = said(None, Text("minimise"))
    maximise: str | None = said(None, Text("maximise"))

    def __post_init__(self) -> None:
        if (self.minimise is None) == (self.maximise is None):
            raise ConfigError("goal: give minimise or maximise, one of them")

    @property
    def of(self) -> str:
        """What it is about."""
        return self.minimise or self.maximise or ""

    def cost(self, value: Array) -> Array:
        """What an optimiser makes small."""
        return value if self.minimise else -value


@dataclass(frozen=True, kw_only=True)
class Total:
    """Variables that sum to a total, such as lengths of panels; the last one is what is left."""

    keys: tuple[str, ...] = said(dataclasses.MISSING, _Keys())
    equals: float = said(dataclasses.MISSING, Number("equals"))


@dataclass(frozen=True, kw_only=True)
class Search(OfFile):
    """A screen or a circuit, what may change, what must hold and what is wanted.

    algorithm: "pso", "de", or "nsga2", which is taken for several goals. Raises ConfigError.
    """

    subject: ScreenConfig | Flowsheet = said(
        dataclasses.MISSING,
        FileOf(
            "screen",
            {"screen": ScreenConfig, "circuit": Flowsheet},
            "a screen or a circuit",
            "the search",
        ),
    )
    variables: tuple[Variable, ...] = said(dataclasses.MISSING, Sections("variable", Variable))
    goals: tuple[Goal, ...] = said(dataclasses.MISSING, Sections("goal", Goal))
    conditions: tuple[Condition, ...] = said((), Sections("condition", Condition, optional=True))
    totals: tuple[Total, ...] = said((), Sections("total", Total, optional=True))
    algorithm: str = said("pso", Choice("algorithm", lambda: ALGORITHMS))
    population: int = said(60, Number("population", whole=True, at_least=4, at_most=100_000))
    generations: int = said(60, Number("generations", whole=True, at_least=1, at_most=100_000))
    seed: int = said(0, Number("seed", whole=True, at_least=0))
    tolerance: float = said(1e-3, Number("tolerance", at_least=1e-8, at_most=1e-2))
    name: str = said("search", Text("name"))

    def __post_init__(self) -> None:
        fields.check_fields(self, "")
        faults = Faults()
        known = self._known
        for key in (key for variable in self.variables for key in variable.keys):
            if key not in known:
                faults.append(
                    f"variable.key = {key!r} is no number of the {self.kind}: the nearest is "
                    f"{nearest(key, known)!r}"
                )
        free = [key for variable in self.variables for key in variable.keys]
        for total in self.totals:
            for key in total.keys:
                if key not in free and not (key == total.keys[-1] and key in known):
                    faults.append(f"total.keys has {key!r}, which is no variable: give one of them")
        if len(self.goals) > 1 and self.algorithm != "nsga2":
            faults.append(
                f'algorithm = "{self.algorithm}" takes one goal, there are {len(self.goals)}: give '
                'algorithm = "nsga2"'
            )
        faults.tell()
        results = self.measured(*self.values(np.full((1, len(self.variables)), 0.5)))
        asked = [goal.of for goal in self.goals] + [c.of for c in self.conditions]
        for name in asked:
            if name not in results:
                faults.append(
                    f"{name!r} is no result and no variable: the nearest is "
                    f"{nearest(name, map(str, results))!r}"
                )
        faults.tell()

    @property
    def kind(self) -> str:
        """Whether it is about a screen or a circuit."""
        return "screen" if isinstance(self.subject, ScreenConfig) else "circuit"

    __getstate__ = fields_alone

    # --- designs ---------------------------------------------------------------------------------
    @cached_property
    def _known(self) -> dict[str, tuple[str, float]]:
        """Numbers that may change, by key: name, and factor to SI."""
        return keys_of(self.subject)

    def values(self, shares: Array) -> tuple[dict[str, Array], Array]:
        """Values by key, in its unit, at shares of the ranges [design, variable]; and what is off.

        What is off [design]: how far the remainder of a total lies outside of its range, over it.
        """
        values: dict[str, Array] = {}
        for place, variable in enumerate(self.variables):
            values |= variable.values(shares[:, place])
        off = np.zeros(len(shares))
        for total in self.totals:
            *first, last = total.keys
            rest = total.equals - np.sum([values[key] for key in first], axis=0)
            own = next((v for v in self.variables if v.key == last and v.low is not None), None)
            low, high = (own.low or 0.0, own.high or 0.0) if own else (1e-9, total.equals)
            off = np.maximum(
                off, np.maximum(low - rest, rest - high) / max(abs(total.equals), 1e-9)
            )
            values[last] = np.clip(rest, low, high)
        return values, off

    def measured(
        self, values: Mapping[str, Array], off: Array, tolerance: float | None = None
    ) -> pd.DataFrame:
        """Variables and results of designs, a row each, in the units of their names.

        `refused` has the reason of a design that cannot be run, "" otherwise.
        """
        named = {self._known[key][0]: self._known[key][1] * v for key, v in values.items()}
        sharp = self.tolerance if tolerance is None else tolerance
        if sharp not in self._solvers:
            self._solvers[sharp] = self._made(sharp)
        solver = self._solvers[sharp]
        frame = _screens(solver, named) if isinstance(solver, Sweep) else _circuits(solver, named)
        frame.loc[(off > SLACK) & (frame["refused"] == ""), "refused"] = "parts exceed their total"
        for place, (key, column) in enumerate(values.items()):
            frame.insert(place, key, column)
        return frame

    @cached_property
    def _solvers(self) -> dict[float, Sweep | Flowsheet]:
        """What solves designs at a tolerance, made once."""
        return {}

    def _made(self, tolerance: float) -> Sweep | Flowsheet:
        if isinstance(self.subject, Flowsheet):
            return self.subject.with_tolerance(tolerance)
        return Sweep([self.subject.with_values({"solver.tolerance": tolerance})])

    def costs(self, frame: pd.DataFrame) -> Array:
        """What is to be small [design, goal]; huge where a design cannot be run."""
        costs = np.stack([goal.cost(frame[goal.of].to_numpy(float)) for goal in self.goals], axis=1)
        usable = (frame["refused"] == "").to_numpy()[:, None] & np.isfinite(costs)
        return np.asarray(np.where(usable, costs, 1e30))

    def missed(self, frame: pd.DataFrame) -> Array:
        """How far conditions are missed [design, condition], over their limits; refusals first."""
        refused = np.where(frame["refused"] == "", -1.0, 1e3)
        missed = [c.missed(frame[c.of].to_numpy(float)) for c in self.conditions]
        return np.asarray(np.stack([refused, *missed], axis=1))


def _screens(sweep: Sweep, values: Mapping[str, Array]) -> pd.DataFrame:
    """Results of screens, by name and in common units."""
    table = sweep.solve(values, refused="mark")
    frame = table.frame().drop(columns=list(table.values), errors="ignore")
    refused = pd.Series("", index=frame.index, dtype=object)
    for name in ABSURD:
        refused[frame[name].to_numpy(bool)] = name
    for design, reason in table.refused.items():
        refused[design] = reason
    frame = _in_units(frame)
    frame["refused"] = refused
    return frame


def _circuits(sheet: Flowsheet, values: Mapping[str, Array]) -> pd.DataFrame:
    """Results of circuits, and those of their screens behind the screens' names."""
    table = solve_circuit_many(sheet, values)
    frame = table.frame().drop(columns=list(table.values), errors="ignore")
    good = np.flatnonzero(np.isfinite(table.circulating_load))
    for unit in sheet.units:
        if isinstance(unit, ScreenUnit):
            # Where no design closed, the duty of the screen's file says which results there are.
            duty = unit.config.feed.class_rates[None]
            solved = table.screen(unit.name) if good.size else unit.solve(duty, {})
            own = _in_units(solved.frame()).select_dtypes("number").add_prefix(f"{unit.name}.")
            own.index = pd.Index(good if good.size else [-1])
            own = own[[name for name in own if name not in frame]]
            frame = frame.join(own.reindex(frame.index))
    reason = frame.pop("reason")
    frame["refused"] = np.where(table.status == CLOSED, "", reason)
    return frame


def _in_units(frame: pd.DataFrame) -> pd.DataFrame:
    """Columns in SI, and again in the units that people use; short names beside the long ones."""
    columns = {str(name): frame[name].to_numpy() for name in frame}
    more: dict[str, Array] = {}
    for name, column in columns.items():
        for ending, (other, factor) in UNITS.items():
            if name.endswith(ending):
                more[name.removesuffix(ending) + other] = factor * column
        if name.endswith(BED[1]):
            more[name.replace(BED[1], BED[0])] = column
    more |= {short: columns[name] for short, name in SHORT.items() if name in columns}
    return pd.DataFrame(columns | more, index=frame.index)
