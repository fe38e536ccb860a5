"""What numba made of each kernel, kept in the user's cache folder by what the kernel says.

After an edit only the kernels that it touches are typed and lowered again: those whose own code or
whose constants changed, and those that call a kernel that gives another type now.
"""

from __future__ import annotations

import contextlib
import pickle
import time
import zlib
from collections.abc import Callable, Mapping
from hashlib import sha256
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.lowering import Environment
from numba.core.serialize import dumps

from vibroscreen.compiler import language, library

# What nobody asked for in this time is thrown away, s.
LONGEST = 90 * 86400.0
# What makes code of kernels, by its bytes.
MAKERS = ("fours.py", "kept.py", "language.py", "lowering.py", "whole.py")


def recipe() -> str:
    """What all kernels depend on besides themselves."""
    texts = [Path(library.FOLDER, name).read_bytes() for name in MAKERS]
    return sha256(b"\0".join([*texts, numba.__version__.encode()])).hexdigest()


def meaning(function: Callable[..., Any]) -> str:
    """What a kernel says: its code, without where it stands, and the constants that it names."""
    globals_ = function.__globals__
    code = function.__code__
    said = [function.__module__, function.__qualname__, _code(code, function.__doc__)]
    names = _names(code)
    for name in sorted(names & globals_.keys()):
        said.append(f"{name} = {_value(globals_[name], names)}")
    said += [_value(cell.cell_contents, set()) for cell in function.__closure__ or ()]
    return "\n".join(said)


def _names(code: CodeType) -> set[str]:
    inner = (part for part in code.co_consts if isinstance(part, CodeType))
    return set(code.co_names).union(*map(_names, inner))


def _code(code: CodeType, text: str | None) -> str:
    parts = [_code(c, None) if isinstance(c, CodeType) else repr(c) for c in code.co_consts]
    held = [part for part in parts if part != repr(text)]
    return repr((code.co_code, held, code.co_names, code.co_varnames, code.co_argcount))


def _value(value: Any, names: set[str]) -> str:
    if isinstance(value, np.ndarray):
        return repr((value.dtype, value.shape, value.tobytes()))
    if isinstance(value, ModuleType):
        held = {name: getattr(value, name) for name in sorted(names) if hasattr(value, name)}
        return repr((value.__name__, [(n, _value(v, set())) for n, v in held.items()]))
    if isinstance(value, language.Entry):
        return f"entry {value.name}"
    if callable(value):
        return f"{value.__module__}.{getattr(value, '__qualname__', '')}"
    return repr(value)


class Store(NullCache):
    """Where numba looks for a kernel before it compiles it, and puts it afterwards.

    compile_kernel: gives the library of a kernel by name for types of arguments, and what it
    returns; make: an empty library that texts are put into; tell: one more is done.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        recipe: str,
        compile_kernel: Callable[[str, Any], tuple[Any, Any]],
        make: Callable[[str], Any],
        owners: dict[Any, tuple[str, Any, Any]],
        tell: Callable[[], None],
    ) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._said = f"{recipe}\n{meaning(function)}"
        self._compile_kernel, self._make, self._owners = compile_kernel, make, owners
        self._tell = tell

    def _path(self, kinds: Any) -> Path:
        key = sha256(f"{self._said}\n{kinds}".encode()).hexdigest()[:24]
        return library.cache_folder() / "kernels" / key

    def load_overload(self, sig: Any, target_context: Any) -> CompileResult | None:
        """What was kept of the kernel, if what it calls still gives what it gave."""
        path = self._path(sig)
        with contextlib.suppress(Exception):  # a broken file is as none
            kept = pickle.loads(zlib.decompress(path.read_bytes()))
            below = [self._compile_kernel(name, kinds) for name, kinds, _ in kept["calls"]]
            if [given for _, given in below] != [given for *_, given in kept["calls"]]:
                return None
            path.touch()
            self._tell()
            return self._restored(kept, [part for part, _ in below], target_context)
        return None

    def _restored(
        self, kept: Mapping[str, Any], below: list[Any], target_context: Any
    ) -> CompileResult:
        fndesc, made = kept["fndesc"], self._make(self._name)
        made.text, made.foreign = kept["text"], kept["foreign"]
        for part in below:
            made.add_linking_library(part)
        made.finalize()
        environment = Environment.from_fndesc(fndesc)
        self._owners[made] = (self._name, kept["signature"].args, kept["signature"].return_type)
        return CompileResult(
            typing_context=target_context.typing_context,
            target_context=target_context,
            entry_point=target_context.get_executable(made, fndesc, environment),
            typing_error=None,
            type_annotation=None,
            signature=kept["signature"],
            objectmode=False,
            lifted=(),
            fndesc=fndesc,
            library=made,
            call_helper=None,
            environment=environment,
            metadata=None,
            reload_init=(),
            referenced_envs=(),
        )

    def save_overload(self, sig: Any, cres: CompileResult) -> None:
        """Keep a kernel that was compiled just now."""
        made, signature = cres.library, cres.signature
        self._owners[made] = (self._name, signature.args, signature.return_type)
        cres.fndesc.typemap = cres.fndesc.calltypes = None
        foreign = [part for part in made._linking_libraries if part not in self._owners]
        made.foreign = [part._final_module.as_bitcode() for part in foreign]
        kept = {
            "signature": signature,
            "fndesc": cres.fndesc,
            "text": made.text,
            "foreign": made.foreign,
            "calls": [self._owners[p] for p in made._linking_libraries if p in self._owners],
        }
        with contextlib.suppress(OSError):
            library.keep(self._path(sig), zlib.compress(dumps(kept), 1))
        self._tell()


def throw_away() -> None:
    """Remove kernels that nobody asked for in a long time."""
    latest = time.time() - LONGEST
    for path in (library.cache_folder() / "kernels").glob("*"):
        with contextlib.suppress(OSError):
            if path.stat().st_mtime < latest:
                path.unlink()
