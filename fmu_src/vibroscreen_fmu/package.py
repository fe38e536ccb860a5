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
import re
import sys
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen.kernels import library
from vibroscreen.number_sets import FOLDER
from vibroscreen.registry import BUILT_IN
from vibroscreen.screen import check_supported
from vibroscreen.units import MM
from vibroscreen_fmu.documentation import index_html
from vibroscreen_fmu.icons import model_png, terminal_files
from vibroscreen_fmu.model_description import model_description
from vibroscreen_fmu.port import Port
from vibroscreen_fmu.ports import ports
from vibroscreen_fmu.python_limits import PYTHON_LIMITS, Paragraph
from vibroscreen_fmu.python_slave import CONFIG_FILE
from vibroscreen_fmu.reference import reference_files

__all__ = [
    "Engine",
    "Model",
    "build_of",
    "engine",
    "model_files",
    "screen_model",
    "summary",
    "write_fmu",
    "write_model",
    "write_zip",
]

Files = dict[str, bytes]

MODEL_NAME = "VibratingScreen"
SLAVE = "vibroscreen_fmu.python_slave"
ABOUT = (
    (
        "",
        (
            "A vibrating screen: feed rate, feed composition and vibration go in at every "
            "communication step, undersize and oversize come out. Inside, slices of the bed ride "
            "along the decks; grains segregate in them and pass the openings (cell model of Ivanov "
            "and Vaisberg).",
            "Streams are means over the last communication step, size classes are numbered from "
            "the finest, decks from the top, panels from the feed end. With several decks, "
            "undersize is what falls through the lowest deck, oversize leaves over the top deck, "
            "and intermediate[k] over deck k + 1. Outputs change only when a step or the "
            "initialisation ends: no output depends on an input of the same instant, a loop over "
            "the screen is no algebraic loop. Any step size works, also one longer than a grain "
            "stays on the deck.",
            "bed.initial = 2 (steady) fills the decks when initialisation ends: the run begins in "
            "the steady state of the feed and the vibration given until then, instead of with "
            "empty decks.",
            "The tolerance that a host gives to fmi2SetupExperiment becomes solver.tolerance, "
            "which bounds the error of a recovery; one outside of its limits is told of with a "
            "warning.",
            "A state can be saved, kept in a file and set again, also in another process: the run "
            "continues bit for bit. It belongs to the build that wrote it.",
        ),
    ),
    (
        "Limits",
        (
            "solver.tolerance bounds the numerical error of a recovery, not that of the model. "
            "Transport by displacement.model = rigid_body is good to 5-8 % for linear motion and "
            "wrong by factors for circular motion (against particle simulations): use bed or "
            "prescribed there. Numbers that are not given are those of typical practice with dry "
            "stone, fitted to sizing rules, not to a plant. Screening is dry; the bed's velocity "
            "does not depend on its depth.",
        ),
    ),
    (
        "Sources",
        (
            "Ivanov, Vaisberg: Screen separation: computational model building experience (cells, "
            "passage, segregation). Gaudin; Pelevin (chance to pass). Blekhman: Vibrational "
            "mechanics (transport of a rigid body). All equations with their sources are in "
            "MODEL.md of vibroscreen.",
        ),
    ),
    (
        "Reference run",
        (
            "extra/org.fmi-standard.fmi-ls-ref holds inputs, outputs and options of a run: from "
            "empty decks, with more feed after 200 s and a slower vibration after 400 s.",
        ),
    ),
)
NO_ENGINE = (
    "the FMU needs the engine as a library, and nothing here can link one: pip install ziglang "
    "(pip install 'vibroscreen[fmu]'), or, for this machine only, install a C compiler"
)
LICENCE = "MIT. The licence of pythonfmu lies beside this page."
# What is vendored under a name of its own, from the ground up.
ENGINE, ADAPTER = "vibroscreen", "vibroscreen_fmu"
TIMESTAMP = (1980, 1, 1, 0, 0, 0)  # the first that a zip can say
PLATFORMS = ("linux64", "win64")  # of pythonfmu's library

SCRIPT = '''"""The slave module: pythonfmu runs it by name, so the name is unique to this build."""

{imports}
from {adapter}.row_slave import slave_class, take_reference

# pythonfmu's library runs this text for every instance, and gives back a reference to the names in
# it that it never took.
take_reference(globals())
{model} = slave_class({kind}, "{model}", "{build}")
del {kind}  # the library looks through every class that has a name here
'''
IMPORTS = "from {module} import {kind}"


