"""What starting costs: import, first call with and without a kept engine, an FMU's first step.

    python tests/benchmarks/import_time.py [--repeat N] [--output DIR] [--quick]

Each in a fresh process, s on the clock, medians of several; without a kept engine once (it is
compiled, about a minute: not with --quick). Writes import_time.json.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from build_fmu import build
from tests.benchmarks.output import write_json
from vibroscreen import ScreenConfig
from vibroscreen.kernels import library

Row = dict[str, Any]
ROOT = Path(__file__).resolve().parents[2]
PARTS = ("engine", "fmu_src", "plant_examples", "")

# What runs in a process of its own; prints a JSON object of times in s.
WATCH = """
import json, time
start = last = time.perf_counter()
laps = {}
def lap(name):
    global last
    laps[name] = time.perf_counter() - last
    last = time.perf_counter()
"""
NUMBA = WATCH + "import numba\nlap('import numba')\nprint(json.dumps(laps))"
FIRST = (
    WATCH
    + """
import vibroscreen
lap("import vibroscreen")
screen = vibroscreen.Screen(vibroscreen.ScreenConfig.default())
lap("first screen")
screen.step(1.0)
lap("first step")
screen.solve_steady()
lap("first steady solution")
print(json.dumps(laps))
"""
)
FMU = (
    WATCH
    + """
import sys
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
description = read_model_description(sys.argv[1])
folder = extract(sys.argv[1])
last = time.perf_counter()
slave = FMU2Slave(guid=description.guid, unzipDirectory=folder,
    modelIdentifier=description.coSimulation.modelIdentifier, instanceName="screen")
slave.instantiate()
lap("FMU instantiate")
slave.setupExperiment(startTime=0.0)
slave.enterInitializationMode()
slave.exitInitializationMode()
lap("FMU initialise")
slave.doStep(0.0, 1.0)
lap("FMU first step")
slave.doStep(1.0, 1.0)
lap("FMU second step")
print(json.dumps(laps), flush=True)
slave.freeInstance()
import shutil
shutil.rmtree(folder, ignore_errors=True)
"""
)


def run_fresh(script: str, cache: Path, *arguments: str, paths: bool = True) -> dict[str, float]:
    """Times in s that a script prints from a process of its own, the engine kept in `cache`."""
    variables = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    variables["PYTHONPATH"] = os.pathsep.join(str(ROOT / part) for part in PARTS) if paths else ""
    done = subprocess.run(
        [sys.executable, "-c", script, *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=variables,
    )
    if done.returncode:
        raise RuntimeError(done.stdout + done.stderr)
    laps: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return laps


def medians(runs: list[dict[str, float]]) -> dict[str, float]:
    """Median of every time."""
    return {name: statistics.median(run[name] for run in runs) for name in runs[0]}


def main(repeat: int = 7, output: Path | None = None, *, quick: bool = False) -> Row:
    """Measure, print, and write into `output` if it is given.

    Quick: two runs with the engine that is kept already.
    """
    repeat = 2 if quick else repeat
    found: Row = {"machine": platform.processor() or platform.machine(), "repeat": repeat}
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with (
        tempfile.TemporaryDirectory() as folder,
        Progress(*columns, console=Console(stderr=True)) as progress,
    ):
        whole = progress.add_task("cold", total=2 + 3 * repeat)
        cache = library.cache_folder().parent if quick else Path(folder, "cache")
        cold = {} if quick else run_fresh(FIRST, cache)
        progress.update(whole, advance=1, description="build the FMU")
        path = build(ScreenConfig.default(), Path(folder), "python")
        progress.advance(whole)
        run_fresh(FIRST, cache)
        runs: dict[str, list[dict[str, float]]] = {"numba": [], "warm": [], "fmu": []}
        for _ in range(repeat):
            progress.update(whole, description="warm")
            runs["numba"].append(run_fresh(NUMBA, cache))
            progress.advance(whole)
            runs["warm"].append(run_fresh(FIRST, cache))
            progress.advance(whole)
            # The FMU brings its own engine and knows nothing of this source tree.
            runs["fmu"].append(run_fresh(FMU, Path(folder, "fmu_cache"), str(path), paths=False))
            progress.advance(whole)
    found["numba"] = medians(runs["numba"])
    found["warm"], found["fmu"] = medians(runs["warm"]), medians(runs["fmu"])
    found["cold"] = cold
    print(f"{'fresh process, s':<28}{'kept engine':>14}{'none kept':>12}{'over':>8}")
    for name, spent in {**found["numba"], **found["warm"], **found["fmu"]}.items():
        line = f"{name:<28}{spent:>14.4f}"
        if name in cold:
            line += f"{cold[name]:>12.3f}{cold[name] / spent:>8.0f}"
        print(line)
    sums = {
        "import to first step": sum(
            found["warm"][k] for k in ("import vibroscreen", "first screen", "first step")
        ),
        "FMU to its first step": sum(
            found["fmu"][k] for k in ("FMU instantiate", "FMU initialise", "FMU first step")
        ),
    }
    found["sum"] = sums
    for name, spent in sums.items():
        print(f"{name:<28}{spent:>14.4f}   {'below' if spent < 1.0 else 'above'} one second")
    if output is not None:
        write_json(output, "import_time", found)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=7)
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    parser.add_argument("--quick", action="store_true", help="two runs, kept engine only")
    arguments = parser.parse_args()
    main(arguments.repeat, arguments.output, quick=arguments.quick)
