"""Intermediate code to machine code: optimised once, emitted for each processor, linked.

The library of a platform holds the kernels, and what C is over them. The linker is that of ziglang
(PyPI), which makes libraries for every platform on any; without it, the C compiler of this machine
makes that of this machine.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm

from vibroscreen.compiler import library
from vibroscreen.compiler.language import ENTRIES, Entry
from vibroscreen.errors import ConfigError

# Of the C library, what a sub-model of one's own may take; the kernels take only what is exact.
MATHEMATICS = {
    *("acos", "asin", "atan", "atan2", "cbrt", "ceil", "cos", "cosh", "exp", "exp2", "expm1"),
    *("fabs", "floor", "fmod", "hypot", "log", "log10", "log1p", "log2", "pow", "rint", "round"),
    *("sin", "sinh", "sqrt", "tan", "tanh", "trunc"),
}
NEEDED = {"sqrt", "memset", "memcpy", "memmove"}
COMMON = ("-O2", "-std=c99", "-shared", "-fvisibility=hidden", "-ffp-contract=off", "-s")
# Symbolic: a library calls itself, whatever others of its kind are loaded.
ELF: tuple[str, ...] = ("-fPIC", "-Wl,--no-undefined", "-Wl,--build-id=none", "-Wl,-z,noexecstack")
ELF += ("-Wl,-Bsymbolic", "-ldl")
# What the library may take from the C library.
ALLOWED = MATHEMATICS | {
    *("atoi", "bcmp", "calloc", "free", "getenv", "malloc", "memchr", "memcmp", "memcpy"),
    *(
        "memmove",
        "memset",
        "snprintf",
        "sprintf",
        "strchr",
        "strcmp",
        "strcpy",
        "strcspn",
        "strlen",
    ),
    *("strncmp", "strrchr", "strspn", "strtol"),
    # files, and the place of the library
    *("dladdr", "dlclose", "dlopen", "dlsym", "fclose", "fopen", "fread", "realpath"),
    # of the start code of every library, weak, and of checked builds
    *("__cxa_finalize", "__gmon_start__", "_ITM_deregisterTMCloneTable"),
    *("_ITM_registerTMCloneTable", "__stack_chk_fail", "__snprintf_chk", "__sprintf_chk"),
    *("__strcpy_chk", "__memcpy_chk", "__fread_chk"),
}
# LLVM's first level, with vectors for the loops that are not written out in fours: higher levels
# take longer to compile and gave nothing (an eighth slower without the vectors).
LEVEL = 1


@dataclass(frozen=True)
class Platform:
    """A platform by its folder in an FMU.

    triple: as LLVM names it; cpus: builds for one processor or another, the plainest first, by the
    suffix of their names; zig: as the linker names the platform; wheel: as pip does; flags: for
    the linker; other: what lies beside it in a library for two.
    """

    triple: str
    cpus: Mapping[str, str]
    zig: str
    wheel: str
    flags: tuple[str, ...] = ()
    other: Platform | None = None


# The second has AVX2; both give the same bits.
X86 = {"plain": "x86-64", "v3": "x86-64-v3"}
PLATFORMS = {
    "linux64": Platform(
        "x86_64-unknown-linux-gnu",
        X86,
        "x86_64-linux-gnu.2.17",
        "manylinux_2_17_x86_64",
        ELF,
    ),
    "win64": Platform("x86_64-w64-windows-gnu", X86, "x86_64-windows-gnu", "win_amd64"),
    "aarch64-linux": Platform(
        "aarch64-unknown-linux-gnu",
        {"plain": "generic"},
        "aarch64-linux-gnu.2.17",
        "manylinux_2_17_aarch64",
        ELF,
    ),
    "darwin64": Platform(
        "x86_64-apple-macosx11.0.0",
        {"plain": "x86-64"},
        "x86_64-macos.11.0",
        "macosx_11_0_universal2",
        other=Platform(
            "arm64-apple-macosx11.0.0",
            {"plain": "apple-m1"},
            "aarch64-macos.11.0",
            "macosx_11_0_universal2",
        ),
    ),
}
# Of WebAssembly: vectors of two doubles, and memory that is filled and copied at once, which all
# browsers have since 2023; the stack, bytes.
WEB_TRIPLE, WEB_FEATURES = "wasm32-unknown-unknown", "+simd128,+bulk-memory,+bulk-memory-opt"
WEB_STACK = 1 << 20


def host() -> str:
    """This machine's platform. Raises ConfigError where there is none."""
    found = library.host()
    if found is None:
        raise ConfigError(
            f"platform = {platform.system()} {platform.machine()} has no default: give --platform, "
            f"one or more of {', '.join(PLATFORMS)}"
        )
    return found


