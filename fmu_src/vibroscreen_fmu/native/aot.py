"""Kernels to object code that needs no Python: `object_code(target)`.

numba makes LLVM's intermediate code from the kernels, unoptimised and for no processor in
particular, in a process of its own (this module run as a script). Here it is made one module that
shows two functions only, and optimised for a target as a whole. What LLVM may do without fast-math
changes no bit of a result: every target computes what the kernels compute in Python.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
from numba import carray, njit, types

from vibroscreen.errors import ConfigError
from vibroscreen.kernels import jit, registry
from vibroscreen.kernels.entry import ADVANCE, INITIALISE
from vibroscreen.kernels.layout import ACCEPTED
from vibroscreen.kernels.plan import plan
from vibroscreen.kernels.step import advance, initialise, read_partition

__all__ = ["C_PROTOTYPES", "MATHEMATICS", "SUB_MODEL", "object_code", "own_models"]

# As C sees them. They give a status of numba, 0 unless a kernel raised what it must not.
C_PROTOTYPES = """\
int32_t screen_run(int64_t *code, void **raised, double *buffer, int64_t size, int64_t command,
                   double first);
int32_t screen_plan(int64_t *code, void **raised, double *buffer, int64_t size,
                    const double *aperture, const double *velocity, int64_t rows);
"""
# Of the C library. The kernels take only what is exact there; a user's own sub-model may take all.
MATHEMATICS = {
    *("acos", "asin", "atan", "atan2", "cbrt", "ceil", "cos", "cosh", "exp", "exp2", "expm1"),
    *("fabs", "floor", "fmod", "hypot", "log", "log10", "log1p", "log2", "pow", "rint", "round"),
    *("sin", "sinh", "sqrt", "tan", "tanh", "trunc"),
}
# Name in C of a user's own sub-model of a family.
SUB_MODEL = "screen_own_{}"

# No trace of this machine in the code, and nothing inlined yet.
ENVIRONMENT = {
    "NUMBA_CPU_NAME": "generic",
    "NUMBA_CPU_FEATURES": "",
    "NUMBA_OPT": "0",
    "NUMBA_LOOP_VECTORIZE": "0",
    "NUMBA_SLP_VECTORIZE": "0",
    "PYTHONHASHSEED": "0",
}
# Views own nothing and nothing is counted for them; nobody is there to ask why a kernel raised.
COUNTING = re.compile(r"^define [^\n]*@(NRT_(?:incref|decref))\([^\n]*\{.*?^\}", flags=re.M | re.S)
RAISED = re.compile(r"^(?!@)(.*?)ptr @\.const\.picklebuf\.[\w.]+", flags=re.M)
TARGET = re.compile(r"^target (?:triple|datalayout) = .*\n", flags=re.M)
# Python's functions that numba's wrapper of a user's function calls when that raises.
PYTHON = re.compile(
    r"^declare (?:[a-z]+ )*(void|ptr|i32) @((?:Py|numba_)\w+)\((.*)\).*$", flags=re.M
)


def object_code(triple: str, cpu: str, own: Mapping[str, str]) -> bytes:
    """Object file of the kernels for a target, with a user's own sub-models (`own_models`).

    triple and cpu as LLVM names them. Takes about a minute when the kernels are new, some seconds
    for every target; the user's cache folder keeps both.
    """
    versions = (platform.python_version(), numba.__version__, llvm.llvm_version_info)
    source = Path(__file__).read_bytes()
    key = repr((jit.SOURCE_STAMP, versions, hashlib.sha256(source).hexdigest()))
    code = _kept("kernels.bc", key, _export)
    key = repr((key, triple, cpu, sorted(own.items())))
    return _kept("kernels.o", key, lambda: _compile(code, triple, cpu, own))


def own_models(chosen: Mapping[str, str]) -> dict[str, str]:
    """Intermediate code of the chosen sub-models that are a user's own, by family.

    chosen: name of the model by family.
    """
    found = {}
    for family, name in chosen.items():
        address = registry.model(family, name).address
        if address:
            compiled = jit.compiled_at(address)
            text = compiled.inspect_llvm().replace(compiled.native_name, SUB_MODEL.format(family))
            found[family] = PYTHON.sub(_stub, text)
    return found


def _kept(title: str, key: str, make: Callable[[], bytes]) -> bytes:
    """What `make` gives, kept in the user's cache folder under that key."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    path = caches / "vibroscreen" / f"{hashlib.sha256(key.encode()).hexdigest()[:16]}-{title}"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as unfinished:
            unfinished.write(make())
        Path(unfinished.name).replace(path)
    return path.read_bytes()


