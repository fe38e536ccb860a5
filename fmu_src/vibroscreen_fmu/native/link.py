"""Libraries of the native runtime, and the FMU that holds them: `write_native_fmu`.

The linker is that of ziglang (PyPI), which makes libraries for every platform on any; without it,
the C compiler of this machine makes that of this machine.
"""

from __future__ import annotations

import importlib.resources
import importlib.util
import os
import platform
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError
from vibroscreen.kernels.machine import MATHEMATICS
from vibroscreen_fmu.model_description import guid_of, model_description
from vibroscreen_fmu.native.aot import object_code, own_models
from vibroscreen_fmu.native.tables import header
from vibroscreen_fmu.package import (
    Files,
    build_of,
    engine,
    model_files,
    screen_model,
    write_zip,
)

__all__ = ["PLATFORMS", "default_platforms", "library", "linker", "write_native_fmu"]

SOURCE = Path(__file__).with_name("fmi2.c")
NEEDS = (
    "Nothing: the engine is inside, as machine code for {platforms}. The library needs the C "
    "library of the system only (Linux: glibc 2.17 of 2012 or newer; Windows: 10 or newer; macOS: "
    "11 or newer). No Python, no files of this FMU beside the library. Instances may run in "
    "threads of their own. A refused step returns fmi2Error and the instance goes on."
)
LICENCE = "MIT. The headers of FMI 2.0 that the library was made with: 2-clause BSD."
TOOL = "vibroscreen, compiled ahead of time"

COMMON = ("-O2", "-std=c99", "-shared", "-fvisibility=hidden", "-ffp-contract=off", "-s")
ELF = ("-fPIC", "-Wl,--no-undefined", "-Wl,--build-id=none", "-Wl,-z,noexecstack")


@dataclass(frozen=True)
class Platform:
    """A platform by its folder in an FMU.

    triple, cpu: as LLVM names them; zig: as the linker does; suffix: of a library; flags: for the
    linker; other: what lies beside it in a library for two processors.
    """

    triple: str
    cpu: str
    zig: str
    suffix: str
    flags: tuple[str, ...] = ()
    other: Platform | None = None


PLATFORMS = {
    "linux64": Platform("x86_64-unknown-linux-gnu", "x86-64", "x86_64-linux-gnu.2.17", "so", ELF),
    "win64": Platform("x86_64-w64-windows-gnu", "x86-64", "x86_64-windows-gnu", "dll"),
    "aarch64-linux": Platform(
        "aarch64-unknown-linux-gnu", "generic", "aarch64-linux-gnu.2.17", "so", ELF
    ),
    "darwin64": Platform(
        "x86_64-apple-macosx11.0.0",
        "x86-64",
        "x86_64-macos.11.0",
        "dylib",
        other=Platform("arm64-apple-macosx11.0.0", "apple-m1", "aarch64-macos.11.0", "dylib"),
    ),
}
HOSTS = {("Linux", "x86_64"): "linux64", ("Linux", "aarch64"): "aarch64-linux"}

# What the library may take from the C library.
ALLOWED = MATHEMATICS | {
    *("calloc", "free", "malloc", "memcmp", "memcpy", "memmove", "memset", "snprintf", "strchr"),
    *("strcmp", "strcpy", "strcspn", "strlen", "strspn", "strtol", "atoi"),
    # of the start code of every library, weak
    *("__cxa_finalize", "__gmon_start__", "_ITM_deregisterTMCloneTable"),
    *("_ITM_registerTMCloneTable", "__stack_chk_fail", "__snprintf_chk", "__strcpy_chk"),
}


def linker() -> tuple[tuple[str, ...], bool]:
    """The command of the linker, and whether it makes libraries for other platforms.

    Raises ConfigError that says what to install if there is none.
    """
    if importlib.util.find_spec("ziglang"):
        return (sys.executable, "-m", "ziglang", "cc"), True
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        if name and shutil.which(name):
            return (name,), False
    raise ConfigError(
        "runtime = native needs a linker: pip install ziglang (pip install 'vibroscreen[native]')"
    )


def default_platforms() -> tuple[str, ...]:
    """This machine's platform."""
    host = HOSTS.get((platform.system(), platform.machine()))
    if host is None:
        raise ConfigError(
            f"platform = {platform.system()} {platform.machine()} has no default: give --platform, "
            f"one or more of {', '.join(PLATFORMS)}"
        )
    return (host,)


def library(
    config: ScreenConfig, target: str, text: str, flags: Sequence[str] = (), name: str = "screen"
) -> bytes:
    """The library of a screen for a platform. text: its screen.h; flags: more for the compiler.

    Raises ConfigError for a platform that the linker cannot do, and for a sub-model of one's own
    that needs Python.
    """
    command, crossing = linker()
    chosen = PLATFORMS[target]
    if not crossing and target not in default_platforms():
        raise ConfigError(
            f"platform = {target} cannot be linked by {command[0]}, only this machine's: "
            "pip install ziglang (pip install 'vibroscreen[native]')"
        )
    own = own_models(_models(config))
    result = _linked(chosen, text, own, name, flags)
    if chosen.other:
        result = _universal(result, _linked(chosen.other, text, own, name, flags))
    if chosen.suffix == "so" and not flags:
        _check_symbols(result)
    return result


