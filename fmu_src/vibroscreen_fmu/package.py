"""An FMU file: the slave, its engine and its configuration in one zip, the same bytes every time.

Names of modules are global to a process, and two FMUs may bring two engines. So our packages go
into the FMU under names of their own, with a hash of their sources at the end: FMUs share what is
equal, and different engines and an installed `vibroscreen` live side by side.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import importlib.resources
import importlib.util
import os
import platform
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import llvmlite.binding
import numba

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen.kernels.registry import BUILT_IN
from vibroscreen.screen import check_supported
from vibroscreen.units import MM
from vibroscreen_fmu.documentation import index_html, model_png
from vibroscreen_fmu.model_description import MODEL_NAME, model_description
from vibroscreen_fmu.ports import ports
from vibroscreen_fmu.python_slave import CONFIG_FILE

__all__ = ["Engine", "engine", "summary", "write_fmu"]

Files = dict[str, bytes]

SLAVE = "vibroscreen_fmu.python_slave"
# What is vendored under one name, from the ground up. Kernels are apart, for they are compiled.
KERNELS, ENGINE, ADAPTER = PARTS = ("vibroscreen.kernels", "vibroscreen", "vibroscreen_fmu")
OUR_IMPORT = re.compile(
    rb"^(\s*(?:from|import)\s+)(vibroscreen\.kernels|vibroscreen_fmu|vibroscreen)(?=[.\s])",
    flags=re.MULTILINE,
)
TIMESTAMP = (1980, 1, 1, 0, 0, 0)  # the first that a zip can say
# Addresses of functions in the comments of a compiled kernel.
ADDRESS = re.compile(rb"(?<= at 0x)[0-9a-f]+(?=>)")

SCRIPT = '''"""The slave module: pythonfmu runs it by name, so the name is unique to this build."""

from numba import config

# Compiled kernels lie beside their sources, whatever cache the host uses for its own.
kept, config.CACHE_DIR = config.CACHE_DIR, ""
from {package}.python_slave import slave_class, take_reference

config.CACHE_DIR = kept
# pythonfmu's library runs this text for every instance, and gives back a reference to the names in
# it that it never took.
take_reference(globals())
{model} = slave_class("{model}", "{build}")
'''
# Runs in a process of its own: puts compiled kernels beside their sources.
COMPILE = """
import sys
sys.path.insert(0, sys.argv[1])
from numba import types
from {package}.entry import run
from {package}.jit import VECTOR
run.compile((VECTOR, types.intp, types.float64, types.float64))
"""
# The kernel that a screen calls; what it calls is inside it.
ENTRY = "entry.run-"


@dataclass(frozen=True)
class Engine:
    """What a slave imports, under its names in the FMU.

    package: name in the FMU of every part, which ends in a hash of its sources; sources: by path
    below the resources; requirements: what the sources import from others, as pip reads it.
    """

    package: Mapping[str, str]
    sources: Files
    requirements: tuple[str, ...]

    def compiled(self) -> Files:
        """Compiled kernels for this machine, as numba caches them beside their sources.

        Takes a minute or two the first time; the user's cache folder keeps them.
        """
        host = (sys.version, numba.__version__, llvmlite.binding.get_host_cpu_name())
        features = llvmlite.binding.get_host_cpu_features().flatten()
        key = _hash(repr((self.package[KERNELS], *host, features)).encode())
        caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        kept = caches / "vibroscreen" / f"kernels-{key}"
        if not kept.is_dir():
            kept.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
                stage, result = Path(folder, "stage"), Path(folder, "result")
                _write(stage, self.sources)
                self._compile(stage)
                _write(result, _compiled_entry(stage))
                try:
                    result.rename(kept)
                except OSError:
                    if not kept.is_dir():  # else another process was faster
                        raise
        return _read(kept)

    def _compile(self, stage: Path) -> None:
        script = COMPILE.format(package=self.package[KERNELS])
        # The same bytes every time: no settings of the caller, no random order of sets.
        plain = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
        subprocess.run(
            [sys.executable, "-c", script, str(stage)],
            check=True,
            env={**plain, "PYTHONHASHSEED": "0"},
        )


def engine() -> Engine:
    """What the slave imports, transitively."""
    modules, foreign = _closure(SLAVE)
    package: dict[str, str] = {}
    sources: Files = {}
    for part in PARTS:
        # Later parts import earlier ones: their names are part of the text that is hashed.
        own = {
            _place(name, path, part): _vendored(path.read_bytes(), package)
            for name, path in modules.items()
            if _part_of(name) == part
        }
        tag = _hash(*(piece for place in sorted(own) for piece in (place.encode(), own[place])))
        package[part] = f"{part.replace('.', '_')}_{tag}"
        within = {part: package[part]}
        for place, source in own.items():
            sources[f"{package[part]}/{place}"] = _vendored(source, within)
    # pythonfmu travels with the FMU. Of the others, what the FMU was built and tried with.
    needed = (f"{name}>={_release(name)}" for name in sorted(foreign - {"pythonfmu"}))
    return Engine(package, sources, tuple(needed))


def write_fmu(config: ScreenConfig, folder: Path) -> Path:
    """Write `VibratingScreen.fmu` of a screen into a folder.

    Raises ConfigError for a configuration that an FMU cannot carry.
    """
    check_supported(config)
    _check_built_in(config)
    parts = engine()
    text = config.to_toml()
    # What the slave will read, to the last digit.
    table = ports(ScreenConfig.loads(text))
    description = summary(config)
    package = parts.package[ADAPTER]
    build = _hash(package.encode(), text.encode())
    module = f"{MODEL_NAME}_{build}"
    resources = {
        f"{module}.py": SCRIPT.format(package=package, model=MODEL_NAME, build=build).encode(),
        "slavemodule.txt": module.encode(),
        "requirements.txt": "".join(f"{name}\n" for name in parts.requirements).encode(),
        CONFIG_FILE: text.encode(),
        **_pythonfmu_sources(),
        **parts.sources,
        **parts.compiled(),
    }
    python = platform.python_version()
    files = {
        "modelDescription.xml": model_description(table, description),
        "model.png": model_png(),
        "documentation/index.html": index_html(description, table, parts.requirements, python),
        "documentation/licenses/pythonfmu.txt": _pythonfmu_license(),
        **_pythonfmu_binaries(),
        **{f"resources/{name}": content for name, content in resources.items()},
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{MODEL_NAME}.fmu"
    _write_zip(path, files)
    return path


def summary(config: ScreenConfig) -> str:
    """One line on what a screen is: name, decks with the apertures on them, size classes."""
    size = " over ".join(
        f"{deck.width:.6g} x {deck.length:.6g} m at "
        + ", ".join(dict.fromkeys(f"{panel.aperture / MM:.6g} mm" for panel in deck.panels))
        for deck in config.decks
    )
    return f"Vibrating screen ({config.name}): {size}, {config.size_classes.count} size classes"


def _check_built_in(config: ScreenConfig) -> None:
    chosen = {
        "displacement.model": config.displacement.model,
        "passage.law": config.passage.law,
        "segregation.model": config.segregation.model,
    }
    for name, value in chosen.items():
        built_in = BUILT_IN[name.partition(".")[0]]
        if value not in built_in:
            raise ConfigError(
                f"{name} = {value!r} is a registered sub-model, an FMU carries built-in ones: "
                f"choose one of {', '.join(built_in)}"
            )


# --- sources -------------------------------------------------------------------------------------
def _closure(start: str) -> tuple[dict[str, Path], set[str]]:
    """Our modules that a module imports, transitively, with their files; packages of others."""
    modules: dict[str, Path] = {}
    foreign: set[str] = set()
    waiting = [start]
    while waiting:
        name = waiting.pop()
        path = None if name in modules else _source(name)
        if path is None:
            continue
        modules[name] = path
        for imported in _imports(path):
            top = imported.partition(".")[0]
            if top in (ENGINE, ADAPTER):
                steps = imported.split(".")
                waiting += [".".join(steps[: k + 1]) for k in range(len(steps))]
            elif top not in sys.stdlib_module_names:
                foreign.add(top)
    return modules, foreign


def _source(name: str) -> Path | None:
    """File of a module; None if the name is that of something inside a module."""
    try:
        spec = importlib.util.find_spec(name)
    except ModuleNotFoundError:
        return None
    return Path(spec.origin) if spec and spec.origin else None


def _imports(path: Path) -> Iterable[str]:
    """Full names that a module imports as it loads, names inside modules among them."""
    for node in ast.parse(path.read_bytes()).body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _part_of(module: str) -> str:
    return next(part for part in PARTS if f"{module}.".startswith(f"{part}."))


def _place(module: str, path: Path, part: str) -> str:
    """Path of a module's file below the package that its part becomes."""
    below = module.removeprefix(part).strip(".").split(".") if module != part else []
    if path.name == "__init__.py":
        return "/".join([*below, path.name])
    return "/".join(below) + ".py"


