"""One decorator for every kernel, views of a flat buffer, and the call of a user's own sub-model.

With NUMBA_DISABLE_JIT=1 everything here falls back to plain Python of the same meaning.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import ir
from numba import carray, cfunc, config, njit, types
from numba.extending import intrinsic, register_jitable
from numba.np import linalg


def _load_arrays_without_scipy() -> None:
    """Load what numba knows of arrays, without the BLAS that it looks for there.

    Kernels use none, and scipy, where it is installed, takes longer to import than the kernels to
    load. Who needs BLAS is given it when it is used.
    """
    if "numba.np.arraymath" in sys.modules or find_spec("scipy") is None:
        return
    kept = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = kept


_load_arrays_without_scipy()


def _source_stamp() -> str:
    """Hash of the sources of all kernels."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


SOURCE_STAMP = _source_stamp()


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a kernel once; its cache is good as long as no kernel changes.

    numba compares only the file of the kernel itself and would run what was compiled against an
    older version of a kernel that it calls; it also compiles anew for every constant argument.
    """
    # Kernels allocate nothing, and what they view is owned by who called them: counting references
    # would only be calls in every loop.
    return _compiled(function, counted=False)


def folded(function: Callable[..., Any]) -> Any:
    """A kernel whose machine code is copied to where it is called, for those called in every rate.

    A call hands over every array as seven words on the stack, which takes as long as a sum over
    twenty sizes.
    """
    return _compiled(function, counted=False, forceinline=True)


def viewing(function: Callable[..., Any]) -> Any:
    """A kernel that gives a view of the buffer, which numba allows only where it counts."""
    return _compiled(function, counted=True)


def _compiled(function: Callable[..., Any], *, counted: bool, forceinline: bool = False) -> Any:
    # error_model="numpy": a division by zero gives inf, not an exception path in every loop.
    # No fastmath: it deletes NaN guards and reorders sums.
    dispatcher = njit(
        cache=True,
        error_model="numpy",
        nogil=True,
        no_cfunc_wrapper=True,
        forceinline=forceinline,
        _nrt=counted,
    )(function)
    if config.DISABLE_JIT:
        return dispatcher
    cache = dispatcher._cache
    cache._cache_file = type(cache._cache_file)(
        cache_path=cache._cache_path,
        filename_base=f"{cache._impl.filename_base}-{SOURCE_STAMP[:12]}",
        source_stamp=SOURCE_STAMP,
    )
    resolve = dispatcher.get_call_template

    def resolve_plain(arguments: tuple[Any, ...], keywords: dict[str, Any]) -> Any:
        return resolve(tuple(types.unliteral(kind) for kind in arguments), keywords)

    dispatcher.get_call_template = resolve_plain
    return dispatcher


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a kernel into its callers, for steps of a sequence that have one caller.

    Every level of compiled calls is optimised again with all that lies below it: fewer levels
    make compiling several times faster.
    """
    return njit(inline="always", error_model="numpy", _nrt=False)(function)


def formula(function: Callable[..., Any]) -> Any:
    """A formula that Python runs as it stands and kernels compile into themselves.

    For what Python needs before there is a buffer: nothing is compiled or loaded for it.
    """
    return register_jitable(error_model="numpy", _nrt=False)(function)


def is_ready(dispatcher: Any) -> bool:
    """Whether a kernel runs at once: compiled in this process or kept by an earlier one."""
    return (
        bool(config.DISABLE_JIT)
        or bool(dispatcher.signatures)
        or Path(dispatcher._cache._cache_file._index_path).exists()
    )


VECTOR = types.Array(types.float64, 1, "C")
MATRIX = types.Array(types.float64, 2, "C")

PASSAGE_SIGNATURE = types.void(VECTOR, VECTOR, VECTOR, VECTOR)
SEGREGATION_SIGNATURE = types.void(VECTOR, MATRIX, types.intp, VECTOR, VECTOR, MATRIX)
DISPLACEMENT_SIGNATURE = types.void(MATRIX, VECTOR, VECTOR, VECTOR)

_registered: dict[int, tuple[Callable[..., None], Any]] = {}


def address_of(function: Callable[..., None], signature: Any) -> int:
    """Address of a sub-model compiled for `signature`; kept alive for the life of the process."""
    plain = getattr(function, "py_func", function)
    if config.DISABLE_JIT:
        _registered[id(plain)] = (plain, plain)
        return id(plain)
    compiled = cfunc(signature, error_model="numpy")(plain)
    _registered[compiled.address] = (plain, compiled)
    return int(compiled.address)


def compiled_at(address: int) -> Any:
    """The compiled sub-model whose code lies at an address that `address_of` gave."""
    return _registered[address][1]


if config.DISABLE_JIT:

    def view1(buffer, offset, size):
        return buffer[offset : offset + size]

    def view2(buffer, offset, rows, columns):
        return buffer[offset : offset + rows * columns].reshape(rows, columns)

    def call_passage(address, *arguments):
        _registered[int(address)][0](*arguments)

    call_segregation = call_displacement = call_passage

    def bits_of(number):
        return int(np.float64(number).view(np.int64))

    def number_of(bits):
        return float(np.int64(bits).view(np.float64))

else:

    def _cast(source: Any, target: Any) -> Any:
        """Intrinsic that takes the bits of one type for another."""

        @intrinsic
        def cast(_context, _value):
            def generate(context, builder, _signature, arguments):
                return builder.bitcast(arguments[0], context.get_value_type(target))

            return target(source), generate

        return cast

    bits_of = _cast(types.float64, types.int64)
    number_of = _cast(types.int64, types.float64)

    @intrinsic
    def _pointer(_context, buffer, offset):
        def generate(context, builder, signature, arguments):
            array = context.make_array(signature.args[0])(context, builder, arguments[0])
            return builder.gep(array.data, [arguments[1]])

        return types.CPointer(types.float64)(buffer, types.intp), generate

    @viewing
    def view1(buffer, offset, size):
        """View of `size` numbers of the flat buffer from `offset` on; no copy, no allocation."""
        return carray(_pointer(buffer, offset), (size,))

    @viewing
    def view2(buffer, offset, rows, columns):
        """Matrix view of the flat buffer."""
        return carray(_pointer(buffer, offset), (rows, columns))

    def _caller(signature: Any) -> Any:
        """Intrinsic that calls the function at an address with the arguments of `signature`."""

        @intrinsic
        def call(_context, address, *arguments):
            def generate(context, builder, full, values):
                kinds = [context.get_value_type(kind) for kind in signature.args]
                returned = context.get_value_type(signature.return_type)
                function = builder.inttoptr(
                    values[0], ir.FunctionType(returned, kinds).as_pointer()
                )
                packed = builder.extract_value
                builder.call(function, [packed(values[1], k) for k in range(len(kinds))])
                return context.get_dummy_value()

            whole = types.void(types.intp, types.Tuple(signature.args))
            return whole, generate

        return call

    call_passage = _caller(PASSAGE_SIGNATURE)
    call_segregation = _caller(SEGREGATION_SIGNATURE)
    call_displacement = _caller(DISPLACEMENT_SIGNATURE)
