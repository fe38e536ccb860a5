"""Build the FMU of a vibrating screen: `python build_fmu.py [CONFIG.toml] [--runtime RUNTIME]`."""

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
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
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


def main(
    config: Annotated[
        Path | None, typer.Argument(help="What the screen is; a typical quarry screen if left out.")
    ] = None,
    runtime: Annotated[str, typer.Option(help=f"{', '.join(RUNTIMES)} or both")] = RUNTIMES[0],
    platform: Annotated[
        list[str] | None,
        typer.Option(
            help=f"of runtime = native, may be given several times: {', '.join(PLATFORMS)}; "
            "this machine's and what else is at hand if left out"
        ),
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder of the FMU.")] = OUTPUT,
) -> None:
    """Build VibratingScreen.fmu, or VibratingScreen_python.fmu; validate it, say what it is."""
    errors = Console(stderr=True, soft_wrap=True, markup=False)
    if runtime not in (*RUNTIMES, "both"):
        errors.print(f"runtime = {runtime!r} does not exist: choose {', '.join(RUNTIMES)} or both")
        raise typer.Exit(code=2)
    if platform and runtime == "python":
        errors.print("platform is for runtime = native: the python runtime has all that it can run")
        raise typer.Exit(code=2)
    try:
        screen = ScreenConfig.default() if config is None else ScreenConfig.load(config)
        library.library()  # compiled first, if it has to be: that tells of itself
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        with Progress(*columns, console=errors, transient=True) as progress:
            progress.add_task("building")
            chosen = RUNTIMES if runtime == "both" else (runtime,)
            paths = [build(screen, output, one, platform or ()) for one in chosen]
    except (ConfigError, OSError, RuntimeError) as error:
        errors.print("\n".join([str(error), *getattr(error, "__notes__", ())]))
        raise typer.Exit(code=1) from None
    for path in paths:
        print(f"{path} ({_size(path)}) for {', '.join(platforms_of(path))}")
        print(summary(screen))
        tried = "two steps ran" if runs_here(path) else "not run, no library for this machine"
        print(f"fmpy found no problem, {tried}")
    if "python" in chosen:
        print(*IN_SHORT, sep="\n")
        if lost := lost_characters(output):
            print(f"do not unzip it in {output.resolve()}: {' '.join(lost)} in that path")


def _size(path: Path) -> str:
    size = path.stat().st_size
    return f"{size / 1e6:.1f} MB" if size > 1e6 else f"{size / 1e3:.0f} kB"


if __name__ == "__main__":
    typer.run(main)
