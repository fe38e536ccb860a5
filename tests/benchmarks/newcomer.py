"""What a newcomer's first path costs, from the sieve analysis to the report.

    python tests/benchmarks/newcomer.py [--repeat N] [--output DIR] [--quick]

Every command in a process of its own, s of processor time and on the clock, medians of several;
the engine is compiled before. Writes newcomer.json.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.benchmarks.output import write_json
from vibroscreen.cli import COMMANDS
from vibroscreen.kernels import library

ROOT = Path(__file__).resolve().parents[2]
PARTS = ("engine", "fmu_src", "")
SIEVES = "size_mm;passing_pct\n45;100\n31,5;80\n22,4;66\n16;55\n8;35\n4;20\n2;11\n"
# In the order of the path; those that are not there yet are left out.
PATH = (
    ("new", "screen.toml", "--from", "sieves.csv", "--rate", "250", "--force"),
    ("check", "screen.toml"),
    ("solve", "screen.toml"),
    ("report", "screen.toml", "-o", "report.html"),
    ("explore", "screen.toml", "-o", "screen.html", "--no-open"),
)


def spend(arguments: tuple[str, ...], folder: Path) -> tuple[float, float]:
    """Processor time and time on the clock of a command [s]."""
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(str(ROOT / part) for part in PARTS)}
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "vibroscreen", *arguments],
        cwd=folder,
        env=variables,
        capture_output=True,
        text=True,
        check=False,
    )
    clock, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"vibroscreen {' '.join(arguments)}: {done.stdout}{done.stderr}")
    spent = (after.ru_utime + after.ru_stime) - (before.ru_utime + before.ru_stime)
    return spent, clock


def main(repeat: int = 5, output: Path | None = None, *, quick: bool = False) -> dict[str, Any]:
    """Measure, print, and write into `output` if it is given. Quick: once."""
    library.library()
    path = [("--help",), *(one for one in PATH if one[0] in COMMANDS)]
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sieves.csv").write_text(SIEVES)
        for arguments in path:
            runs = [spend(arguments, folder) for _ in range(1 if quick else repeat)]
            spent, clock = (statistics.median(times) for times in zip(*runs, strict=True))
            found[arguments[0]] = {"processor": spent, "clock": clock}
    found["whole path"] = {
        kind: sum(found[one[0]][kind] for one in path[1:]) for kind in ("processor", "clock")
    }
    print(f"{'vibroscreen':<14}{'processor s':>12}{'clock s':>10}")
    for command, times in found.items():
        print(f"{command:<14}{times['processor']:>12.2f}{times['clock']:>10.2f}")
    if output is not None:
        write_json(output, "newcomer", found)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    parser.add_argument("--quick", action="store_true", help="every command once")
    options = parser.parse_args()
    main(options.repeat, options.output, quick=options.quick)
