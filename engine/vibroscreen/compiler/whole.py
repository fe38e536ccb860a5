"""Kernels to LLVM's intermediate code: numba types and lowers each kernel by itself, once.

An entry and all kernels below it are linked flat, without being optimised: that is done once for
all of them (machine.py). What numba made of a kernel is kept by what it says.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from hashlib import sha256
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import cfunc, njit, types
from numba.core import errors
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.imputils import lower_constant
from numba.core.registry import cpu_target
from numba.core.typed_passes import NativeLowering, NopythonTypeInference
from numba.core.types.functions import BaseFunction
from numba.extending import models, register_model

from vibroscreen.compiler import kept, lowering
from vibroscreen.compiler.kept import Store
from vibroscreen.compiler.language import ENTRIES, KERNELS, OWN_MODELS, Entry
from vibroscreen.compiler.lowering import TYPES, type_of

CONSTANT = re.compile(r'@"\.(?:const|bytes)\.[^"]*"')
METADATA = re.compile(r"![0-9]+")
DEFINED = re.compile(r'^define [^@]*(@"?[^"(]+"?)\(', flags=re.M)
# Name in C of an entry.
SYMBOL = "vibroscreen_{}"


class _NoEnvironment:
    """The code generator as a kernel sees it: nothing has an address yet."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, env_name: str, env: Any) -> None:
        """There is no address at which an environment could be set."""


class _Part(JITCodeLibrary):
    """Intermediate code of one kernel, unoptimised, nothing linked in."""

    @property
    def codegen(self) -> Any:
        return _NoEnvironment(self._codegen)

    text = ""
    foreign: Sequence[bytes] = ()  # what numba itself compiled for operators, as bitcode

    def add_ir_module(self, ir_module: Any) -> None:
        self.text = str(ir_module)

    def finalize(self) -> None:
        self._raise_if_finalized()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0

    def _get_module_for_linking(self) -> Any:
        """This kernel and all below it, for a function of numba's own that calls it."""
        libraries: dict[Any, None] = {}
        _collect(self, libraries)
        module = _linked(libraries)
        for function in module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        return module


@register_pass(mutates_CFG=True, analysis_only=False)
class _TypeWithViews(NopythonTypeInference):
    """Types as numba's own; a kernel may return a view, which owns nothing."""

    _name = "type_with_views"

    def run_pass(self, state: Any) -> bool:
        context = state.targetctx
        counted, context.enable_nrt = context.enable_nrt, True
        try:
            return bool(super().run_pass(state))
        finally:
            context.enable_nrt = counted


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerPart(NativeLowering):
    _name = "lower_part"

    def run_pass(self, state: Any) -> bool:
        # The name of a kernel must not depend on what was compiled before it.
        state.func_id.unique_id = 0
        state.library = _Part(state.targetctx.codegen(), state.func_id.func_qualname)
        return bool(super().run_pass(state))


# Steps of numba for what kernels have not: closures, array expressions, contexts, object code.
IDLE = {
    *("with_lifting", "inline_closure_likes", "inline_inlinables", "inline_overloads"),
    *("make_function_op_code_to_jit_function", "literal_unroll", "dump_parfor_diagnostics"),
    *("nopython_rewrites", "rewrite_semantic_constants", "find_literally"),
}


class _PartCompiler(CompilerBase):
    def define_pipelines(self) -> list[Any]:
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        own = {NativeLowering: _LowerPart, NopythonTypeInference: _TypeWithViews}
        manager.passes = [
            (own.get(step, step), text) for step, text in manager.passes if step.name() not in IDLE
        ]
        manager._finalized = False
        manager.finalize()
        return [manager]


_recipe = functools.cache(kept.recipe)


def _dispatcher(function: Callable[..., Any]) -> Any:
    # error_model="numpy": a division by zero gives inf, not an exception path in every loop.
    # Kernels allocate nothing, and what they view is owned by who called them: nothing is counted.
    # No fastmath: it deletes NaN guards and reorders sums.
    return njit(
        error_model="numpy",
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
        _nrt=False,
        pipeline_class=_PartCompiler,
    )(function)


class _KernelType(types.Dispatcher):
    """Type of a kernel, whose name needs no value."""


register_model(_KernelType)(models.OpaqueModel)


@lower_constant(_KernelType)
def _no_value(context: Any, _builder: Any, _kind: Any, _value: Any) -> Any:
    return context.get_dummy_value()