# --- machine code --------------------------------------------------------------------------------
def _machine(triple: str, cpu: str, features: str = "", **kind: Any) -> Any:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(triple)
    return target.create_target_machine(cpu=cpu, features=features, opt=3, **kind)


def _optimise(module: Any, machine: Any, triple: str, shown: Iterable[str]) -> None:
    """Make all but `shown` local, and optimise what is left once."""
    module.triple, module.data_layout = triple, str(machine.target_data)
    names = set(shown)
    for function in module.functions:
        if not function.is_declaration and function.name not in names:
            function.linkage = "internal"
    for variable in module.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    options = llvm.create_pipeline_tuning_options(speed_level=LEVEL)
    options.loop_vectorization = True
    builder = llvm.create_pass_builder(machine, options)
    first = llvm.create_new_module_pass_manager()
    first.add_global_dead_code_eliminate_pass()
    first.run(module, builder)
    passes = builder.getModulePassManager()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_strip_dead_prototype_pass()
    passes.run(module, builder)


def _symbols(entries: Iterable[Entry]) -> list[str]:
    return [f"vibroscreen_{entry.name}" for entry in entries]


def objects(code: bytes, target: Platform) -> list[bytes]:
    """Object files of the kernels for a platform, one for each of its builds.

    The functions of each end in the name of the build, such as vibroscreen_run_v3.
    """
    plainest = next(iter(target.cpus.values()))
    module = llvm.parse_bitcode(code)
    machine = _machine(target.triple, plainest, reloc="pic")
    _optimise(module, machine, target.triple, _symbols(ENTRIES.values()))
    _check_needs((f.name for f in module.functions if f.is_declaration), NEEDED)
    optimised = module.as_bitcode()

    def emit(build: str) -> bytes:
        own = llvm.parse_bitcode(optimised)
        for name in _symbols(ENTRIES.values()):
            function = own.get_function(name)
            function.name = f"{name}_{build}"
            function.visibility = "hidden"
        emitted: bytes = _machine(target.triple, target.cpus[build], reloc="pic").emit_object(own)
        return emitted

    with ThreadPoolExecutor() as pool:
        return list(pool.map(emit, target.cpus))


def object_of(module: Any, triple: str, cpu: str, shown: Sequence[str]) -> bytes:
    """Object file of a module for a target, with the functions `shown` to who loads a library.

    Raises ConfigError for a sub-model of one's own that calls what the C library has not.
    """
    machine = _machine(triple, cpu, reloc="pic")
    _optimise(module, machine, triple, shown)
    for name in shown:
        module.get_function(name).storage_class = "dllexport" if "windows" in triple else "default"
    _check_needs((f.name for f in module.functions if f.is_declaration), MATHEMATICS | NEEDED)
    emitted: bytes = machine.emit_object(module)
    return emitted


def _check_needs(declared: Iterable[str], known: set[str]) -> None:
    """Refuse code that calls what the C library has not."""
    foreign = {name for name in declared if not name.startswith("llvm.")} - known
    if foreign:
        raise ConfigError(
            f"a sub-model of one's own needs {', '.join(sorted(foreign))}, which a library without "
            "Python has not: it must not allocate, print or call Python"
        )


