"""Kernels to object code that needs no Python, with a user's own sub-models: `object_code`."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import llvmlite.binding as llvm

from vibroscreen.kernels import library, machine, registry

__all__ = ["SUB_MODEL", "object_code", "own_models"]

ENTRIES = ("vibroscreen_run", "vibroscreen_plan")
# Name in C of a user's own sub-model of a family.
SUB_MODEL = "screen_own_{}"
# Views own nothing and nothing is counted for them; nobody is there to ask why a kernel raised.
COUNTING = re.compile(r"^define [^\n]*@(NRT_(?:incref|decref))\([^\n]*\{.*?^\}", flags=re.M | re.S)
TARGET = re.compile(r"^target (?:triple|datalayout) = .*\n", flags=re.M)
# Python's functions that numba's wrapper of a user's function calls when that raises.
PYTHON = re.compile(
    r"^declare (?:[a-z]+ )*(void|ptr|i32) @((?:Py|numba_)\w+)\((.*)\).*$", flags=re.M
)


def object_code(triple: str, cpu: str, own: Mapping[str, str]) -> bytes:
    """Object file of the kernels for a target, with a user's own sub-models (`own_models`).

    triple and cpu as LLVM names them. The user's cache folder keeps it.
    """
    source = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    key = repr((library.stamp(), source, llvm.llvm_version_info, triple, cpu, sorted(own.items())))
    return _kept("kernels.o", key, lambda: _compile(library.kept_code(), triple, cpu, own))


def own_models(chosen: Mapping[str, str]) -> dict[str, str]:
    """Intermediate code of the chosen sub-models that are a user's own, by family.

    chosen: name of the model by family.
    """
    found = {}
    for family, name in chosen.items():
        address = registry.model(family, name).address
        if address:
            compiled = registry.compiled_at(address)
            text = compiled.inspect_llvm().replace(compiled.native_name, SUB_MODEL.format(family))
            found[family] = PYTHON.sub(_stub, text)
    return found


def _kept(title: str, key: str, make: Callable[[], bytes]) -> bytes:
    """What `make` gives, kept in the user's cache folder under that key."""
    name = f"{hashlib.sha256(key.encode()).hexdigest()[:16]}-{title}"
    path = library.cache_folder() / name
    if not path.exists():
        library.keep(path, make())
    return path.read_bytes()


def _stub(declared: re.Match[str]) -> str:
    """A function of Python that does nothing: what a user's function raises is lost, as in JIT."""
    kind, name = declared[1], declared[2]
    given = ", ".join(part.split()[0] for part in declared[3].split(", ") if part)
    value = {"void": "void", "ptr": "ptr null", "i32": "i32 0"}[kind]
    return f"define internal {kind} @{name}({given}) {{\n  ret {value}\n}}"


def _compile(code: bytes, triple: str, cpu: str, own: Mapping[str, str]) -> bytes:
    """Link, optimise and emit."""
    module = llvm.parse_bitcode(code)
    for text in own.values():
        module.link_in(llvm.parse_assembly(TARGET.sub("", COUNTING.sub(_nothing, text))))
    shown = (*ENTRIES, *(SUB_MODEL.format(family) for family in own))
    return machine.object_of(module, triple, cpu, shown)


def _nothing(found: re.Match[str]) -> str:
    return f"define internal void @{found[1]}(ptr %counted) alwaysinline {{\n  ret void\n}}"
