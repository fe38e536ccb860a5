"""Steady state and batches: one slice of the bed in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vibroscreen import performance
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.kernels import layout as lay
from vibroscreen.kernels.entry import FOLLOW, LAY_BATCH, START_SLICE, run
from vibroscreen.kernels.layout import Layout
from vibroscreen.size_classes import Nodes
from vibroscreen.stream import Feed, Stream

if TYPE_CHECKING:  # the host of an FMU need not have it
    import pandas as pd

Array = NDArray[np.float64]
Check = Callable[[int, Array, Layout], None]

# Places along the deck at which a profile is given, ends included.
PROFILE_POINTS = 65


@dataclass(frozen=True, eq=False)
class Profile:
    """What lies along the deck: areal mass [kg/m2] by position, layer and class.

    position[point] in m from the feed end; load[point, layer, class], layer 0 on the screen (a
    model without layers has one); passed[point, class]: what passed up to there, kg/m2 of the
    slice that rides along. At every point load summed over layers plus passed is what was fed.
    """

    position: Array
    load: Array
    passed: Array
    bulk_density: float

    @property
    def depth(self) -> Array:
        """Depth of the bed at every position, m."""
        total: Array = self.load.sum(axis=(1, 2)) / self.bulk_density
        return total

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


@dataclass(frozen=True, eq=False)
class SteadyResult:
    """Steady state of a screen.

    recovery[class]: part of each class that reaches the undersize, 0 for a class that is not fed;
    undersize, oversize: streams in kg/s; transport_velocity in m/s; residence_time in s; hold_up
    in kg. The partition over the engine's own nodes, the profile and the tables are computed when
    they are read.
    """

    config: ScreenConfig
    feed: Feed
    recovery: Array
    undersize: Stream
    oversize: Stream
    transport_velocity: float
    residence_time: float
    _nodes: Nodes = field(repr=False)
    _fine: Array = field(repr=False)
    _coarse: Array = field(repr=False)
    _march: Callable[[int], Profile] = field(repr=False)

    @property
    def aperture(self) -> float:
        """Lowest aperture of the top deck, m."""
        return min(panel.aperture for panel in self.config.decks[0].panels)

    @cached_property
    def partition(self) -> performance.Partition:
        """Partition curve over the nodes inside the classes, cut size and ecart probable."""
        largest = max(panel.aperture for panel in self.config.decks[0].panels)
        return performance.partition(self._nodes.size, self._fine, self._coarse, largest)

    @property
    def cut_size(self) -> float:
        """Size of which half reports to the oversize, m."""
        return self.partition.cut_size

    @property
    def ecart_probable(self) -> float:
        """(d75 - d25)/2, m."""
        return self.partition.ecart_probable

    @property
    def undersize_recovery(self) -> float:
        """Undersize finer than the aperture over the same in the feed."""
        return performance.undersize_recovery(
            self._nodes.size, self._fine + self._coarse, self._fine, self.aperture
        )

    @property
    def efficiency(self) -> float:
        """Undersize recovery times oversize recovery."""
        return performance.screening_efficiency(
            self._nodes.size, self._fine + self._coarse, self._fine, self._coarse, self.aperture
        )

    @cached_property
    def profile(self) -> Profile:
        """What lies along the deck, at 65 positions from the feed end to the discharge."""
        return self._march(PROFILE_POINTS)

    @property
    def hold_up(self) -> float:
        """What lies on the deck, kg: the profile integrated along the deck (Simpson's rule)."""
        load = self.profile.load.sum(axis=(1, 2))
        step = self.profile.position[1] - self.profile.position[0]
        weight = np.ones(load.size)
        weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0
        return float(self.config.decks[0].width * step / 3.0 * (weight @ load))

    def frame(self) -> pd.DataFrame:
        """Table by class: limits [m], feed, undersize, oversize [kg/s], recovery [1]."""
        import pandas as pd

        classes = self.config.size_classes
        return pd.DataFrame(
            {
                "lower_m": classes.lower,
                "upper_m": classes.upper,
                "feed_kg_s": self.feed.class_rates,
                "undersize_kg_s": self.undersize.class_rates,
                "oversize_kg_s": self.oversize.class_rates,
                "recovery": self.recovery,
            },
            index=pd.RangeIndex(1, classes.count + 1, name="size_class"),
        )


def by_class(nodes: Nodes, values: Array, count: int) -> Array:
    """Node values summed over the classes; the last axis is that of the nodes."""
    out = np.zeros((*values.shape[:-1], count))
    for k in range(count):
        out[..., k] = values[..., nodes.class_index == k].sum(axis=-1)
    return out


def solve(
    config: ScreenConfig, nodes: Nodes, layout: Layout, buffer: Array, feed: Feed, check: Check
) -> SteadyResult:
    """Steady state with the inputs and parameters in the buffer of one slice."""
    if feed.mass_flow_rate <= 0.0:
        raise InputError(
            "feed.mass_flow_rate = 0 kg/s has no steady separation: give a positive feed",
            "feed.mass_flow_rate",
        )
    check(run(buffer, START_SLICE, 0.0, 0.0), buffer, layout)
    velocity = float(layout.view(buffer, "scene")[0, 0, lay.S_TRANSPORT_VELOCITY])
    if velocity <= 0.0:
        raise _no_conveying(config, layout, buffer)
    count = config.size_classes.count
    residence = config.decks[0].length / velocity
    setting = slice(layout.section["parameters"].start, layout.section["constants"].stop)
    set_now = buffer[setting].copy()
    carried = config.decks[0].width * velocity

    def march(points: int) -> Profile:
        buffer[setting] = set_now
        check(run(buffer, START_SLICE, 0.0, 0.0), buffer, layout)
        shape = layout.shape["column"]
        load, passed = np.zeros((points, *shape)), np.zeros((points, nodes.count))
        for k in range(points):
            if k > 0:
                run(buffer, FOLLOW, residence / (points - 1), 0.0)
            load[k] = layout.view(buffer, "lead")[0]
            passed[k] = layout.view(buffer, "lead_passed")[0]
        used = int(np.flatnonzero(load.any(axis=(0, 2)))[-1]) + 1
        return Profile(
            np.linspace(0.0, config.decks[0].length, points),
            by_class(nodes, load[:, :used], count),
            by_class(nodes, passed, count),
            config.material.bulk_density,
        )

    run(buffer, FOLLOW, residence, 0.0)
    fine = carried * layout.view(buffer, "lead_passed")[0]
    coarse = carried * layout.view(buffer, "lead")[0].sum(axis=0)
    under, over = by_class(nodes, fine, count), by_class(nodes, coarse, count)
    total = under + over
    fed = np.asarray(feed.mass_fraction)
    return SteadyResult(
        config,
        feed,
        np.divide(under, total, out=np.zeros(count), where=total > 0.0),
        Stream.of_class_rates(under, fed),
        Stream.of_class_rates(over, fed),
        velocity,
        residence,
        nodes,
        fine,
        coarse,
        march,
    )


def _no_conveying(config: ScreenConfig, layout: Layout, buffer: Array) -> InputError:
    """What to say of a deck that does not convey."""
    inputs = layout.view(buffer, "input")
    frequency, amplitude = inputs[lay.FREQUENCY], inputs[lay.AMPLITUDE]
    velocity = inputs[lay.DISPLACEMENT_VELOCITY]
    if config.displacement.model == "prescribed" and velocity == 0.0:
        return InputError(
            "displacement.velocity = 0 m/s does not convey, so there is no steady state: give the "
            "velocity of the bed",
            "displacement.velocity",
        )
    return InputError(
        f"motion.frequency = {frequency:.6g} Hz, motion.amplitude = {amplitude:.6g} m do not "
        "convey (bed velocity 0 m/s), so there is no steady state: raise them, turn the throw "
        'angle down-slope, or use displacement.model = "prescribed"',
        "motion.frequency",
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
    now = 0.0
    for row, time in zip(recovery, times, strict=True):
        run(buffer, FOLLOW, float(time) - now, 0.0)
        now = float(time)
        passed = by_class(nodes, layout.view(buffer, "lead_passed")[0], config.size_classes.count)
        np.divide(passed, fed, out=row, where=fed > 0.0)
    return recovery
