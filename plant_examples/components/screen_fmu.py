"""The screen as an FMU, driven step by step through fmpy's low-level interface."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    defaultCallbacks,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Warning,
)

from components.mixer import Rates, composition

__all__ = ["RefusedStepError", "RunningScreen", "ScreenFmu", "ScreenStep"]

ALARMS = ("alarm.bed_depth", "alarm.capacity", "alarm.transport", "alarm.performance")


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

    edges: Rates
    hold_up: float

    def step(self, feed: Rates, frequency: float, step: float) -> ScreenStep:
        """Screen a feed (kg/s by class) for `step` seconds."""


class ScreenFmu:
    """A running instance of a VibratingScreen FMU with one deck; use it in a `with` statement.

    `edges` are the limits of its size classes in m, N + 1 values, finest first; `hold_up` is the
    mass on the deck now, kg. The unzipped FMU lives in a temporary folder that `close` removes.
    """

    def __init__(self, path: Path) -> None:
        """Unzip and initialise with the start values of the FMU.

        ValueError if it has more than one deck: this class has no place for the middle products.
        """
        description = read_model_description(path)
        reference = {v.name: v.valueReference for v in description.modelVariables}
        if "intermediate[1].mass_flow_rate" in reference:
            raise ValueError(f"{path} has more than one deck: build a screen with one [[deck]]")
        self._time = 0.0
        self._messages: list[str] = []
        self._folder = extract(path)
        try:
            self._slave = FMU2Slave(
                guid=description.guid,
                unzipDirectory=self._folder,
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName="screen",
            )
            self._slave.instantiate(callbacks=self._callbacks(), loggingOn=True)
        except BaseException:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise
        try:
            self._slave.setupExperiment(startTime=0.0)
            self._slave.enterInitializationMode()
            self._slave.exitInitializationMode()
            classes = sum(name.startswith("feed.mass_fraction[") for name in reference)
            names = [f"size_class[{i}].lower" for i in range(1, classes + 1)]
            names.append(f"size_class[{classes}].upper")
            self.edges = np.array(self._slave.getReal([reference[name] for name in names]))
            (self.hold_up,) = self._slave.getReal([reference["bed.hold_up"]])
        except BaseException:
            self.close()
            raise

        def stream(name: str) -> list[str]:
            fractions = [f"{name}.mass_fraction[{i}]" for i in range(1, classes + 1)]
            return [f"{name}.mass_flow_rate", *fractions]

        inputs = [*stream("feed"), "motion.frequency"]
        outputs = [*stream("undersize"), *stream("oversize")]
        outputs += ["bed.hold_up", "drive.power"]
        self._inputs = [reference[name] for name in inputs]
        self._outputs = [reference[name] for name in outputs]
        self._alarms = [reference[name] for name in ALARMS]
        self._composition = np.full(classes, 1.0 / classes)

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
        values = np.array(self._slave.getReal(self._outputs))
        streams = values[:-2].reshape(2, -1)  # rate and fractions of undersize, then of oversize
        undersize, oversize = streams[:, :1] * streams[:, 1:]
        self.hold_up = float(values[-2])
        raised = self._slave.getBoolean(self._alarms)
        return ScreenStep(
            undersize,
            oversize,
            power=float(values[-1]),
            alarms=tuple(name for name, is_on in zip(ALARMS, raised, strict=True) if is_on),
        )

    def _callbacks(self) -> fmi2CallbackFunctions:
        """Those of fmpy, and a logger that keeps warnings and errors."""

        def note(_: object, __: bytes, status: int, ___: bytes, message: bytes) -> None:
            if status >= fmi2Warning:
                self._messages.append(message.decode())

        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(note)
        callbacks.allocateMemory = defaultCallbacks.allocateMemory
        callbacks.freeMemory = defaultCallbacks.freeMemory
        return callbacks

    def close(self) -> None:
        """End the instance and remove the unzipped FMU."""
        try:
            self._slave.freeInstance()
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Self:
        """The running screen."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the instance, whatever happened."""
        try:
            if error is None:
                self._slave.terminate()
        finally:
            self.close()