@dataclass(frozen=True)
class Engine:
    """What a slave imports, under its names in the FMU.

    package: name in the FMU of every part, which ends in a hash of its sources; module: that of
    the slave; sources: by path below the resources; requirements: what the sources import from
    others, as pip reads it.
    """

    package: Mapping[str, str]
    module: str
    sources: Files
    requirements: tuple[str, ...]

    @property
    def has_kernels(self) -> bool:
        """Whether anything is compiled: if not, the host needs no compiler."""
        return any(name.startswith(f"{self._home}/") for name in self.sources)

    @property
    def _home(self) -> str:
        """Where the kernels lie, and the engine beside them."""
        return f"{self.package[ENGINE]}/kernels"

    @property
    def platforms(self) -> tuple[str, ...]:
        """Platforms that a slave runs on: those of pythonfmu's library, with an engine at hand.

        Raises ConfigError where there is none.
        """
        return tuple(self._at_hand()) if self.has_kernels else PLATFORMS

    def _at_hand(self) -> dict[str, Path]:
        found = {name: path for name, path in library.at_hand().items() if name in PLATFORMS}
        if not found:
            raise ConfigError(NO_ENGINE)
        return found

    def libraries(self) -> Files:
        """The engine for these platforms, and what it was compiled from."""
        if not self.has_kernels:
            return {}
        home = self._home
        folders = (f"{home}/", f"{self.package[ENGINE]}/compiler/")
        texts = {
            name.rpartition("/")[2]: text
            for name, text in self.sources.items()
            if name.startswith(folders)
        }
        found = {f"{home}/{library.STAMP}": library.note(texts)}
        for path in self._at_hand().values():
            found[f"{home}/{path.name}"] = path.read_bytes()
        return found


@dataclass(frozen=True)
class Model:
    """What an FMU models, and the slave that does it.

    name: of the model and its library; slave: the module and the class of it; description: one
    line; about: chapters of the documentation, title and paragraphs; resources: what the slave
    reads; extra: other files of the FMU, by path; picture: what tools show, PNG.
    """

    name: str
    slave: tuple[str, str]
    description: str
    about: tuple[tuple[str, tuple[str, ...]], ...]
    ports: tuple[Port, ...]
    resources: Files
    picture: bytes
    extra: Files = field(default_factory=dict)


def engine(slave: str = SLAVE) -> Engine:
    """What the module of a slave imports, transitively."""
    own = slave.partition(".")[0]
    parts = tuple(dict.fromkeys((ENGINE, ADAPTER, own)))
    modules, foreign = _closure(slave, parts)
    package: dict[str, str] = {}
    sources: Files = {}
    for part in parts:
        # Later parts import earlier ones: their names are part of the text that is hashed.
        texts = {
            _place(name, part): _vendored(path.read_bytes(), package)
            for name, path in modules.items()
            if _part_of(name, parts) == part
        }
        if not texts:
            continue
        if part == ENGINE and "vibroscreen.number_sets" in modules:
            texts |= {f"{FOLDER.name}/{path.name}": path.read_bytes() for path in FOLDER.iterdir()}
        # What a package gives to its users by name is for people.
        folders = {str(parent) for place in texts for parent in PurePosixPath(place).parents}
        texts |= {f"{folder}/__init__.py".removeprefix("./"): b"" for folder in folders}
        tag = _hash(*(piece for place in sorted(texts) for piece in (place.encode(), texts[place])))
        package[part] = f"{part}_{tag}"
        within = {part: package[part]}
        for place, source in texts.items():
            sources[f"{package[part]}/{place}"] = _vendored(source, within)
    # pythonfmu travels with the FMU. Of the others, what the FMU was built and tried with.
    needed = (f"{name}>={_release(name)}" for name in sorted(foreign - {"pythonfmu"}))
    module = package[_part_of(slave, parts)] + slave.removeprefix(_part_of(slave, parts))
    return Engine(package, module, sources, tuple(needed))


def screen_model(config: ScreenConfig, *, built_in: bool = True) -> Model:
    """A screen as a model; with built-in sub-models only, unless told otherwise.

    Raises ConfigError for a configuration that an FMU cannot carry.
    """
    check_supported(config)
    if built_in:
        _check_built_in(config)
    text = config.to_toml()
    # What the slave will read, to the last digit.
    read = ScreenConfig.loads(text)
    table = ports(read)
    picture = model_png()
    return Model(
        name=MODEL_NAME,
        slave=(SLAVE, "ScreenSlave"),
        description=summary(config),
        about=ABOUT,
        ports=table,
        resources={CONFIG_FILE: text.encode()},
        picture=picture,
        extra=reference_files(MODEL_NAME, read, table),
    )


def write_fmu(config: ScreenConfig, folder: Path) -> Path:
    """Write `VibratingScreen_python.fmu` of a screen into a folder: it runs in Python.

    Raises ConfigError for a configuration that an FMU cannot carry.
    """
    return write_model(screen_model(config), folder, f"{MODEL_NAME}_python")


