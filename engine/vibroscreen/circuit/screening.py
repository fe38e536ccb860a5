"""A screen in a circuit: a configuration of the engine, and where its products lead."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from vibroscreen.circuit.unit import Array, Given, Running, Target, Unit
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen.fields import Entry, FileOf, as_tuple, said
from vibroscreen.motion import Motion
from vibroscreen.results import StepResult
from vibroscreen.screen import Screen
from vibroscreen.size_classes import SizeClasses
from vibroscreen.stream import Feed
from vibroscreen.sweep import SteadyTable, Sweep

__all__ = ["RunningScreen", "ScreenUnit"]

# Tolerance at which results have no steps that a circuit could swing about.
SHARP = 1e-6


class _Between(Entry):
    """Where the products between the decks lead, top deck first."""

    key = "intermediate"

    def check(self, name: str, value: Any) -> tuple[str, ...]:
        names = as_tuple(value)
        if names is None or not all(isinstance(one, str) for one in names):
            raise ConfigError(f"{name} = {value!r} is not a list of names: give one a lower deck")
        return names


@dataclass(frozen=True, kw_only=True)
class ScreenUnit(Unit):
    """A vibrating screen of one deck or more.

    Its size classes are those of the circuit and its duty is what the circuit feeds it: what the
    configuration says of both is left aside.
    """

    config: ScreenConfig = said(
        dataclasses.MISSING, FileOf("file", {"file": ScreenConfig}, "a screen", "the circuit")
    )
    undersize: str = said(dataclasses.MISSING, Target("undersize"))
    oversize: str = said(dataclasses.MISSING, Target("oversize"))
    intermediate: tuple[str, ...] = said((), _Between())

    def __post_init__(self) -> None:
        super().__post_init__()
        lower = len(self.config.decks) - 1
        if len(self.intermediate) != lower:
            raise ConfigError(
                f"{self.name}.intermediate has {len(self.intermediate)} names, the screen has "
                f"{lower} {'deck' if lower == 1 else 'decks'} below the top: give one name for "
                "what leaves over each"
            )

    @property
    def targets(self) -> dict[str, str]:
        between = {f"intermediate[{k}]": to for k, to in enumerate(self.intermediate, start=1)}
        return {"undersize": self.undersize, "oversize": self.oversize} | between

    def with_values(self, values: Mapping[str, Any]) -> ScreenUnit:
        """The same screen with other numbers by name of the FMU's variables, SI, checked again."""
        return dataclasses.replace(self, config=self.config.with_values(values))

    def on(self, classes: SizeClasses) -> ScreenUnit:
        """The same screen on the size classes of a circuit."""
        feed = Feed(self.config.feed.mass_flow_rate)
        return dataclasses.replace(
            self, config=self.config.replace(size_classes=classes, feed=feed)
        )

    @cached_property
    def _sweep(self) -> Sweep:
        return Sweep([self.config])

    @cached_property
    def _sharp(self) -> Sweep:
        least = min(SHARP, self.config.solver.tolerance)
        return Sweep([self.config.with_values({"solver.tolerance": least})])

    def solve(
        self, feed: Array, given: Given, threads: int | None = None, sharp: bool = False
    ) -> SteadyTable:
        """Steady states under feeds by class [design, class; kg/s], and other numbers by name.

        sharp: at a tolerance of 1e-6. A design that the engine refuses has its reason in `refused`.
        """
        total = feed.sum(axis=1)
        values: dict[str, Any] = {
            "feed.mass_flow_rate": total,
            "feed.mass_fraction": feed / total[:, None],
            **given,
        }
        sweep = self._sharp if sharp else self._sweep
        return sweep.solve(values, threads=threads, refused="mark")

    def ideal(self, given: Given) -> dict[str, Array]:
        """Share by class of every outlet [1 or design, class], were all that fits to pass."""
        edges = np.array(self.config.size_classes.edges)
        shares, left = {}, np.ones((1, edges.size - 1))
        for k, deck in enumerate(self.config.decks, start=1):
            names = [f"deck[{k}].panel[{p}].aperture" for p in range(1, len(deck.panels) + 1)]
            aperture = np.max(
                np.broadcast_arrays(
                    *(
                        np.atleast_1d(given.get(name, panel.aperture))
                        for name, panel in zip(names, deck.panels, strict=True)
                    )
                ),
                axis=0,
            )
            passes = np.clip((aperture[:, None] - edges[:-1]) / np.diff(edges), 0.0, 1.0)
            over = "oversize" if k == 1 else f"intermediate[{k - 1}]"
            shares[over], left = left * (1.0 - passes), left * passes
        return {"undersize": left} | shares

    @staticmethod
    def products(table: SteadyTable) -> dict[str, Array]:
        """Rates by class of every outlet [design, class], kg/s."""
        between = np.moveaxis(table.intermediate, 1, 0)
        return {"undersize": table.undersize, "oversize": table.oversize} | {
            f"intermediate[{k}]": rates for k, rates in enumerate(between, start=1)
        }

    def transfers(self, edges: Array, given: Given) -> dict[str, Array]:
        raise TypeError("what a screen makes of a feed depends on the feed: solve it")

    def start(self, edges: Array) -> Running:
        return RunningScreen(self.config)


class RunningScreen(Running):
    """A screen that runs through time; it vibrates as its configuration says, or as `motion`."""

    def __init__(self, config: ScreenConfig) -> None:
        self._screen = Screen(config)
        self._composition: Sequence[float] = config.feed.mass_fraction
        self.motion: Motion | None = None
        self.result: StepResult | None = None  # of the last step

    @property
    def held(self) -> Array:
        return np.array([self.result.hold_up if self.result else 0.0])

    def step(self, feed: Array, dt: float) -> dict[str, Array]:
        total = float(feed.sum())
        if total > 0.0:
            self._composition = (feed / total).tolist()
        self.result = self._screen.step(dt, Feed(total, tuple(self._composition)), self.motion)
        return {outlet: stream.class_rates for outlet, stream in self.result.products.items()}