class _Progress:
    """Says how many kernels are done: on a terminal in one line, elsewhere a line a quarter."""

    def __init__(self) -> None:
        self._done, self._shown = 0, 0.0

    def __call__(self) -> None:
        """One more is done."""
        self._done += 1
        whole = max(len(_by_name), self._done)
        if sys.stderr.isatty():
            print(f"\r  kernel {self._done} of {whole}", end="", file=sys.stderr, flush=True)
        elif self._done / whole >= self._shown + 0.25:
            self._shown += 0.25
            print(f"  kernel {self._done} of {whole}", file=sys.stderr, flush=True)

    def end(self) -> None:
        """All are done."""
        if sys.stderr.isatty():
            print("\r\033[K", end="", file=sys.stderr, flush=True)


_progress = _Progress()
_dispatchers: dict[Any, Any] = {}
_by_name: dict[str, Any] = {}
# Name of a kernel, types that it takes, type that it gives: by its library.
_owners: dict[Any, tuple[str, Any, Any]] = {}


def _compile_kernel(name: str, kinds: Any) -> tuple[Any, Any]:
    """Library of a kernel, and the type that it gives."""
    dispatcher = _by_name[name]
    dispatcher.compile(kinds)
    found = dispatcher.overloads[kinds]
    return found.library, found.signature.return_type


def _new_part(name: str) -> _Part:
    return _Part(cpu_target.target_context.codegen(), name)


def prepare() -> None:
    """Let numba know all kernels that are marked; again for those marked since."""
    context = cpu_target.typing_context
    if not _dispatchers:
        lowering.use_them()
    functions = {function: function for function in KERNELS}
    functions |= {entry: entry.function for entry in ENTRIES.values()}
    for known, function in functions.items():
        if known not in _dispatchers:
            made = _dispatchers[known] = _dispatcher(function)
            # One specialisation a kernel: numba would make one for every constant argument.
            resolve = made.get_call_template

            def plain(arguments: Any, keywords: Any, resolve: Any = resolve) -> Any:
                return resolve(tuple(types.unliteral(kind) for kind in arguments), keywords)

            made.get_call_template = plain
            made._cache = Store(function, _recipe(), _compile_kernel, _new_part, _owners, _progress)
            _by_name[f"{function.__module__}.{function.__qualname__}"] = made
            context.insert_global(known, _KernelType(made))


def intermediate_code(entries: Iterable[Entry]) -> Any:
    """Module with the entries, under their names in C, and all kernels below them."""
    prepare()
    whole = llvm.parse_assembly("")
    libraries: dict[Any, None] = {}
    with _swift():
        for entry in entries:
            kinds = tuple(TYPES[kind] for kind in entry.arguments)
            dispatcher = _dispatchers[entry]
            dispatcher.compile(kinds)
            (found,) = (r for r in dispatcher.overloads.values() if r.signature.args == kinds)
            assert found.signature.return_type == TYPES[entry.returned], found.signature
            _collect(found.library, libraries)
            whole.link_in(llvm.parse_assembly(str(_in_c(entry, found.fndesc.llvm_func_name))))
    whole.link_in(_linked(libraries))
    _progress.end()
    kept.throw_away()
    return whole


# What typing of a call depends on where nothing but these is handed over.
_PLAIN = (
    *(types.Number, types.Boolean, types.Array, types.UniTuple, types.IntegerLiteral),
    *(lowering.RowType, lowering.KindType),
)


@contextlib.contextmanager
def _swift() -> Iterator[None]:
    """While kernels are compiled: no garbage is looked for, a call of the same types is looked up
    once, and errors that nobody will see are not coloured.
    """
    known: dict[Any, Any] = {}
    look_up = BaseFunction.get_call_type

    def look_up_once(self: Any, context: Any, arguments: Any, named: Any) -> Any:
        if named or not all(isinstance(kind, _PLAIN) for kind in arguments):
            return look_up(self, context, arguments, named)
        key = (self, arguments)
        if key not in known:
            known[key] = look_up(self, context, arguments, named)
        return known[key]

    enabled, painter = gc.isenabled(), errors._termcolor_inst
    gc.disable()
    BaseFunction.get_call_type = look_up_once
    if hasattr(errors, "NOPColorScheme"):
        errors._termcolor_inst = errors.NOPColorScheme()
    try:
        yield
    finally:
        BaseFunction.get_call_type, errors._termcolor_inst = look_up, painter
        if enabled:
            gc.enable()


def _linked(libraries: Iterable[Any]) -> Any:
    """One module of kernels, and of what numba itself compiled for operators in them."""
    parts = [library for library in libraries if isinstance(library, _Part)]
    module = llvm.parse_assembly(_joined(part.text for part in parts))
    for code in dict.fromkeys(code for part in parts for code in part.foreign):
        own = llvm.parse_bitcode(code)
        for function in own.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        module.link_in(own)
    return module


def _collect(library: Any, found: dict[Any, None]) -> None:
    if library not in found:
        found[library] = None
        for below in library._linking_libraries:
            _collect(below, found)