def write_model(model: Model, folder: Path, title: str = "") -> Path:
    """Write the FMU of a model, `<title>.fmu`, into a folder; by default its name is its title."""
    module, kind = model.slave
    parts = engine(module)
    build = build_of(model, parts)
    script = f"{model.name}_{build}"
    resources = {
        f"{script}.py": SCRIPT.format(
            imports=IMPORTS.format(module=parts.module, kind=kind),
            adapter=parts.package[ADAPTER],
            kind=kind,
            model=model.name,
            build=build,
        ).encode(),
        "slavemodule.txt": script.encode(),
        "requirements.txt": "".join(f"{name}\n" for name in parts.requirements).encode(),
        **model.resources,
        **_pythonfmu_sources(),
        **parts.sources,
        **parts.libraries(),
    }
    description = model_description(model.name, model.ports, model.description)
    needs = (
        ("What the host needs", (_needs(parts),)),
        ("Limits of the python runtime", PYTHON_LIMITS),
    )
    files = {
        **model_files(model, description, needs, LICENCE),
        "documentation/licenses/pythonfmu.txt": _pythonfmu_license(),
        **_pythonfmu_binaries(model.name, parts.platforms),
        **{f"resources/{name}": content for name, content in resources.items()},
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{title or model.name}.fmu"
    write_zip(path, files)
    return path


def build_of(model: Model, parts: Engine) -> str:
    """Name of what a model is built from, sources and resources: its states belong to that."""
    return _hash(parts.module.encode(), *(model.resources[key] for key in sorted(model.resources)))


def model_files(
    model: Model,
    description: bytes,
    needs: tuple[tuple[str, tuple[Paragraph, ...]], ...],
    licence: str,
) -> Files:
    """Files of an FMU that are the same for both runtimes but for a few words.

    description: modelDescription.xml; needs: chapters of the documentation on the runtime.
    """
    page = index_html(model.name, model.description, (*model.about, *needs), model.ports, licence)
    return {
        "modelDescription.xml": description,
        "model.png": model.picture,
        **terminal_files(model.ports, model.picture),
        "documentation/index.html": page,
        **model.extra,
    }


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
                f"{name} = {value!r} is a registered sub-model, runtime = native carries it: build "
                f"that, or choose one of {', '.join(built_in)}"
            )


def _needs(parts: Engine) -> str:
    """What the host of an FMU needs, for its documentation."""
    packages = ", ".join(parts.requirements)
    text = (
        f"Python 3.11 or newer with {packages} (resources/requirements.txt); "
        f"{' or '.join(parts.platforms)}. A "
        "host that is not Python itself must find libpython: the commands are below."
    )
    if parts.has_kernels:
        text += " The engine is inside, as machine code: nothing is compiled on the host."
    return text


# --- sources -------------------------------------------------------------------------------------
def _closure(start: str, parts: tuple[str, ...]) -> tuple[dict[str, Path], set[str]]:
    """Our modules that a module imports, transitively, with their files; packages of others."""
    modules: dict[str, Path] = {}
    foreign: set[str] = set()
    waiting = [start]
    while waiting:
        name = waiting.pop()
        path = None if name in modules else _source(name)
        if path is None:
            continue
        if path.name == "__init__.py":
            continue
        modules[name] = path
        for imported in _imports(path):
            top = imported.partition(".")[0]
            if top in parts:
                steps = imported.split(".")
                waiting += [".".join(steps[: k + 1]) for k in range(1, len(steps))]
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


def _part_of(module: str, parts: tuple[str, ...]) -> str:
    return next(part for part in parts if f"{module}.".startswith(f"{part}."))


def _place(module: str, part: str) -> str:
    """Path of a module's file below the package that its part becomes."""
    return f"{module.removeprefix(f'{part}.').replace('.', '/')}.py"


def _vendored(source: bytes, package: Mapping[str, str]) -> bytes:
    """A source file that imports our packages by their names in the FMU, as far as given."""
    if not package:
        return source
    names = "|".join(map(re.escape, package))
    statement = rf"^(\s*(?:from|import)\s+)({names})(?=[.\s])"

    def rename(found: re.Match[bytes]) -> bytes:
        return found[1] + package[found[2].decode()].encode()

    return re.sub(statement.encode(), rename, source, flags=re.MULTILINE)


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


def _pythonfmu_binaries(model: str, platforms: Iterable[str]) -> Files:
    folder = importlib.resources.files("pythonfmu") / "resources" / "binaries"
    return {
        f"binaries/{name}/{model}{Path(file.name).suffix}": file.read_bytes()
        for name in platforms
        for file in (folder / name).iterdir()
    }


def _pythonfmu_license() -> bytes:
    files = importlib.metadata.distribution("pythonfmu").files or ()
    return next(file.read_binary() for file in files if file.name == "LICENSE")


# --- files ---------------------------------------------------------------------------------------
def _hash(*parts: bytes) -> str:
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:12]


def write_zip(path: Path, files: Mapping[str, bytes]) -> None:
    """A zip whose bytes follow from its contents alone; it appears whole or not at all."""
    unfinished = path.with_suffix(".part")
    with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, TIMESTAMP)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            archive.writestr(entry, files[name])
    unfinished.replace(path)