def _vendored(source: bytes, package: Mapping[str, str]) -> bytes:
    """A source file that imports our packages by their names in the FMU, as far as given."""

    def rename(found: re.Match[bytes]) -> bytes:
        name = found[2].decode()
        return found[1] + package.get(name, name).encode()

    return OUR_IMPORT.sub(rename, source)


def _release(distribution: str) -> str:
    """Major and minor number of an installed version."""
    return ".".join(importlib.metadata.version(distribution).split(".")[:2])


# --- pythonfmu -----------------------------------------------------------------------------------
def _pythonfmu_sources() -> Files:
    folder = importlib.resources.files("pythonfmu")
    return {
        f"pythonfmu/{file.name}": file.read_bytes()
        for file in folder.iterdir()
        if file.name.endswith(".py")
    }


def _pythonfmu_binaries() -> Files:
    folder = importlib.resources.files("pythonfmu") / "resources" / "binaries"
    return {
        f"binaries/{system.name}/{MODEL_NAME}{Path(file.name).suffix}": file.read_bytes()
        for system in folder.iterdir()
        for file in system.iterdir()
    }


def _pythonfmu_license() -> bytes:
    files = importlib.metadata.distribution("pythonfmu").files or ()
    return next(file.read_binary() for file in files if file.name == "LICENSE")


# --- files ---------------------------------------------------------------------------------------
def _hash(*parts: bytes) -> str:
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:12]


def _compiled_entry(stage: Path) -> Files:
    """What numba wrote beside the sources, as far as a slave needs it."""
    files = {
        path.relative_to(stage).as_posix(): _anonymous(path.read_bytes(), stage)
        for path in stage.rglob("*.nb[ci]")
        if path.name.startswith(ENTRY)
    }
    assert len(files) > 1, "the compiled entry and its index are not where they are expected"
    return files


def _anonymous(compiled: bytes, stage: Path) -> bytes:
    """A compiled kernel without what differs from process to process; its length stays."""
    place = str(stage).encode()
    compiled = compiled.replace(place, b"." * len(place))
    return ADDRESS.sub(lambda address: b"0" * len(address[0]), compiled)


def _write(folder: Path, files: Mapping[str, bytes]) -> None:
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def _read(folder: Path) -> Files:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def _write_zip(path: Path, files: Mapping[str, bytes]) -> None:
    """A zip whose bytes follow from its contents alone; it appears whole or not at all."""
    unfinished = path.with_suffix(".part")
    with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, TIMESTAMP)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, files[name])
    unfinished.replace(path)
