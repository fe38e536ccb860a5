"""The FMU of a screen, validated and tried; the command `vibroscreen build`."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated
from zipfile import ZipFile

import typer
from fmpy import platform
from fmpy.validation import validate_fmu

from vibroscreen.cli.options import Set, load
from vibroscreen.cli.terminal import progress, tell_error
from vibroscreen.config import ScreenConfig
from vibroscreen.kernels import library
from vibroscreen_fmu.native.fmu import PLATFORMS, write_native_fmu
from vibroscreen_fmu.package import summary, write_fmu
from vibroscreen_fmu.python_limits import IN_SHORT, lost_characters

OUTPUT = Path("dist")
RUNTIMES = ("native", "python")
# Runs in a process of its own, as a library that was loaded stays loaded.
TRIAL = """
import sys
from fmpy import simulate_fmu
screen, end = sys.argv[1], 2.0
run = simulate_fmu(screen, stop_time=end, step_size=1.0, output_interval=1.0, debug_logging=True)
if run["time"][-1] != end:  # a discarded step ends the run without an exception
    sys.exit(f"the run ended at {run['time'][-1]} s")
"""


def build(
    config: ScreenConfig,
    output: Path = OUTPUT,
    runtime: str = RUNTIMES[0],
    platforms: Sequence[str] = (),
) -> Path:
    """Write the FMU of a screen into the folder `output`, validate it and run two steps.

    platforms: of runtime = native, those at hand if none is named. Returns the path. Raises
    ConfigError for a configuration or a platform that an FMU cannot carry, RuntimeError with what
    was found if the file is not valid or does not run. A file that was there stays then.
    """
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=output) as folder:
        if runtime == "native":
            made = write_native_fmu(config, Path(folder), platforms)
        else:
            made = write_fmu(config, Path(folder))
        problems = validate_fmu(str(made))
        if not problems and runs_here(made):
            problems = _trial(made)
        if problems:
            raise RuntimeError("\n".join([f"{made.name} is of no use and was removed:", *problems]))
        return made.replace(output / made.name)


def platforms_of(path: Path) -> list[str]:
    """Platforms that an FMU has a library for; fmpy's own list leaves aarch64-linux out."""
    with ZipFile(path) as file:
        folders = [name.split("/") for name in file.namelist()]
    return sorted({parts[1] for parts in folders if parts[0] == "binaries" and len(parts) > 2})


def runs_here(path: Path) -> bool:
    """Whether an FMU has a library for this machine."""
    return platform in platforms_of(path)


def _trial(path: Path) -> list[str]:
    """What an FMU says when it does not run; nothing if it does."""
    command = [sys.executable, "-c", TRIAL, str(path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    return [] if run.returncode == 0 else [run.stdout + run.stderr]


# --- the command ---------------------------------------------------------------------------------
EXAMPLES = """vibroscreen build screen.toml
vibroscreen build screen.toml --output dist --runtime both
vibroscreen build screen.toml --platform linux64 --platform win64"""


def command(
    screen: Annotated[
        Path | None,
        typer.Argument(
            metavar="[SCREEN]",
            help="What the screen is (TOML); a typical quarry screen if left out.",
        ),
    ] = None,
    runtime: Annotated[str, typer.Option(help=f"{', '.join(RUNTIMES)} or both.")] = RUNTIMES[0],
    platform: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Of runtime = native, again for more: {', '.join(PLATFORMS)}; this machine's and "
            "what else is at hand if left out."
        ),
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the FMU.")] = OUTPUT,
    changes: Set = None,
) -> None:
    """Build the FMU of a screen, validate it and run two steps."""
    if runtime not in (*RUNTIMES, "both"):
        raise typer.BadParameter(
            f"runtime = {runtime!r} does not exist: choose {', '.join(RUNTIMES)} or both",
            param_hint="--runtime",
        )
    if platform and runtime == "python":
        raise typer.BadParameter(
            "it is for runtime = native: the python runtime has all that it can run",
            param_hint="--platform",
        )
    if changes and screen is None:
        raise typer.BadParameter("it changes keys of a file: give SCREEN", param_hint="--set")
    config = ScreenConfig.default() if screen is None else load(screen, changes)
    library.library()  # compiled first, if it has to be: that tells of itself
    chosen = RUNTIMES if runtime == "both" else (runtime,)
    try:
        with progress("building"):
            paths = [build(config, output, one, platform or ()) for one in chosen]
    except RuntimeError as error:
        tell_error(error)
        raise typer.Exit(code=1) from None
    for path in paths:
        print(f"{path} ({_size(path)}) for {', '.join(platforms_of(path))}")
        print(summary(config))
        tried = "two steps ran" if runs_here(path) else "not run, no library for this machine"
        print(f"fmpy found no problem, {tried}")
    if "python" in chosen:
        print(*IN_SHORT, sep="\n")
        if lost := lost_characters(output):
            print(f"do not unzip it in {output.resolve()}: {' '.join(lost)} in that path")


def _size(path: Path) -> str:
    size = path.stat().st_size
    return f"{size / 1e6:.1f} MB" if size > 1e6 else f"{size / 1e3:.0f} kB"
