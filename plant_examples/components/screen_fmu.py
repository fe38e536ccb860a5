"""The screen as an FMU, driven step by step."""

from __future__ import annotations

import subprocess
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from fmpy.fmi1 import FMICallException

from components.instance import STARTED, running
from components.stream import Array, Rates, composition

__all__ = ["RefusedStepError", "RunningScreen", "ScreenFmu", "ScreenStep", "build_if_missing"]

BUILD = Path(__file__).resolve().parents[2] / "build_fmu.py"


def build_if_missing(fmu: Path) -> Path:
    """The FMU of the default screen at that path, as it is or built now."""
    if not fmu.exists():
        subprocess.run([sys.executable, str(BUILD), "--output", str(fmu.parent)], check=True)
    return fmu


class RefusedStepError(RuntimeError):
    """A step that the FMU did not do, with what it logged; its state is as before the step."""


@dataclass(frozen=True)
class ScreenStep:
    """What a screen did during one step; streams are means over it, by size class, kg/s."""

    undersize: Rates
    oversize: Rates
    power: float  # electric, W
    alarms: tuple[str, ...] = ()


class RunningScreen(Protocol):
    """What a circuit needs of a screen: limits of its size classes, m; mass on it, kg; a step."""

    edges: Array
    hold_up: float

    def step(self, feed: Rates, frequency: float, step: float) -> ScreenStep:
        """Screen a feed (kg/s by class) for `step` seconds."""


class ScreenFmu:
    """A VibratingScreen FMU with one deck, which runs inside a `with` statement.

    `edges` are the limits of its size classes in m, N + 1 values, finest first; `hold_up` is the
    mass on the deck now, kg.
    """

    def __init__(self, path: Path) -> None:
        """Nothing runs yet."""
        self._path = path
        self._messages: list[str] = []

    def __enter__(self) -> Self:
        """Start it with the start values of the FMU.

        ValueError if it has more than one deck: this class has no place for the middle products.
        """
        with ExitStack() as stack:
            self._slave, reference = stack.enter_context(
                running(self._path, "screen", self._messages.append)
            )
            if "intermediate[1].mass_flow_rate" in reference:
                raise ValueError(
                    f"{self._path} has more than one deck: build a screen with one [[deck]]"
                )
            self._look_up(reference)
            self._running = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End it, whatever happened."""
        self._running.__exit__(kind, error, trace)

    def _look_up(self, reference: dict[str, int]) -> None:
        """Find the variables of a step, read the sizes and what lies on the deck."""
        classes = sum(name.startswith("feed.mass_fraction[") for name in reference)

        def stream(name: str) -> list[str]:
            fractions = [f"{name}.mass_fraction[{i}]" for i in range(1, classes + 1)]
            return [f"{name}.mass_flow_rate", *fractions]

        inputs = [*stream("feed"), "motion.frequency"]
        outputs = [*stream("undersize"), *stream("oversize"), "drive.power", "bed.hold_up"]
        limits = [f"size_class[{i}].lower" for i in range(1, classes + 1)]
        limits.append(f"size_class[{classes}].upper")
        self._inputs = [reference[name] for name in inputs]
        self._outputs = [reference[name] for name in outputs]
        self._alarms = {name: at for name, at in reference.items() if name.startswith("alarm.")}
        self.edges = np.array(self._slave.getReal([reference[name] for name in limits]))
        (self.hold_up,) = self._slave.getReal([reference["bed.hold_up"]])
        self._composition = np.full(classes, 1.0 / classes)
        self._time = STARTED

    def step(self, feed: Rates, frequency: float, step: float) -> ScreenStep:
        """Feed (kg/s by class) the screen that vibrates at `frequency` (Hz) for `step` seconds.

        Raises RefusedStepError with the FMU's own words if it refuses the step: fmi2Discard of the
        python runtime, fmi2Error of the native one.
        """
        self._composition = composition(feed, at_rest=self._composition)
        self._slave.setReal(self._inputs, [feed.sum(), *self._composition, frequency])
        self._messages.clear()
        try:
            self._slave.doStep(self._time, step)
        except FMICallException as error:
            why = "; ".join(self._messages) or f"status {error.status}, nothing was logged"
            raise RefusedStepError(
                f"step of {step:g} s at {self._time:g} s refused: {why}"
            ) from error
        self._time += step
        *streams, power, self.hold_up = self._slave.getReal(self._outputs)
        rows = np.reshape(streams, (2, -1))  # rate and fractions of undersize, then of oversize
        undersize, oversize = rows[:, :1] * rows[:, 1:]
        raised = self._slave.getBoolean([*self._alarms.values()])
        alarms = tuple(name for name, is_on in zip(self._alarms, raised, strict=True) if is_on)
        return ScreenStep(undersize, oversize, power, alarms)
