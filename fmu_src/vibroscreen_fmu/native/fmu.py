"""The FMU of the native runtime: the engine library, and what a screen adds to it as data."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen.kernels import library
from vibroscreen_fmu.model_description import guid_of, model_description
from vibroscreen_fmu.native.tables import SHEET_FILE, own_models, sheet
from vibroscreen_fmu.package import (
    NO_ENGINE,
    Files,
    build_of,
    engine,
    model_files,
    screen_model,
    write_zip,
)

__all__ = ["PLATFORMS", "write_native_fmu"]

PLATFORMS = tuple(library.SUFFIX)
NEEDS = (
    "Nothing: the engine is inside, as machine code for {platforms}. The library needs the C "
    "library of the system only (Linux: glibc 2.17 of 2012 or newer; Windows: 10 or newer; macOS: "
    "11 or newer), and resources/screen.bin of this FMU, which it looks for beside itself and then "
    "where the host says. No Python. Instances may run in threads of their own. A refused step "
    "returns fmi2Error and the instance goes on. A tolerance of fmi2SetupExperiment becomes "
    "solver.tolerance."
)
LICENCE = "MIT."
TOOL = "vibroscreen, compiled ahead of time"


def write_native_fmu(config: ScreenConfig, folder: Path, platforms: Sequence[str] = ()) -> Path:
    """Write `VibratingScreen.fmu` of a screen into a folder, for all platforms at hand by default.

    An engine library that is not at hand is made for this machine, and for platforms that are
    named. Raises ConfigError for a configuration or a platform that it cannot be made for.
    """
    model = screen_model(config, built_in=False)
    libraries = _libraries(platforms)
    guid = guid_of(model.name, model.ports, model.description)
    build = build_of(model, engine(model.slave[0]))
    read = ScreenConfig.loads(config.to_toml())
    needs = NEEDS.format(platforms=", ".join(libraries))
    description = model_description(model.name, model.ports, model.description, tool=TOOL)
    files: Files = {
        **model_files(model, description, (("What the host needs", (needs,)),), LICENCE),
        f"resources/{SHEET_FILE}": sheet(read, model.ports, model.name, guid, build),
    }
    own = own_models(read)
    for target, path in libraries.items():
        place = f"binaries/{target}/{model.name}"
        files[f"{place}{path.suffix}"] = path.read_bytes()
        if own:
            from vibroscreen_fmu.native.own import own_library  # a compiler, for who brings one

            title = f"{model.name}_own"
            files[f"{place}_own{path.suffix}"] = own_library(own, title, target)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{model.name}.fmu"
    write_zip(path, files)
    return path


def _libraries(platforms: Sequence[str]) -> dict[str, Path]:
    """Engine libraries by platform: those that are named, or those at hand."""
    for target in platforms:
        if target not in PLATFORMS:
            raise ConfigError(
                f"platform = {target!r} is unknown: give one or more of {', '.join(PLATFORMS)}"
            )
    found = {target: library.library(target) for target in platforms} or library.at_hand()
    there = {target: path for target, path in found.items() if path}
    if not there or len(there) < len(found):
        raise ConfigError(NO_ENGINE)
    return there
