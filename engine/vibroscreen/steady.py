"""Steady state and batches: one slice of the bed in time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen import performance
from vibroscreen.config import ScreenConfig
from vibroscreen.figures import BoxFigures
from vibroscreen.kernels import state
from vibroscreen.kernels.entry import FOLLOW, LAY_BATCH, SOLVE, START_BELOW, START_SLICE, run
from vibroscreen.layout import Layout
from vibroscreen.results import BOX, Rows, Told, box_of, by_class, class_frame, closed, reasons
from vibroscreen.size_classes import Nodes, SizeClasses
from vibroscreen.stream import Feed, Stream

if TYPE_CHECKING:  # the host of an FMU need not have it
    import pandas as pd

Array = NDArray[np.float64]
Check = Callable[[int, Array, Layout], None]

# Fields of the buffer that a steady state keeps.
KEPT = (
    *("scene", "step_mass", "class_mass", "recovery", "feed_fraction", "output"),
    *("deck_result", "intermediate", "alarm"),
)
# Places along the deck at which a profile is given, ends included.
PROFILE_POINTS = 65


@dataclass(frozen=True, eq=False)
class Kept:
    """What a steady state keeps of the buffer that it was found in: two stretches of it, copied.

    starts: where they began. The first holds what was set, too.
    """

    layout: Layout
    starts: tuple[int, int]
    stretches: tuple[Array, Array]

    def view(self, name: str) -> Array:
        """The field `name`, shaped."""
        span = self.layout.span[name]
        number = int(span.start >= self.starts[1])
        first = self.starts[number]
        found = self.stretches[number][span.start - first : span.stop - first]
        return found.reshape(self.layout.shape[name])


@dataclass(frozen=True, eq=False)
class Profile:
    """What lies along the deck: areal mass [kg/m2] by position, layer and class.

    position[point] in m from the feed end; load[point, layer, class], layer 0 on the screen (a
    model without layers has one), just before the end of a panel where a point lies there;
    passed[point, class]: what passed up to there, as areal mass on the first panel. On a deck with
    one panel load summed over layers plus passed is what was fed at every point of the top deck.
    recovery[point]: of what comes to the deck finer than its smallest aperture, the share that
    passed up to there, nan without any; at the discharge it is the efficiency of the deck, within
    the tolerance.
    """

    position: Array
    load: Array
    passed: Array
    bulk_density: float
    recovery: Array

    @property
    def depth(self) -> Array:
        """Depth of the bed at every position, m."""
        total: Array = self.load.sum(axis=(1, 2)) / self.bulk_density
        return total

    @property
    def height(self) -> Array:
        """Boundaries of the layers over the deck [point, layer + 1], m: 0, then their tops."""
        tops = self.load.sum(axis=2).cumsum(axis=1) / self.bulk_density
        return np.concatenate([np.zeros((tops.shape[0], 1)), tops], axis=1)

    def content(self, classes: ArrayLike) -> Array:
        """Mass fraction in every layer [point, layer] of a class, or of several together [1].

        classes: places from 0 on, as in `load`. nan where there is no layer.
        """
        part = self.load[..., np.atleast_1d(classes)].sum(axis=2)
        whole = self.load.sum(axis=2)
        share: Array = np.divide(part, whole, out=np.full_like(whole, np.nan), where=whole > 0.0)
        return share

    def frame(self) -> pd.DataFrame:
        """Long table: position_m, layer (from 1 on the screen), size_class, load_kg_m2."""
        import pandas as pd

        points, layers, classes = np.indices(self.load.shape)
        return pd.DataFrame(
            {
                "position_m": self.position[points.ravel()],
                "layer": layers.ravel() + 1,
                "size_class": classes.ravel() + 1,
                "load_kg_m2": self.load.ravel(),
            }
        )


@dataclass(frozen=True, eq=False, init=False)
class SteadyResult(Told, BoxFigures[float]):
    """Steady state of a screen under a feed: streams in kg/s, recovery, results of every deck.

    `decks` has the results of each deck; numbers that stand here are of the box or of the top deck,
    in the units of `StepResult`, nan for what there is nothing of. All of it is computed when it is
    read.
    """

    feed: Feed
    alarm_reasons: Mapping[str, str]
    _slice: Slice = field(repr=False)
    _kept: Kept = field(repr=False)

    def __init__(self, feed: Feed, slice_: Slice, kept: Kept) -> None:
        vars(self).update(feed=feed, _slice=slice_, _kept=kept)

    def __getattr__(self, name: str) -> Any:
        """What was not read before: figures of the box, reasons of alarms, what decks are from."""
        if name in BOX:
            output = self._kept.view("output").tolist()
            vars(self).update(box_of(dict(zip(state.OUTPUT, output, strict=True))))
        elif name == "alarm_reasons":
            vars(self)[name] = reasons(self._kept.view("alarm"))
        elif name == "_rows":
            vars(self)[name] = self._slice.rows(self._kept, self.feed.mass_flow_rate)
        else:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return vars(self)[name]

    @property
    def config(self) -> ScreenConfig:
        """The screen."""
        return self._slice.config

    @property
    def size_classes(self) -> SizeClasses:
        """Limits of the size classes."""
        return self.config.size_classes

    @property
    def recovery(self) -> Array:
        """Part of each class that reaches the undersize, 0 for a class that is not fed [1]."""
        return self._kept.view("recovery")

    def _stream(self, row: int) -> Stream:
        rates = self._kept.view("class_mass")[row]
        return Stream.of_class_rates(rates, np.asarray(self.feed.mass_fraction))

    @cached_property
    def undersize(self) -> Stream:
        """What passes the lowest deck."""
        return self._stream(state.UNDER)

    @cached_property
    def oversize(self) -> Stream:
        """What leaves over the top deck."""
        return self._stream(state.OVER)

    @cached_property
    def intermediate(self) -> tuple[Stream, ...]:
        """What leaves over each deck below the top one."""
        return tuple(self._stream(state.OVER + d) for d in range(1, len(self.config.decks)))

    @property
    def intermediate_p80(self) -> tuple[float, ...]:
        """Size that 80 % of what leaves over each deck below the top one is finer than, m."""
        return self._between("p80")

    @property
    def intermediate_p50(self) -> tuple[float, ...]:
        """Size that half of what leaves over each deck below the top one is finer than, m."""
        return self._between("p50")

    def _between(self, name: str) -> tuple[float, ...]:
        """A number of what leaves over each deck below the top one."""
        rows = self._kept.view("intermediate")
        return tuple(rows[:, state.INTERMEDIATE.index(name)].tolist())

    @property
    def residence_time(self) -> float:
        """Time on the top deck from the feed end to the discharge, s."""
        velocity = _velocities(self._kept, self.config, 0)
        panels = self.config.decks[0].panels
        return sum(panel.length / float(v) for panel, v in zip(panels, velocity, strict=True))

    @property
    def deck_hold_up(self) -> tuple[float, ...]:
        """What lies on each deck, kg."""
        return tuple(deck.hold_up for deck in self.decks)

    @property
    def aperture(self) -> float:
        """Lowest aperture of the top deck, m."""
        return self.decks[0].aperture

    @property
    def partition(self) -> performance.Partition:
        """Partition curve of the top deck over the nodes inside the classes, and sizes from it."""
        return self.decks[0].partition

    @cached_property
    def profiles(self) -> tuple[Profile, ...]:
        """What lies along every deck, at 65 positions from the feed end to the discharge."""
        return self._slice.march(self._kept, PROFILE_POINTS)

    @property
    def profile(self) -> Profile:
        """What lies along the top deck."""
        return self.profiles[0]

    def frame(self) -> pd.DataFrame:
        """Table by class: limits [m], feed, undersize, oversize [kg/s], recovery [1].

        With several decks also what leaves over each lower one, intermediate_1_kg_s and so on.
        """
        between = {
            f"intermediate_{k}_kg_s": stream.class_rates
            for k, stream in enumerate(self.intermediate, start=1)
        }
        columns = {
            "feed_kg_s": self.feed.class_rates,
            "undersize_kg_s": self.undersize.class_rates,
            **between,
            "oversize_kg_s": self.oversize.class_rates,
            "recovery": self.recovery,
        }
        return class_frame(self.config.size_classes, columns)


class Slice:
    """A buffer with room for one slice of the bed: steady states and their profiles.

    What it reads and writes of the buffer in every solution is looked up once.
    """

    def __init__(
        self, config: ScreenConfig, nodes: Nodes, layout: Layout, buffer: Array, check: Check
    ) -> None:
        self.config, self.nodes, self.layout, self.buffer = config, nodes, layout, buffer
        self._run, self._check = run.on(buffer), check
        spans = [layout.span[name] for name in KEPT]
        work = layout.section["work"].start
        whole = slice(layout.section["parameters"].start, _last(spans, work))
        rest = slice(min(s.start for s in spans if s.start >= work), _last(spans, layout.size))
        self._starts = whole.start, rest.start
        self._found = buffer[whole], buffer[rest]

    def solve(self, feed: Feed) -> SteadyResult:
        """Steady state with the inputs and parameters in the buffer, which are those of `feed`."""
        self._check(self._run(SOLVE, 0.0, 0.0), self.buffer, self.layout)
        whole, rest = self._found
        kept = Kept(self.layout, self._starts, (whole.copy(), rest.copy()))
        return SteadyResult(feed, self, kept)

    def rows(self, kept: Kept, feed_rate: float) -> Rows:
        """What the results of decks are made from, in a steady state that was found before."""
        share = kept.view("feed_fraction")
        return Rows(
            self.nodes,
            self.config.size_classes.count,
            kept.view("deck_result"),
            feed_rate,
            kept.view("step_mass"),
            1.0,
            share,
            closed(kept.view("scene")),
        )

    def __getstate__(self) -> tuple[Any, ...]:
        return self.config, self.nodes, self.layout, self.buffer, self._check

    def __setstate__(self, parts: tuple[Any, ...]) -> None:
        """A copy looks up its own parts of its own buffer."""
        self.__init__(*parts)  # type: ignore[misc]

    def march(self, kept: Kept, points: int) -> tuple[Profile, ...]:
        """What lies along every deck in a steady state that was found before."""
        config, nodes, layout, buffer = self.config, self.nodes, self.layout, self.buffer
        setting = layout.section["constants"].stop - self._starts[0]
        self._found[0][:setting] = kept.stretches[0][:setting]
        self._check(self._run(START_SLICE, 0.0, 0.0), buffer, layout)
        return tuple(
            _profile(config, nodes, layout, buffer, d, _velocities(kept, config, d), points)
            for d in range(len(config.decks))
        )


def _last(spans: Iterable[slice], before: int) -> int:
    """Where the last of the spans that begin before a place ends."""
    last: int = max(span.stop for span in spans if span.start < before)
    return last


def _velocities(kept: Kept, config: ScreenConfig, deck: int) -> Array:
    """Velocity of the bed on the panels of a deck, m/s."""
    place = state.SCENE.index("transport_velocity")
    return kept.view("scene")[deck, : len(config.decks[deck].panels), place]


def _profile(
    config: ScreenConfig,
    nodes: Nodes,
    layout: Layout,
    buffer: Array,
    deck: int,
    velocity: Array,
    points: int,
) -> Profile:
    """Profile of a deck; those above it have been followed in the same buffer."""
    if deck > 0:
        run(buffer, START_BELOW, float(deck), 0.0)
    panels = config.decks[deck].panels
    position = np.linspace(0.0, config.decks[deck].length, points)
    ends = np.cumsum([0.0, *(panel.length for panel in panels)])
    times = np.cumsum([0.0, *(p.length / float(v) for p, v in zip(panels, velocity, strict=True))])
    moments = np.interp(position, ends, times)
    shape = layout.shape["column_time"]
    load, passed = np.zeros((points, *shape)), np.zeros((points, nodes.count))
    for k in range(points):
        if k > 0:
            run(buffer, FOLLOW, float(moments[k] - moments[k - 1]), float(deck))
        load[k] = layout.view(buffer, "lead")[deck]
        passed[k] = layout.view(buffer, "lead_passed")[deck]
    used = int(np.flatnonzero(load.any(axis=(0, 2)))[-1]) + 1 if load.any() else 1
    count = config.size_classes.count
    fine = nodes.size < min(panel.aperture for panel in panels)
    fine_passed = passed[:, fine].sum(axis=1)
    # A slice that rides faster is longer in the same measure, and lies thinner.
    fine_left = float(load[-1, :, fine].sum()) * velocity[-1] / velocity[0]
    come = float(fine_passed[-1]) + fine_left
    return Profile(
        position,
        by_class(nodes, load[:, :used], count),
        by_class(nodes, passed, count),
        config.material.bulk_density,
        fine_passed / come if come > 0.0 else np.full(points, np.nan),
    )


def sieve(
    config: ScreenConfig,
    nodes: Nodes,
    layout: Layout,
    buffer: Array,
    areal_mass: float,
    times: Array,
    check: Check,
) -> Array:
    """Recovery[time, class] of a batch with the inputs and parameters in the buffer."""
    check(run(buffer, START_SLICE, 0.0, 0.0), buffer, layout)
    recovery = np.zeros((times.size, config.size_classes.count))
    if times.size == 0:
        return recovery
    run(buffer, LAY_BATCH, areal_mass, float(times[-1]))
    fed = by_class(nodes, layout.view(buffer, "lead_feed")[0], config.size_classes.count)
    passed, latest = np.empty((times.size, nodes.count)), layout.view(buffer, "lead_passed")[0]
    for row, duration in zip(passed, np.diff(times, prepend=0.0).tolist(), strict=True):
        run(buffer, FOLLOW, duration, 0.0)
        row[:] = latest
    of_class = by_class(nodes, passed, config.size_classes.count)
    return np.divide(of_class, fed, out=recovery, where=fed > 0.0)