class InMemory:
    """Machine code for this processor, in this process."""

    def __init__(self, code: bytes) -> None:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        module = llvm.parse_bitcode(code)
        triple = llvm.get_process_triple()
        features = llvm.get_host_cpu_features().flatten()
        machine = _machine(triple, llvm.get_host_cpu_name(), features, jit=True)
        _optimise(module, machine, triple, _symbols(ENTRIES.values()))
        self._code = llvm.create_mcjit_compiler(module, machine)
        self._code.finalize_object()

    def address(self, name: str) -> int:
        """Where a function lies."""
        return int(self._code.get_function_address(name))


# --- libraries -----------------------------------------------------------------------------------
def find_linker() -> tuple[tuple[str, ...], bool] | None:
    """The command of the linker, and whether it makes libraries for other platforms, or None."""
    if importlib.util.find_spec("ziglang"):
        return (sys.executable, "-m", "ziglang", "cc"), True
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        if name and shutil.which(name):
            return (name,), False
    return None


_C = {"int64": "int64_t", "float64": "double", "void": "void"}
_C |= {"vector": "double *, int64_t", "matrix": "double *, int64_t, int64_t"}


def prototypes() -> str:
    """The entries as C sees them. Arrays are pointers with their extents."""
    return "#include <stdint.h>\n" + "".join(
        f"{_C[entry.returned]} vibroscreen_{entry.name}"
        f"({', '.join(_C[kind] for kind in entry.arguments)});\n"
        for entry in ENTRIES.values()
    )


def choosing(builds: Sequence[str]) -> str:
    """C source: every entry calls that of the build that this processor has.

    vibroscreen_build() says which that is.
    """
    lines = ["#include <stdint.h>", "#include <stdlib.h>", "#include <string.h>"]
    lines += ['#include "fmi2.h"', '#include "processor.h"']
    calls, choices = [], []
    for entry in ENTRIES.values():
        kinds = [kind for word in entry.arguments for kind in _C[word].split(", ")]
        taken = ", ".join(kinds)
        given = ", ".join(f"{kind} x{k}" for k, kind in enumerate(kinds))
        names = ", ".join(f"x{k}" for k in range(len(kinds)))
        kind, name = _C[entry.returned], entry.name
        lines += [f"{kind} vibroscreen_{name}_{build}({taken});" for build in builds]
        lines.append(f"static {kind} (*{name})({taken}) = vibroscreen_{name}_{builds[0]};")
        calls.append(
            f"SHOWN {kind} vibroscreen_{name}({given}) "
            f"{{ {'return ' if kind != 'void' else ''}{name}({names}); }}"
        )
        choices.append(f"    {name} = vibroscreen_{name}_{builds[-1]};")
    lines.append(f'static const char *build = "{builds[0]}";')
    calls.append("SHOWN const char *vibroscreen_build(void) { return build; }")
    lines += calls
    if len(builds) > 1:
        lines += [
            "__attribute__((constructor)) static void choose(void) {",
            '    const char *kept = getenv("VIBROSCREEN_PROCESSOR");',
            f'    if ((kept && !strcmp(kept, "{builds[0]}")) || !has_{builds[-1]}()) return;',
            *choices,
            f'    build = "{builds[-1]}";',
            "}",
        ]
    return "\n".join(lines) + "\n"