def _linked(
    chosen: Platform, text: str, own: Mapping[str, str], name: str, flags: Sequence[str]
) -> bytes:
    """The library for one processor."""
    command, crossing = linker()
    target: tuple[str, ...] = ()
    if crossing:
        target = ("-target", chosen.zig, "-fno-sanitize=all")
    if chosen.suffix == "dylib":
        target += (f"-Wl,-install_name,@rpath/{name}.dylib",)
    headers = importlib.resources.files("fmpy") / "c-code"
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        place.joinpath("screen.h").write_text(text)
        place.joinpath("kernels.o").write_bytes(object_code(chosen.triple, chosen.cpu, own))
        shutil.copy(SOURCE, place)
        made = place / f"{name}.{chosen.suffix}"
        arguments = (*target, *COMMON, *chosen.flags, "-I", str(headers), *flags)
        run = subprocess.run(
            (*command, *arguments, SOURCE.name, "kernels.o", "-o", made.name, "-lm"),
            cwd=place,
            capture_output=True,
            text=True,
            check=False,
        )
        if run.returncode != 0 or run.stderr:
            raise ConfigError(f"the library for {chosen.triple} does not link:\n{run.stderr}")
        return made.read_bytes()


def _universal(*parts: bytes) -> bytes:
    """One library of macOS from those of its processors."""
    head = struct.pack(">II", 0xCAFEBABE, len(parts))
    place, rows, body = 1 << 14, b"", b""
    for part in parts:
        kind, variant = struct.unpack_from("<II", part, 4)
        rows += struct.pack(">IIIII", kind, variant, place, len(part), 14)
        room = -len(part) % (1 << 14)
        body += part + b"\0" * room
        place += len(part) + room
    return (head + rows).ljust(1 << 14, b"\0") + body


def write_native_fmu(
    config: ScreenConfig, folder: Path, platforms: Sequence[str] | None = None
) -> Path:
    """Write `VibratingScreen_native.fmu` of a screen into a folder, for this machine by default.

    Raises ConfigError for a configuration or a platform that it cannot be made for.
    """
    targets = tuple(dict.fromkeys(platforms or default_platforms()))
    for target in targets:
        if target not in PLATFORMS:
            raise ConfigError(
                f"platform = {target!r} is unknown: give one or more of {', '.join(PLATFORMS)}"
            )
    model = screen_model(config, built_in=False)
    guid = guid_of(model.name, model.ports, model.description)
    parts = engine(model.slave[0])
    read = ScreenConfig.loads(config.to_toml())
    text = header(read, model.ports, model.name, guid, build_of(model, parts))
    needs = NEEDS.format(platforms=", ".join(targets))
    description = model_description(model.name, model.ports, model.description, tool=TOOL)
    files: Files = {
        **model_files(model, description, (("What the host needs", (needs,)),), LICENCE),
        **{
            f"binaries/{target}/{model.name}.{PLATFORMS[target].suffix}": library(
                read, target, text, name=model.name
            )
            for target in targets
        },
    }
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{model.name}_native.fmu"
    write_zip(path, files)
    return path


def _models(config: ScreenConfig) -> Mapping[str, str]:
    return {
        "displacement": config.displacement.model,
        "passage": config.passage.law,
        "segregation": config.segregation.model,
    }


def symbols(elf: bytes) -> tuple[set[str], set[str]]:
    """What a library (ELF, 64 bits) shows to others, and what it takes from them."""
    (table,) = struct.unpack_from("<Q", elf, 40)
    size, count = struct.unpack_from("<HH", elf, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", elf, table + k * size) for k in range(count)]
    dynamic = next(section for section in sections if section[1] == 11)  # SHT_DYNSYM
    names = sections[dynamic[6]][4]
    shown: set[str] = set()
    taken: set[str] = set()
    for place in range(dynamic[4], dynamic[4] + dynamic[5], 24):
        name, _, _, section, _, _ = struct.unpack_from("<IBBHQQ", elf, place)
        text = elf[names + name : elf.index(b"\0", names + name)].decode()
        if text:
            (shown if section else taken).add(text)
    return shown, taken


def _check_symbols(elf: bytes) -> None:
    """A library takes only what the C library has, and shows only FMI 2.0."""
    shown, taken = symbols(elf)
    assert taken <= ALLOWED, f"the library would need {taken - ALLOWED}"
    hidden = {name for name in shown if not name.startswith("fmi2")}
    assert not hidden, f"the library shows {hidden}"