def _stub(declared: re.Match[str]) -> str:
    """A function of Python that does nothing: what a user's function raises is lost, as in JIT."""
    kind, name = declared[1], declared[2]
    given = ", ".join(part.split()[0] for part in declared[3].split(", ") if part)
    value = {"void": "void", "ptr": "ptr null", "i32": "i32 0"}[kind]
    return f"define internal {kind} @{name}({given}) {{\n  ret {value}\n}}"


def _export() -> bytes:
    """Intermediate code of all kernels, unoptimised, by a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder, "kernels.bc")
        plain = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
        path = os.pathsep.join(place for place in sys.path if place)
        own = {"NUMBA_CACHE_DIR": folder, "PYTHONPATH": path, **ENVIRONMENT}
        command = [sys.executable, "-W", "ignore", "-m", __name__, str(target)]
        subprocess.run(command, check=True, env={**plain, **own})
        return target.read_bytes()


def _compile(code: bytes, triple: str, cpu: str, own: Mapping[str, str]) -> bytes:
    """Link, internalise, optimise and emit."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    module = llvm.parse_bitcode(code)
    for text in own.values():
        module.link_in(llvm.parse_assembly(TARGET.sub("", COUNTING.sub(_nothing, text))))
    shown = {"screen_run", "screen_plan", *(SUB_MODEL.format(family) for family in own)}
    target = llvm.Target.from_triple(triple)
    machine = target.create_target_machine(cpu=cpu, features="", opt=3, reloc="pic")
    module.triple = triple
    module.data_layout = str(machine.target_data)
    for function in module.functions:
        if function.name in shown:
            function.visibility = "hidden"
        elif not function.is_declaration:
            function.linkage = "internal"
    for variable in module.global_variables:
        if not variable.is_declaration:
            variable.linkage = "internal"
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = True
    builder = llvm.create_pass_builder(machine, options)
    first = llvm.create_new_module_pass_manager()
    first.add_global_dead_code_eliminate_pass()
    first.run(module, builder)
    passes = builder.getModulePassManager()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_strip_dead_prototype_pass()
    passes.run(module, builder)
    _check_needs(f.name for f in module.functions if f.is_declaration)
    emitted: bytes = machine.emit_object(module)
    return emitted


def _check_needs(declared: Iterable[str]) -> None:
    """Refuse code that calls what the C library has not."""
    foreign = {name for name in declared if not name.startswith("llvm.")} - MATHEMATICS
    if foreign:
        raise ConfigError(
            f"a sub-model of one's own needs {', '.join(sorted(foreign))}, which a library without "
            "Python has not: it must not allocate, print or call Python"
        )


def _nothing(found: re.Match[str]) -> str:
    return f"define internal void @{found[1]}(ptr %counted) alwaysinline {{\n  ret void\n}}"


def _main(target: Path) -> None:
    """Write the intermediate code of the entries and all below them."""
    pointer = types.CPointer(types.float64)

    def run(buffer: Any, size: int, command: int, first: float) -> Any:
        row = carray(buffer, (size,))
        if command == INITIALISE:
            return initialise(row)
        if command == ADVANCE:
            return advance(row, first)
        read_partition(row)
        return ACCEPTED

    def lay(buffer: Any, size: int, aperture: Any, velocity: Any, rows: int) -> int:
        plan(carray(buffer, (size,)), carray(aperture, (rows,)), carray(velocity, (rows,)))
        return ACCEPTED

    entries = {
        "screen_run": (
            run,
            types.int64(pointer, types.int64, types.int64, types.float64),
        ),
        "screen_plan": (lay, types.int64(pointer, types.int64, pointer, pointer, types.int64)),
    }
    module = llvm.parse_assembly("")
    for name, (function, signature) in entries.items():
        compiled = njit(signature, error_model="numpy", no_cfunc_wrapper=True)(function)
        (result,) = compiled.overloads.values()
        text = result.library.get_llvm_str()
        text = RAISED.sub(r"\1ptr null", COUNTING.sub(_nothing, TARGET.sub("", text)))
        part = llvm.parse_assembly(text)
        part.get_function(result.fndesc.llvm_func_name).name = name
        module.link_in(part)
    module.verify()
    target.write_bytes(module.as_bitcode())


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
