"""Build the FMU of a vibrating screen: `python build_fmu.py [CONFIG.toml] [--output DIR]`."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer
from fmpy.validation import validate_fmu
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen_fmu.package import summary, write_fmu

OUTPUT = Path("dist")
RUNTIMES = ("python",)
# Runs in a process of its own, as a library that was loaded stays loaded.
TRIAL = """
import sys
from fmpy import simulate_fmu
simulate_fmu(sys.argv[1], stop_time=2.0, step_size=1.0, output_interval=1.0, debug_logging=True)
"""


def build(config: ScreenConfig, output: Path = OUTPUT) -> Path:
    """Write the FMU of a screen into the folder `output`, validate it and run two steps.

    Returns its path. Raises ConfigError for a configuration that an FMU cannot carry, RuntimeError
    with what was found if the file is not valid or does not run. A file that was there stays then.
    """
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=output) as folder:
        made = write_fmu(config, Path(folder))
        problems = validate_fmu(str(made)) or _trial(made)
        if problems:
            raise RuntimeError("\n".join([f"{made.name} is of no use and was removed:", *problems]))
        return made.replace(output / made.name)


def _trial(path: Path) -> list[str]:
    """What an FMU says when it does not run; nothing if it does."""
    command = [sys.executable, "-c", TRIAL, str(path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    return [] if run.returncode == 0 else [run.stdout + run.stderr]


def main(
    config: Annotated[
        Path | None, typer.Argument(help="What the screen is; a typical quarry screen if left out.")
    ] = None,
    runtime: Annotated[str, typer.Option(help=" or ".join(RUNTIMES))] = RUNTIMES[0],
    output: Annotated[Path, typer.Option(help="Folder of the FMU.")] = OUTPUT,
) -> None:
    """Build VibratingScreen.fmu, validate it and say what it is."""
    errors = Console(stderr=True, soft_wrap=True, markup=False)
    if runtime not in RUNTIMES:
        errors.print(f"runtime = {runtime!r} does not exist: choose {' or '.join(RUNTIMES)}")
        raise typer.Exit(code=2)
    try:
        screen = ScreenConfig.default() if config is None else ScreenConfig.load(config)
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        with Progress(*columns, console=errors, transient=True) as progress:
            progress.add_task("building; the engine is compiled once per version")
            path = build(screen, output)
    except (ConfigError, OSError, RuntimeError) as error:
        errors.print("\n".join([str(error), *getattr(error, "__notes__", ())]))
        raise typer.Exit(code=1) from None
    print(f"{path} ({path.stat().st_size / 1e6:.1f} MB)")
    print(summary(screen))
    print("fmpy found no problem, two steps ran")


if __name__ == "__main__":
    typer.run(main)
