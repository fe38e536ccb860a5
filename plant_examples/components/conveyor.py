"""A belt conveyor: what is loaded leaves in the same order a fixed time later."""

from __future__ import annotations

from collections import deque

import numpy as np

from components.stream import Array

__all__ = ["Conveyor"]

ROUND_OFF = 1e-9  # share of the delay by which times may differ and still be the same


class Conveyor:
    """A belt that delays a stream by `delay` seconds, in plug flow (no mixing along the belt).

    The belt is a queue of parcels. A parcel is what was loaded at a constant rate during some time:
    (time s, mass by class kg). `unload` cuts the requested time off the head, `load` adds to the
    tail, so steps may vary freely and mass is conserved to round-off.

    In a closed loop the return is needed before the load of the same step is known: `unload`, then
    `load`, with steps no longer than the delay. `carry` does both for a load that is known, for any
    step, also one longer than the delay.
    """

    def __init__(self, delay: float, classes: int) -> None:
        """An empty belt; `delay` = length / belt speed, s. ValueError unless it is positive."""
        if not 0.0 < delay < np.inf:
            raise ValueError(f"delay = {delay} s must be positive: give belt length / belt speed")
        self.delay = delay
        self._none = np.zeros(classes)
        self._parcels: deque[tuple[float, Array]] = deque([(delay, self._none)])

    @property
    def held(self) -> Array:
        """Mass on the belt by size class, kg."""
        return np.sum([mass for _, mass in self._parcels], axis=0) if self._parcels else self._none

    @property
    def parcels(self) -> Array:
        """What lies on the belt, head first: a row (time s, mass by class kg) for every parcel."""
        return np.array([(time, *mass) for time, mass in self._parcels])

    @parcels.setter
    def parcels(self, rows: Array) -> None:
        self._parcels = deque((float(row[0]), row[1:].copy()) for row in rows)

    def load(self, stream: Array, step: float) -> None:
        """Put a stream (kg/s by class) on the tail for `step` seconds."""
        if stream.shape != self._none.shape:
            raise ValueError(
                f"stream has {stream.size} size classes, the belt was made for "
                f"{self._none.size}: give the stream on the same sieves"
            )
        self._parcels.append((step, stream * step))

    def unload(self, step: float) -> Array:
        """Mean rate by size class that leaves the head during the next `step` seconds, kg/s.

        ValueError if that is more than the belt holds, which is its delay.
        """
        missing, mass = step, self._none
        while missing > ROUND_OFF * self.delay:
            if not self._parcels:
                raise ValueError(
                    f"step = {step} s is longer than the delay of {self.delay} s: take shorter "
                    "steps, or load before unloading (carry)"
                )
            time, parcel = self._parcels.popleft()
            if time > missing + ROUND_OFF * self.delay:
                part = parcel * (missing / time)
                self._parcels.appendleft((time - missing, parcel - part))
                time, parcel = missing, part
            missing -= time
            mass = mass + parcel
        return mass / step

    def carry(self, stream: Array, step: float) -> Array:
        """Load a stream for `step` seconds; return the mean rate that leaves in that time, kg/s."""
        self.load(stream, step)
        return self.unload(step)
