"""Between the machines: streams meet, are split, ride on belts and wait in bins."""

from __future__ import annotations

import dataclasses
from collections import deque
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from vibroscreen.circuit.unit import Array, Given, Mixed, Running, Target, Unit
from vibroscreen.errors import ConfigError, InputError
from vibroscreen.fields import number, said
from vibroscreen.units import GRAVITY, HOUR, KW, T_H, TONNE

__all__ = ["Belt", "Bin", "Conveyor", "Mixer", "Splitter"]

ROUND_OFF = 1e-9  # share of the delay by which times may differ and still be the same


@dataclass(frozen=True, kw_only=True)
class Mixer(Unit):
    """A chute: what comes in leaves at once. Any unit mixes what leads to it."""

    product: str = said(dataclasses.MISSING, Target("product"))

    def transfers(self, edges: Array, given: Given) -> dict[str, Array]:
        return {"product": np.ones((1, edges.size - 1))}

    def start(self, edges: Array) -> Running:
        return _AtOnce(self, edges)


@dataclass(frozen=True, kw_only=True)
class Splitter(Unit):
    """A gate that sends a share of its feed, of all sizes alike, one way and the rest another."""

    share: float = number(
        dataclasses.MISSING,
        "share",
        at_least=0.0,
        at_most=1.0,
        variability="tunable",
        tells="Share of the feed that leaves as product",
    )
    product: str = said(dataclasses.MISSING, Target("product"))
    rest: str = said(dataclasses.MISSING, Target("rest"))

    def transfers(self, edges: Array, given: Given) -> dict[str, Array]:
        share = self.number(given, "share") * np.ones(edges.size - 1)
        return {"product": share, "rest": 1.0 - share}

    def start(self, edges: Array) -> Running:
        return _AtOnce(self, edges)


@dataclass(frozen=True, kw_only=True)
class Conveyor(Unit):
    """A belt: what is loaded leaves in the same order a fixed time later.

    delay: belt length over belt speed [s]; its power is that of the lift [m] over the efficiency,
    and what it draws empty.
    """

    has_drive: ClassVar = True

    delay: float = number(
        dataclasses.MISSING,
        "delay_s",
        "s",
        above=0.0,
        at_most=HOUR,
        tells="Time on the belt: its length over its speed",
    )
    product: str = said(dataclasses.MISSING, Target("product"))
    lift: float = number(0.0, "lift_m", "m", at_least=0.0, at_most=500.0)
    efficiency: float = number(0.85, "efficiency", above=0.0, at_most=1.0)
    idle_power: float = number(0.0, "idle_power_kw", "W", KW, at_least=0.0, at_most=1000.0 * KW)

    def transfers(self, edges: Array, given: Given) -> dict[str, Array]:
        return {"product": np.ones((1, edges.size - 1))}

    def power(self, edges: Array, feed: Array, product: Array, given: Given | None = None) -> Array:
        """Electric power [W]: m g h over the efficiency, and the idle power."""
        lift, efficiency, idle = (
            self.number(given, name)[:, 0] for name in ("lift", "efficiency", "idle_power")
        )
        return np.asarray(feed.sum(axis=-1) * GRAVITY * lift / efficiency + idle)

    def start(self, edges: Array) -> Running:
        return Belt(self.delay, edges.size - 1)


@dataclass(frozen=True, kw_only=True)
class Bin(Unit):
    """A surge bin, perfectly mixed: it discharges up to a rate, and holds what comes beyond it.

    In a steady state what comes in goes out: a feed above the discharge rate never settles.
    capacity [kg]: the most that it holds, any if None.
    """

    discharge_rate: float = number(
        dataclasses.MISSING,
        "discharge_rate_t_h",
        "kg/s",
        T_H,
        above=0.0,
        at_most=5000.0,
        variability="tunable",
        tells="The most that leaves the bin",
    )
    product: str = said(dataclasses.MISSING, Target("product"))
    capacity: float | None = number(None, "capacity_t", "kg", TONNE, above=0.0, optional=True)

    def transfers(self, edges: Array, given: Given) -> dict[str, Array]:
        return {"product": np.ones((1, edges.size - 1))}

    def most(self, given: Given) -> Array:
        """What it discharges at the most [kg/s]."""
        return np.asarray(given.get("discharge_rate", self.discharge_rate))

    def start(self, edges: Array) -> Running:
        return _Heap(self, edges)


