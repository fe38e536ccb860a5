"""What a step, a steady state and a table of many say of the box and of every deck."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vibroscreen import figures
from vibroscreen.errors import told
from vibroscreen.figures import BoxFigures, DeckFigures, Value
from vibroscreen.kernels import state
from vibroscreen.performance import Partition, partition
from vibroscreen.size_classes import Nodes, SizeClasses
from vibroscreen.stream import Stream
from vibroscreen.units import DEG

if TYPE_CHECKING:  # the host of an FMU need not have them
    import pandas as pd
    from matplotlib.figure import Figure as Picture

__all__ = ["DeckResult", "StepResult"]

Array = NDArray[np.float64]


class Rows(NamedTuple):
    """What results of decks are made from when they are read: `deck_result`, and streams by node.

    feed_rate: of the screen [kg/s]; masses: `step_mass` [kg] of a step of `duration` s;
    last_fraction: of the feed, which streams that do not flow repeat; closed: sizes from which on
    nothing passes a panel of a deck [m].
    """

    nodes: Nodes
    classes: int
    figures: Array
    feed_rate: float
    masses: Array
    duration: float
    last_fraction: Array
    closed: Array

    @property
    def decks(self) -> tuple[DeckResult[float], ...]:
        """Results of the decks, top deck first."""
        under, over = self.masses / (self.duration if self.duration > 0.0 else 1.0)
        come = [self.last_fraction * self.feed_rate, *under[:-1]]
        parts = (
            Separation(
                self.nodes,
                self.classes,
                come[d],
                under[d],
                over[d],
                self.last_fraction,
                float(size),
            )
            for d, size in enumerate(self.closed.max(axis=1))
        )
        return tuple(
            DeckResult(deck=k, _separation=part, **dict(zip(_DECK, row, strict=True)))
            for k, (row, part) in enumerate(zip(self.figures.tolist(), parts, strict=True), start=1)
        )


def closed(scene: Array) -> Array:
    """Sizes from which on nothing passes the panels of each deck [m], from scenes."""
    return scene[:, :, state.SCENE.index("closed")]


@dataclass(frozen=True, eq=False)
class Separation:
    """What came to a deck, passed it and left over it [kg/s], by node.

    last_fraction: by node, of the feed of the screen; streams that do not flow repeat it. closed:
    size from which on nothing passes the deck [m].
    """

    nodes: Nodes
    classes: int
    feed: Array
    under: Array
    over: Array
    last_fraction: Array
    closed: float

    def stream(self, rates: Array) -> Stream:
        """A stream by class."""
        last = by_class(self.nodes, self.last_fraction, self.classes)
        return Stream.of_class_rates(by_class(self.nodes, rates, self.classes), last)


@dataclass(frozen=True, eq=False, kw_only=True)
class DeckResult(DeckFigures[Value]):
    """What a deck got, gave and carries: numbers with the units of `DeckFigures`.

    In kg: hold_up. In m: depth_feed, depth_discharge, aperture (the smallest), cut_size,
    ecart_probable. In m/s: transport_velocity (first panel). In kg/s: feed_rate, undersize_rate,
    oversize_rate. In 1: depths over the aperture, throw_number, efficiency, misplaced_undersize (in
    the oversize), misplaced_oversize (in the undersize), imperfection. In a table of many each is a
    row of numbers, one a design, and there are no streams.
    """

    deck: int
    _separation: Separation | None = field(default=None, repr=False)

    @property
    def _streams(self) -> Separation:
        if self._separation is None:
            raise AttributeError(
                "a table of many has no streams by deck: ask Screen.solve_steady for one design"
            )
        return self._separation

    @cached_property
    def feed(self) -> Stream:
        """What comes to the deck, by class [kg/s]."""
        return self._streams.stream(self._streams.feed)

    @cached_property
    def undersize(self) -> Stream:
        """What passes the deck, by class [kg/s]."""
        return self._streams.stream(self._streams.under)

    @cached_property
    def oversize(self) -> Stream:
        """What leaves over the deck, by class [kg/s]."""
        return self._streams.stream(self._streams.over)

    @cached_property
    def partition(self) -> Partition:
        """Partition curve of the deck at the engine's own nodes.

        Raises ValueError where nothing flows.
        """
        parts = self._streams
        return partition(parts.nodes.size, parts.under, parts.over, parts.closed)


def deck_values(deck: DeckFigures[float]) -> dict[str, Any]:
    """The figures of a deck by name."""
    return {figure.scalar: getattr(deck, figure.scalar) for figure in figures.DECK}


class Told:
    """Figures, alarms, tables and pictures that a step and a steady state have in common."""

    _rows: Rows
    alarm_reasons: Mapping[str, str]
    size_classes: Any
    undersize: Any
    oversize: Any
    intermediate: Any

    @property
    def products(self) -> dict[str, Stream]:
        """Products by name: `intermediate[k]` left over deck k + 1 [kg/s]."""
        between = {f"intermediate[{k}]": s for k, s in enumerate(self.intermediate, start=1)}
        return {"undersize": self.undersize, **between, "oversize": self.oversize}

    @property
    def streams(self) -> dict[str, Stream]:
        """Feed and products by name [kg/s]."""
        return {"feed": self.decks[0].feed, **self.products}

    @cached_property
    def decks(self) -> tuple[DeckResult[float], ...]:
        """Results of every deck, top deck first."""
        return self._rows.decks

    @property
    def alarms(self) -> tuple[str, ...]:
        """Names of the alarms that are set."""
        return tuple(self.alarm_reasons)

    def deck_frame(self) -> pd.DataFrame:
        """Table of the figures of every deck, a column a deck, units in the index."""
        import pandas as pd

        units = {figure.scalar: figure.unit for figure in figures.DECK}
        index = pd.MultiIndex.from_tuples(list(units.items()), names=["figure", "unit"])
        columns = {
            f"deck[{deck.deck}]": [float(value) for value in deck_values(deck).values()]
            for deck in self.decks
        }
        return pd.DataFrame(columns, index=index)

    def box_frame(self) -> pd.DataFrame:
        """Table of the figures of the box: value and unit."""
        import pandas as pd

        row = figures.figures_of(BoxFigures)
        return pd.DataFrame(
            {
                "value": [float(getattr(self, figure.scalar)) for figure in row],
                "unit": [figure.unit for figure in row],
            },
            index=pd.Index([figure.scalar for figure in row], name="figure"),
        )

    def frame(self) -> pd.DataFrame:
        """Table by class."""
        raise NotImplementedError

    def plot(self) -> Picture:
        """Gradations and partition; of a steady state also recovery and bed along the decks.

        A picture of matplotlib; raises ImportError without it. `vibroscreen.report` has them one
        by one, and maps of the bed.
        """
        from vibroscreen.report.pictures import draw_result

        return draw_result(self)

    def _repr_html_(self) -> str:
        """Tables for a notebook: products, decks, box, alarms."""
        alarms = "".join(
            f"<li><b>{name}</b>: {escape(reason)}</li>"
            for name, reason in self.alarm_reasons.items()
        )
        tables = (self.frame(), self.deck_frame(), self.box_frame())
        parts = [table.to_html(float_format="{:.5g}".format) for table in tables]
        return "\n".join([*parts, f"<ul>{alarms}</ul>" if alarms else "<p>no alarms</p>"])


def class_frame(classes: SizeClasses, streams: Mapping[str, Array]) -> pd.DataFrame:
    """Table by class: limits [m] and columns."""
    import pandas as pd

    return pd.DataFrame(
        {"lower_m": classes.lower, "upper_m": classes.upper, **streams},
        index=pd.RangeIndex(1, classes.count + 1, name="size_class"),
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class StepResult(Told, BoxFigures[float]):
    """What a step gave: means over the step, cumulative masses and the state after it.

    undersize, oversize and intermediate (over each lower deck) in kg/s; `decks` has the results of
    each deck, what stands here is of the box or of the top deck: hold_up in kg on all decks;
    depths, cut_size, ecart_probable and the sizes p80 and p50 of the products in m;
    transport_velocity in m/s; drive_power in W, exciter_force in N; throw_number,
    acceleration_number (K), undersize_recovery and efficiency of the top deck dimensionless;
    balance_error in kg; alarm_reasons: of the alarms that are set, by name.
    """

    undersize: Stream
    oversize: Stream
    intermediate: tuple[Stream, ...]
    alarm_reasons: Mapping[str, str]
    size_classes: SizeClasses = field(repr=False)
    _rows: Rows = field(repr=False)

    def frame(self) -> pd.DataFrame:
        """Table by class: limits [m] and products [kg/s]."""
        between = {
            f"intermediate_{k}_kg_s": stream.class_rates
            for k, stream in enumerate(self.intermediate, start=1)
        }
        streams = {
            "undersize_kg_s": self.undersize.class_rates,
            **between,
            "oversize_kg_s": self.oversize.class_rates,
        }
        return class_frame(self.size_classes, streams)


# --- from the buffer -----------------------------------------------------------------------------
def by_class(nodes: Nodes, values: Array, count: int) -> Array:
    """Node values summed over the classes; the last axis is that of the nodes."""
    out = np.zeros((*values.shape[:-1], count))
    for k in range(count):
        out[..., k] = values[..., nodes.class_index == k].sum(axis=-1)
    return out


BOX = tuple(figure.scalar for figure in figures.figures_of(BoxFigures))
_DECK = tuple(figure.scalar for figure in figures.DECK)


def box_of(output: Mapping[str, Any]) -> dict[str, Any]:
    """The figures of the box among the outputs."""
    return {name: output[name] for name in BOX}


def reasons(rows: Array) -> dict[str, str]:
    """Why alarms are set, by name, from `alarm` [alarm, number]."""
    said = {}
    for alarm, row in zip(figures.ALARMS, rows.tolist(), strict=True):
        reason, deck, value, limit, other = row
        if reason > 0.0:
            said[alarm.name] = told(
                state.REASONS[int(reason) - state.REASONS.first],
                number=deck,
                value=value,
                limit=limit,
                other_limit=other,
                degrees=value / DEG,
                slope=math.tan(value),
            )
    return said
