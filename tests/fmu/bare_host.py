"""The bare host in C (host.c): FMUs that it runs, and how it ended."""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from fmpy import extract, read_model_description

import build_fmu
from tests.fmu.native import HOST, compiled
from vibroscreen.config import ScreenConfig
from vibroscreen_fmu.python_limits import HOST_SETUP

SOURCE = Path(__file__).with_name("host.c")
# Nothing else of this process: what a host needs, it is told.
BARE = {"PATH": os.pathsep.join([str(Path(sys.executable).parent), "/usr/bin", "/bin"])}


class Ended(NamedTuple):
    """How the host ended, and the lines that it printed."""

    code: int
    said: list[str]


@functools.cache
def commands_of_the_page() -> dict[str, str]:
    """The environment that the commands of the documentation page make of a bare one."""
    done = subprocess.run(
        ["sh", "-c", f"{HOST_SETUP}\nenv -0"], env=BARE, capture_output=True, text=True, check=True
    )
    return dict(line.split("=", 1) for line in done.stdout.split("\0") if line)


class BareHost:
    """The host, and the FMU of the default screen in one runtime, unzipped."""

    def __init__(self, runtime: str, folder: Path) -> None:
        self.runtime = runtime
        self.program = compiled(SOURCE, folder / "host", "-pthread")
        path = build_fmu.build(ScreenConfig.default(), folder, runtime)
        self.fmu = Path(extract(str(path), unzipdir=str(folder / "fmu")))
        description = read_model_description(str(self.fmu))
        reference = {v.name: v.valueReference for v in description.modelVariables}
        self.guid = description.guid
        rates = ("feed.mass_flow_rate", "undersize.mass_flow_rate")
        self.references = [str(reference[name]) for name in rates]

    def copied(self, folder: Path) -> Path:
        """The unzipped FMU in a folder of its own."""
        return shutil.copytree(self.fmu, folder / "fmu")

    def play(
        self,
        situation: str = "run",
        fmu: Path | None = None,
        location: str | None = None,
        times: int = 0,
        under: tuple[str, ...] = (),
        **more: str,
    ) -> Ended:
        """Run a situation in a process; the location is that of the standard unless given.

        under: what runs the program; more: of the environment.
        """
        fmu = fmu or self.fmu
        (library,) = (fmu / "binaries" / HOST).glob("VibratingScreen.*")
        place = (fmu / "resources").as_uri() if location is None else location
        words = [*under, self.program, library, self.guid, place, situation, times]
        words += self.references
        own = BARE if self.runtime == "native" else commands_of_the_page()
        done = subprocess.run(
            list(map(str, words)), env={**own, **more}, capture_output=True, text=True, check=False
        )
        return Ended(done.returncode, done.stdout.splitlines())