# --- through time ---------------------------------------------------------------------------------
class _AtOnce(Running):
    """A unit that holds nothing."""

    def __init__(self, unit: Unit, edges: Array) -> None:
        self._shares = unit.transfers(edges, {})

    def step(self, feed: Array, dt: float) -> dict[str, Array]:
        return {outlet: share[0] * feed for outlet, share in self._shares.items()}


class _Heap(Mixed):
    """What lies in a bin."""

    def __init__(self, unit: Bin, edges: Array) -> None:
        super().__init__(edges)
        self._unit = unit

    def step(self, feed: Array, dt: float) -> dict[str, Array]:
        there = self._held + feed * dt
        total = there.sum()
        share = min(1.0, self._unit.discharge_rate * dt / total) if total > 0.0 else 0.0
        left = share * there
        room, stays = self._unit.capacity, there - left
        if room is not None and stays.sum() > room:
            raise InputError(
                f"{self._unit.name}.capacity = {room / TONNE:g} t is full: feed less, discharge "
                "more, or make the bin larger"
            )
        self._held = stays
        return {"product": left / dt}


class Belt(Running):
    """What lies on a belt, a queue of parcels in plug flow.

    A parcel is what was loaded at a constant rate during some time: (time [s], mass by class [kg]).
    `unload` cuts the requested time off the head, `load` adds to the tail, so steps may vary freely
    and mass is conserved to round-off. In a closed loop the return is needed before the load of the
    same step is known: `unload`, then `load`, with steps no longer than the delay. `step` does both
    for a load that is known, for any step, also one longer than the delay.
    """

    def __init__(self, delay: float, classes: int) -> None:
        """An empty belt; `delay` = length / belt speed, s. ConfigError unless it is positive."""
        if not 0.0 < delay < np.inf:
            raise ConfigError(f"delay = {delay} s must be positive: give belt length / belt speed")
        self.delay = delay
        self._none = np.zeros(classes)
        self._parcels: deque[tuple[float, Array]] = deque([(delay, self._none)])

    @property
    def held(self) -> Array:
        """Mass on the belt by size class [kg], shape [N]."""
        return np.sum([mass for _, mass in self._parcels], axis=0) if self._parcels else self._none

    @property
    def memory(self) -> Array:
        """What lies on the belt, head first: time [s] and mass by class [kg] of every parcel."""
        return np.array([(time, *mass) for time, mass in self._parcels]).ravel()

    @memory.setter
    def memory(self, row: Array) -> None:
        parcels = row.reshape(-1, 1 + self._none.size)
        self._parcels = deque((float(parcel[0]), parcel[1:].copy()) for parcel in parcels)

    def load(self, stream: Array, dt: float) -> None:
        """Put a stream (kg/s by class) on the tail for dt seconds."""
        if stream.shape != self._none.shape:
            raise ConfigError(
                f"stream has {stream.size} size classes, the belt was made for "
                f"{self._none.size}: give the stream on the same sieves"
            )
        self._parcels.append((dt, stream * dt))

    def unload(self, dt: float) -> Array:
        """Mean rate by size class that leaves the head during the next dt seconds [kg/s].

        ConfigError if that is more than the belt holds, which is its delay.
        """
        missing, mass = dt, self._none
        while missing > ROUND_OFF * self.delay:
            if not self._parcels:
                raise ConfigError(
                    f"dt = {dt} s is longer than the delay of {self.delay} s: take shorter "
                    "steps, or load before unloading (step)"
                )
            time, parcel = self._parcels.popleft()
            if time > missing + ROUND_OFF * self.delay:
                part = parcel * (missing / time)
                self._parcels.appendleft((time - missing, parcel - part))
                time, parcel = missing, part
            missing -= time
            mass = mass + parcel
        return mass / dt

    def step(self, feed: Array, dt: float) -> dict[str, Array]:
        """Load for dt seconds; the mean rate that leaves in that time."""
        self.load(feed, dt)
        return {"product": self.unload(dt)}
