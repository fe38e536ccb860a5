"""A running instance of an FMU, through fmpy's low-level interface."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from fmpy import extract, read_model_description
from fmpy.fmi2 import (
    FMU2Slave,
    defaultCallbacks,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Warning,
)

__all__ = ["STARTED", "running"]

STARTED = 0.0  # s


@contextmanager
def running(
    fmu: Path, name: str, note: Callable[[str], object] = print
) -> Iterator[tuple[FMU2Slave, dict[str, int]]]:
    """An instance that has started, and the references of its variables; `note` gets its warnings.

    The FMU is unzipped into a temporary folder, which goes with the instance.
    """
    description = read_model_description(fmu)
    with ExitStack() as undo:
        folder = extract(fmu)
        undo.callback(shutil.rmtree, folder, ignore_errors=True)
        slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        slave.instantiate(callbacks=_noting(note), loggingOn=True)
        undo.callback(slave.freeInstance)
        slave.setupExperiment(startTime=STARTED)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        yield slave, {v.name: v.valueReference for v in description.modelVariables}
        slave.terminate()


def _noting(note: Callable[[str], object]) -> fmi2CallbackFunctions:
    """The callbacks of fmpy, with a logger that passes on warnings and errors."""

    def log(_: object, __: bytes, status: int, ___: bytes, message: bytes) -> None:
        if status >= fmi2Warning:
            note(message.decode())

    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(log)
    callbacks.allocateMemory = defaultCallbacks.allocateMemory
    callbacks.freeMemory = defaultCallbacks.freeMemory
    return callbacks
