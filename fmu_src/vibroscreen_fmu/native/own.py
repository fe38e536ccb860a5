"""Sub-models of one's own as a library that needs no Python: `own_library`."""

from __future__ import annotations

import re
from collections.abc import Mapping

import llvmlite.binding as llvm

from vibroscreen import registry
from vibroscreen.compiler import machine
from vibroscreen.native.header import SUB_MODEL

__all__ = ["own_library"]

# Views own nothing and nothing is counted for them; nobody is there to ask why a kernel raised.
COUNTING = re.compile(r"^define [^\n]*@(NRT_(?:incref|decref))\([^\n]*\{.*?^\}", flags=re.M | re.S)
TARGET = re.compile(r"^target (?:triple|datalayout) = .*\n", flags=re.M)
# Python's functions that numba's wrapper of a user's function calls when that raises.
PYTHON = re.compile(
    r"^declare (?:[a-z]+ )*(void|ptr|i32) @((?:Py|numba_)\w+)\((.*)\).*$", flags=re.M
)


def own_library(own: Mapping[str, registry.SubModel], name: str, target: str) -> bytes:
    """The library `name` of the sub-models `own`, by family, for a platform.

    Raises ConfigError for one that needs Python, and where nothing links it.
    """
    texts = [
        TARGET.sub("", COUNTING.sub(_nothing, _code_of(family, model)))
        for family, model in own.items()
    ]
    shown = [SUB_MODEL.format(family) for family in own]

    def made(part: machine.Platform) -> bytes:
        module = llvm.parse_assembly("")
        for text in texts:
            module.link_in(llvm.parse_assembly(text))
        content = machine.object_of(module, part.triple, next(iter(part.cpus.values())), shown)
        return machine.link(part, name, {"own.o": content}, ())

    return machine.for_all(target, made)


def _code_of(family: str, model: registry.SubModel) -> str:
    """Intermediate code of a sub-model, under its name in C."""
    compiled = registry.compiled_at(model.address)
    text = compiled.inspect_llvm().replace(compiled.native_name, SUB_MODEL.format(family))
    return PYTHON.sub(_stub, text)


def _stub(declared: re.Match[str]) -> str:
    """A function of Python that does nothing: what a user's function raises is lost, as in JIT."""
    kind, name = declared[1], declared[2]
    given = ", ".join(part.split()[0] for part in declared[3].split(", ") if part)
    value = {"void": "void", "ptr": "ptr null", "i32": "i32 0"}[kind]
    return f"define internal {kind} @{name}({given}) {{\n  ret {value}\n}}"


def _nothing(found: re.Match[str]) -> str:
    return f"define internal void @{found[1]}(ptr %counted) alwaysinline {{\n  ret void\n}}"
