"""Wheels that carry the engine library, one for each platform, and the engine for browsers.

    python engine/wheels.py [--output DIR] [PLATFORM ...]

builds those of all platforms on any machine (pip install -e '.[wheels]'). A wheel belongs to a
platform and to no version of Python. One that pip builds by itself carries no library: the engine
is compiled when it is first used.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOT = Path(__file__).resolve().parent.parent
# For the hook below, which runs in a process of its own: what the wheel carries, and its tag.
CARRIED, TAG = "VIBROSCREEN_WHEEL_CARRIES", "VIBROSCREEN_WHEEL_TAG"


class LibraryHook(BuildHookInterface):  # type: ignore[type-arg]
    """Puts the files of the folder CARRIED beside the kernels."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called by hatchling before it writes a wheel."""
        folder = os.environ.get(CARRIED)
        if version == "editable" or not folder:
            return
        for path in Path(folder).iterdir():
            build_data["force_include"][str(path)] = f"vibroscreen/kernels/{path.name}"
        build_data["pure_python"] = False
        build_data["tag"] = os.environ[TAG]


def build(platform: str, output: Path) -> Path:
    """Write the wheel of a platform into a folder; the engine is made first if it is not there."""
    from vibroscreen.compiler import machine
    from vibroscreen.compiler.library import WEB
    from vibroscreen.kernels import library

    kept = [library.library(target) for target in (platform, WEB)]
    if None in kept:
        raise SystemExit(f"the library for {platform} needs a linker: pip install ziglang")
    with tempfile.TemporaryDirectory() as folder:
        carried, made = Path(folder, "carried"), Path(folder, "made")
        carried.mkdir()
        for path in filter(None, kept):
            carried.joinpath(path.name).write_bytes(path.read_bytes())
        texts = {path.name: path.read_bytes() for path in library.sources()}
        carried.joinpath(library.STAMP).write_bytes(library.note(texts))
        tag = f"py3-none-{machine.PLATFORMS[platform].wheel}"
        command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation"]
        subprocess.run(
            [*command, "-w", str(made), str(ROOT)],
            check=True,
            env={**os.environ, CARRIED: str(carried), TAG: tag},
        )
        (wheel,) = made.iterdir()
        output.mkdir(parents=True, exist_ok=True)
        return Path(wheel.replace(output / wheel.name))


def main() -> None:
    """Build the wheels that are asked for, all unless told otherwise."""
    from vibroscreen.compiler import machine
    from vibroscreen.compiler.library import WEB
    from vibroscreen.kernels import library

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("platform", nargs="*", help=", ".join(machine.PLATFORMS))
    parser.add_argument("--output", type=Path, default=Path("dist"))
    given = parser.parse_args()
    asked = given.platform or list(machine.PLATFORMS)
    for name in asked:
        if name not in machine.PLATFORMS:
            parser.error(f"platform = {name!r} is unknown: give {', '.join(machine.PLATFORMS)}")
    library.library()  # what all platforms share; then each by a process of its own
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(library.library, [*asked, WEB]))
    for name in asked:
        wheel = build(name, given.output)
        print(f"{wheel} ({wheel.stat().st_size / 1e3:.0f} kB)")


if __name__ == "__main__":
    main()