def link(chosen: Platform, name: str, files: Mapping[str, bytes], flags: Sequence[str]) -> bytes:
    """Library `name` of C sources (.c) and object files (.o) for one processor.

    files: by name, headers too; flags: more for the compiler. Raises ConfigError with what the
    linker says.
    """
    found = find_linker()
    if found is None:
        raise ConfigError(
            "a library needs a linker: pip install ziglang (pip install 'vibroscreen[fmu]')"
        )
    command, crossing = found
    target: tuple[str, ...] = ()
    if crossing:
        target = ("-target", chosen.zig, "-fno-sanitize=all")
        if "windows" not in chosen.triple:
            target += ("-rtlib=none",)  # nothing is taken from it, and it is compiled at first use
    elif chosen is not PLATFORMS[host()]:
        raise ConfigError(
            f"platform = {chosen.triple} cannot be linked by {command[0]}, only this machine's: "
            "pip install ziglang (pip install 'vibroscreen[fmu]')"
        )
    if "apple" in chosen.triple:
        target += (f"-Wl,-install_name,@rpath/{name}.dylib",)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for title, content in files.items():
            place.joinpath(title).write_bytes(content)
        parts = [title for title in files if title.endswith((".c", ".o"))]
        made = place / f"{name}.library"
        arguments = (*target, *COMMON, *chosen.flags, *flags)
        run = subprocess.run(
            (*command, *parts, *arguments, "-o", made.name, "-lm"),
            cwd=place,
            capture_output=True,
            text=True,
            check=False,
        )
        if run.returncode != 0 or run.stderr:
            raise ConfigError(f"the library for {chosen.triple} does not link:\n{run.stderr}")
        return made.read_bytes()


def engine_library(code: bytes, target: str, c_sources: Mapping[str, bytes]) -> bytes:
    """The engine library of a platform, from intermediate code and C sources by file name."""

    def made(part: Platform) -> bytes:
        builds = list(part.cpus)
        files = {**c_sources, "choosing.c": choosing(builds).encode()}
        for build, content in zip(builds, objects(code, part), strict=True):
            files[f"kernels_{build}.o"] = content
        return link(part, "vibroscreen", files, ())

    return for_all(target, made)


def web_library(code: bytes) -> bytes:
    """The kernels for browsers, from intermediate code: a WebAssembly module that needs nothing.

    It shows the entries, its memory, and from where on that is free (`__heap_base`). Raises
    ConfigError with what the linker says.
    """
    if not importlib.util.find_spec("ziglang"):
        raise ConfigError(
            "WebAssembly needs the linker of ziglang: pip install ziglang "
            "(pip install 'vibroscreen[explore]')"
        )
    module = llvm.parse_bitcode(code)
    machine = _machine(WEB_TRIPLE, "generic", WEB_FEATURES, reloc="static")
    shown = _symbols(ENTRIES.values())
    _optimise(module, machine, WEB_TRIPLE, shown)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        place.joinpath("kernels.o").write_bytes(machine.emit_object(module))
        linker = (sys.executable, "-m", "ziglang", "wasm-ld", "--no-entry", "--strip-all")
        exports = [f"--export={name}" for name in (*shown, "__heap_base")]
        run = subprocess.run(
            (*linker, *exports, "-z", f"stack-size={WEB_STACK}", "kernels.o", "-o", "kernels.wasm"),
            cwd=place,
            capture_output=True,
            text=True,
            check=False,
        )
        if run.returncode != 0:
            raise ConfigError(f"the engine for browsers does not link:\n{run.stderr}")
        return place.joinpath("kernels.wasm").read_bytes()


def for_all(target: str, make: Callable[[Platform], bytes]) -> bytes:
    """What `make` gives for the processors of a platform, in one library."""
    chosen = PLATFORMS[target]
    made = [make(part) for part in (chosen, chosen.other) if part]
    if target in ("linux64", "aarch64-linux"):
        _check_symbols(made[0])
    return made[0] if len(made) == 1 else universal(*made)


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
    """A library takes only what the C library has, and shows FMI 2.0 and what is ours."""
    shown, taken = symbols(elf)
    assert taken <= ALLOWED, f"the library would need {taken - ALLOWED}"
    foreign = {name for name in shown if not name.startswith(("fmi2", "vibroscreen_", "screen_"))}
    assert not foreign, f"the library shows {foreign}"


def universal(*parts: bytes) -> bytes:
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