def _renamed(pattern: re.Pattern[str], names: Mapping[str, str], text: str) -> str:
    return pattern.sub(lambda found: names.get(found[0], found[0]), text)


def _joined(texts: Iterable[str]) -> str:
    """One module of the texts of several: what they declare or hold in common stands once."""
    heads: dict[str, None] = {}
    declared: dict[str, str] = {}
    metadata: dict[str, int] = {}
    bodies: list[str] = []
    for text in texts:
        numbers: dict[str, str] = {}
        names: dict[str, str] = {}
        body: list[str] = []
        inside = False
        for line in text.split("\n"):
            if inside or line.startswith("define "):
                inside = line != "}"
                body.append(line)
            elif line.startswith("declare "):
                declared[line.partition("(")[0].rpartition(" ")[2]] = line
            elif line.startswith("@"):
                name, _, content = line.partition(" = ")
                if content.startswith("internal"):  # a constant of this module alone
                    content = _renamed(CONSTANT, names, content)
                    names[name] = f'@"constant.{sha256(content.encode()).hexdigest()[:16]}"'
                    name = names[name]
                heads[f"{name} = {content}"] = None
            elif line.startswith("!"):
                name, _, content = line.partition(" = ")
                numbers[name] = f"!{metadata.setdefault(content, len(metadata))}"
        whole = "\n".join(body)
        if any(old != new for old, new in numbers.items()):
            whole = _renamed(METADATA, numbers, whole)
        if names:
            whole = _renamed(CONSTANT, names, whole)
        bodies.append(whole)
    defined = {name for whole in bodies for name in DEFINED.findall(whole)}
    outside = [line for name, line in declared.items() if name not in defined]
    notes = [f"!{number} = {content}" for content, number in metadata.items()]
    return "\n".join([*heads, *outside, *bodies, *notes])


_WORD, _NUMBER = ir.IntType(64), ir.DoubleType()
_C_TYPE = {"int64": _WORD, "float64": _NUMBER, "void": ir.VoidType()}
_RANK = {"vector": 1, "matrix": 2}


def _in_c(entry: Entry, name: str) -> ir.Module:
    """The function that C calls: arrays are pointers with their extents.

    A whole number is -1 where a kernel failed.
    """
    module = ir.Module()
    pointer = _NUMBER.as_pointer()
    taken: list[ir.Type] = []
    for kind in entry.arguments:
        taken += [pointer, *[_WORD] * _RANK[kind]] if kind in _RANK else [_C_TYPE[kind]]
    form = ir.FunctionType(_C_TYPE[entry.returned], taken)
    shown = ir.Function(module, form, SYMBOL.format(entry.name))
    builder = ir.IRBuilder(shown.append_basic_block())
    nothing = ir.Constant(ir.IntType(8).as_pointer(), None)
    given = iter(shown.args)
    handed: list[ir.Value] = []
    for kind in entry.arguments:
        if kind not in _RANK:
            handed.append(next(given))
            continue
        data = next(given)
        shape = [next(given) for _ in range(_RANK[kind])]
        strides, count = [], _WORD(1)
        for extent in reversed(shape):
            strides.insert(0, builder.mul(count, _WORD(8)))
            count = builder.mul(count, extent)
        handed += [nothing, nothing, count, _WORD(8), data, *shape, *strides]
    result_type = nothing.type if entry.returned == "void" else form.return_type
    result = builder.alloca(result_type)
    raised = builder.alloca(nothing.type)
    builder.store(ir.Constant(result_type, None if entry.returned == "void" else 0), result)
    kinds = [value.type for value in (result, raised, *handed)]
    inner = ir.Function(module, ir.FunctionType(ir.IntType(32), kinds), name)
    status = builder.call(inner, [result, raised, *handed])
    if entry.returned == "void":
        builder.ret_void()
    elif entry.returned == "int64":
        fine = builder.icmp_signed("==", status, ir.IntType(32)(0))
        builder.ret(builder.select(fine, builder.load(result), _WORD(-1)))
    else:
        builder.ret(builder.load(result))
    return module


# --- a user's own sub-models ---------------------------------------------------------------------
def compiled_model(function: Callable[..., None], family: str) -> Any:
    """A sub-model of one's own, compiled for the signature of its family."""
    prepare()
    kinds = (type_of(kind) for kind in OWN_MODELS[family][1])
    plain = getattr(function, "py_func", function)
    return cfunc(types.void(*kinds), error_model="numpy")(plain)


def compiled(function: Callable[..., Any]) -> Any:
    """A function of numba's own that may call kernels; for what the library does not hold."""
    prepare()
    return njit(error_model="numpy", nogil=True)(function)
