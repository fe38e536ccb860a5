"""Hostile callers: thousands of sequences of legal and illegal calls, alone and at once."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import build_fmu
from vibroscreen.config import ScreenConfig

DRIVER = Path(__file__).with_name("hostile.py")
PROCESSES = 2
# What passes through Python takes ten times as long.
SEQUENCES = {"native": 10_000, "python": 2_000}
# glibc keeps freed blocks of a size it has seen before for later: what it keeps would count as lost.
GIVEN_BACK = {"MALLOC_MMAP_THRESHOLD_": "65536"}


@pytest.fixture(scope="module", params=build_fmu.RUNTIMES)
def fmu(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[str, Path]:
    """A runtime, and the FMU of the default screen in it."""
    folder = tmp_path_factory.mktemp("hostile")
    return request.param, build_fmu.build(ScreenConfig.default(), folder, request.param)


def attack(fmu: Path, seeds: int, **options: int) -> list[dict[str, Any]]:
    """What drivers found, each in a process of its own, all at once; they must end well."""
    given = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    runs = [
        subprocess.Popen(
            [sys.executable, str(DRIVER), str(fmu), *given, "--seed", str(seed)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **GIVEN_BACK},
        )
        for seed in range(seeds)
    ]
    said = [run.communicate() for run in runs]
    for run, (_, error) in zip(runs, said, strict=True):
        assert run.returncode == 0, error
    return [json.loads(found) for found, _ in said]


def test_thousands_of_sequences_break_nothing(fmu: tuple[str, Path]) -> None:
    runtime, path = fmu
    found = attack(path, PROCESSES, sequences=SEQUENCES[runtime] // PROCESSES)
    print(found)
    assert sum(one["sequences"] for one in found) == SEQUENCES[runtime]
    for one in found:
        assert one["wrong"] == {}
        assert one["calls"] > 20 * one["sequences"]
        # A good part is refused, with a message: the callers are hostile.
        assert 0.1 < one["refused"] / one["calls"] < 0.5
        assert one["messages"] > 0.2 * one["refused"]
        assert one["left_bytes"] < 1000


def test_callers_at_once_break_nothing(fmu: tuple[str, Path]) -> None:
    (found,) = attack(fmu[1], 1, sequences=400, threads=8)
    assert found["sequences"] == 400
    assert found["wrong"] == {}
