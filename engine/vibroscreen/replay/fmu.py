"""An FMU of a screen that goes through a plant's data in the place of the engine, by fmpy."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.figures import ALARMS
from vibroscreen.replay.run import Stepper
from vibroscreen.stream import Feed, product_names
from vibroscreen.units import KW, MM, T_H

__all__ = ["fmu_stepper"]

MOTION = ("frequency", "amplitude", "throw_angle", "ellipticity")
# Limits of size classes that differ by less are the same [1].
SAME = 1e-9


@contextmanager
def fmu_stepper(path: Path) -> Iterator[Callable[[ScreenConfig], Stepper]]:
    """What makes a stepper for `replay` of an FMU, native or python, that ends with the block.

    Raises InputError for a file that is no FMU of a screen, or not of that of the configuration;
    OSError, ImportError without fmpy.
    """
    try:
        import fmpy
        import fmpy.fmi2
    except ImportError:
        raise ImportError(
            "--fmu needs fmpy, which is not installed: pip install 'vibroscreen[fmu]'"
        ) from None
    path.stat()  # tells of a file that is not there by its name
    with ExitStack() as undo:
        try:
            description = fmpy.read_model_description(str(path))
            folder = fmpy.extract(str(path))
        except Exception as error:  # whatever its parsers raise
            raise InputError(
                f"{path} is no FMU ({error}): build one with vibroscreen build"
            ) from None
        undo.callback(shutil.rmtree, folder, ignore_errors=True)
        yield lambda config: _FmuStepper(fmpy, description, folder, config, undo)


class _FmuStepper:
    """A running instance; its inputs and outputs by name."""

    def __init__(
        self, fmpy: Any, description: Any, folder: str, config: ScreenConfig, undo: ExitStack
    ) -> None:
        self._refused = fmpy.fmi1.FMICallException
        self._reference = {v.name: v.valueReference for v in description.modelVariables}
        _check_same(description, config)
        self._said: list[str] = []
        self._callbacks = _callbacks(fmpy.fmi2, self._said)  # kept as long as the instance
        self._slave = fmpy.fmi2.FMU2Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="replay",
        )
        self._time = 0.0
        self._rows = _outputs(len(config.decks))
        self._numbers = [self._reference[name] for name, _ in self._rows.values()]
        self._alarms = [self._reference[alarm.name] for alarm in ALARMS]
        self._call(self._slave.instantiate, callbacks=self._callbacks, loggingOn=True)
        undo.callback(self._slave.freeInstance)
        self._call(self._slave.setupExperiment, startTime=0.0)
        self._call(self._slave.enterInitializationMode)
        self._set(config.feed, config.motion)
        self._call(self._slave.exitInitializationMode)

    def step(self, duration: float, feed: Feed, motion: Any) -> dict[str, float | str]:
        """Advance; figures in the units of their keys. Raises InputError as the FMU says it."""
        self._set(feed, motion)
        self._call(self._slave.doStep, self._time, duration)
        self._time += duration
        numbers = self._slave.getReal(self._numbers)
        row: dict[str, float | str] = {
            key: float(number) / size
            for (key, (_, size)), number in zip(self._rows.items(), numbers, strict=True)
        }
        alarms = self._slave.getBoolean(self._alarms)
        row["alarms"] = " ".join(a.name for a, on in zip(ALARMS, alarms, strict=True) if on)
        return row

    def _set(self, feed: Feed, motion: Any) -> None:
        values = {"feed.mass_flow_rate": feed.mass_flow_rate}
        for k, share in enumerate(feed.mass_fraction, start=1):
            values[f"feed.mass_fraction[{k}]"] = share
        values.update({f"motion.{name}": getattr(motion, name) for name in MOTION})
        references = [self._reference[name] for name in values]
        self._call(self._slave.setReal, references, list(values.values()))

    def _call(self, function: Callable[..., Any], *given: Any, **named: Any) -> None:
        self._said.clear()
        try:
            function(*given, **named)
        except self._refused as error:
            raise InputError("; ".join(self._said) or f"the FMU refused: {error}") from None


def _outputs(decks: int) -> dict[str, tuple[str, float]]:
    """Columns of a replay in their order: the variable of the FMU, and their unit in its unit."""
    found = {"feed_t_h": ("deck[1].performance.feed_rate", T_H)}
    for stream in product_names(decks):
        found[f"{stream}_t_h"] = (f"{stream}.mass_flow_rate", T_H)
    for k in range(1, decks + 1):
        found[f"deck[{k}].efficiency"] = (f"deck[{k}].performance.efficiency", 1.0)
        found[f"deck[{k}].depth_discharge_mm"] = (f"deck[{k}].bed.depth_discharge", MM)
    found["undersize_p80_mm"] = ("undersize.p80", MM)
    found["hold_up_kg"] = ("bed.hold_up", 1.0)
    found["drive_power_kw"] = ("drive.power", KW)
    found["balance_error_kg"] = ("balance.error", 1.0)
    return found


def _check_same(description: Any, config: ScreenConfig) -> None:
    """Raise InputError where the FMU is of a screen with other classes or decks."""
    starts = {v.name: v.start for v in description.modelVariables}
    classes, decks = config.size_classes, len(config.decks)
    for name, _ in _outputs(decks).values():
        if name not in starts:
            raise InputError(f"the FMU has no {name}: build it from this screen's file")
    for more in (f"size_class[{classes.count + 1}].upper", f"deck[{decks + 1}].bed.hold_up"):
        if more in starts:
            raise InputError(f"the FMU has {more}, the screen has not: build it from this file")
    for k, upper in enumerate(classes.upper, start=1):
        name = f"size_class[{k}].upper"
        there = float(starts.get(name) or "nan")
        if not abs(there - upper) <= SAME * upper:
            raise InputError(
                f"the FMU has {name} = {there / MM:g} mm, the screen {upper / MM:g} mm: build it "
                "from this screen's file"
            )


def _callbacks(fmi2: Any, said: list[str]) -> Any:
    """Callbacks of fmpy with a logger that keeps warnings and errors."""

    def log(_: object, __: bytes, status: int, ___: bytes, message: bytes) -> None:
        if status >= fmi2.fmi2Warning:
            said.append(message.decode(errors="replace"))

    found = fmi2.fmi2CallbackFunctions()
    found.logger = fmi2.fmi2CallbackLoggerTYPE(log)
    found.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    found.freeMemory = fmi2.defaultCallbacks.freeMemory
    return found
