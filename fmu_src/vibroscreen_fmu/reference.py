"""A reference run of a screen: what an importer should find, in the files that are usual for it.

In extra/org.fmi-standard.fmi-ls-ref (FMI-LS-REF 1.0.0-alpha.1) lie the inputs, the outputs and the
options of the run, named and written as the rules of the FMI cross-check ask for.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterable, Sequence

import numpy as np
from lxml import etree
from numpy.typing import NDArray

from vibroscreen.config import ScreenConfig
from vibroscreen.screen import Screen
from vibroscreen_fmu.port import Port

__all__ = ["reference_files"]

Numbers = NDArray[np.float64]

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"
STANDARD = {
    "fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
    "fmi-ls-version": "1.0.0-alpha.1",
    "fmi-ls-description": (
        "Layered Standard providing information on related files included in an FMU."
    ),
}
STEP, STOP = 10.0, 600.0  # s
# From empty decks, at the duty; factors on inputs from a time on: more feed, then slower.
CHANGES = {"feed.mass_flow_rate": (200.0, 1.2), "motion.frequency": (400.0, 0.9)}
ERROR = "balance.error"
DIGITS = 9
# A host computes with the engine itself or on another processor: all that differs is round-off.
OPTIONS = {
    "StartTime": 0.0,
    "StopTime": STOP,
    "StepSize": STEP,
    "RelTol": 1e-6,
    "AbsTol": 1e-6,
    "SolverType": "FixedStep",
    "OutputIntervalLength": STEP,
}


def reference_files(name: str, config: ScreenConfig, ports: Iterable[Port]) -> dict[str, bytes]:
    """Files of the reference run of a screen, by path in the FMU."""
    table = tuple(ports)
    times = np.arange(0.0, STOP + STEP / 2, STEP)
    inputs = [port for port in table if port.causality == "input"]
    stimuli = np.array([_stimulus(port, times) for port in inputs])
    # What is round-off is no result.
    outputs = [p for p in table if p.causality == "output" and p.kind == "Real" and p.name != ERROR]
    screen = Screen(config)
    row = screen.buffer[screen.layout.section["parameters"].start :]
    given, places = ([port.reference for port in part] for part in (inputs, outputs))
    results = []
    for values in stimuli.T:
        screen.read()
        results.append(row[places])
        row[given] = values
        screen.advance(STEP)
    options = "".join(f"{key}, {value}\n" for key, value in OPTIONS.items()).encode()
    files = {
        f"{name}_in.csv": _csv(times, [port.name for port in inputs], stimuli.T),
        f"{name}_ref.csv": _csv(times, [port.name for port in outputs], np.array(results)),
        f"{name}_ref.opt": options,
    }
    told = {
        f"{name}_in.csv": ("text/csv", "testcase", "Inputs of the reference run"),
        f"{name}_ref.csv": ("text/csv", "result", "Outputs of the reference run"),
        f"{name}_ref.opt": ("text/plain", "configuration", "Times and steps of the reference run"),
    }
    files["fmi-ls-manifest.xml"] = _manifest(files, told)
    return {f"{FOLDER}/{file}": content for file, content in files.items()}


def _stimulus(port: Port, times: Numbers) -> Numbers:
    """An input at the start of every step; a master that interpolates meets no jump inside one."""
    after, factor = CHANGES.get(port.name, (0.0, 1.0))
    assert port.start is not None  # it is an input
    return port.start * np.where(times >= after, factor, 1.0)


def _csv(times: Numbers, names: Sequence[str], rows: Numbers) -> bytes:
    target = io.StringIO()
    writer = csv.writer(target, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    writer.writerow(["time", *names])
    for time, values in zip(times, rows, strict=True):
        text = ",".join(f"{value:.{DIGITS}g}" for value in (time, *values))
        target.write(f"{text}\n")
    return target.getvalue().encode()


def _manifest(files: dict[str, bytes], told: dict[str, tuple[str, str, str]]) -> bytes:
    attributes = {f"{{{NAMESPACE}}}{key}": value for key, value in STANDARD.items()}
    root = etree.Element("fmiReferences", attributes, nsmap={"fmi-ls": NAMESPACE})
    for source, (kind, role, description) in told.items():
        etree.SubElement(
            root,
            "Related",
            source=source,
            type=kind,
            role=role,
            description=description,
            checksum=hashlib.sha3_256(files[source]).hexdigest(),
        )
    xml: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return xml
