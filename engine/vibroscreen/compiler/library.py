"""Kernels as one library: compiled once, as a whole, for Python, for FMUs and for C.

`engine()` gives the engine that this process runs in: the library that a wheel brings, or that of
the user's cache folder, made there by whoever needs it first. Without a linker, or with
VIBROSCREEN_ENGINE=jit, the same code is made in memory; VIBROSCREEN_ENGINE=python (or
NUMBA_DISABLE_JIT=1) runs kernels as plain Python. All give the same bits.

A library is known by two stamps: what the kernels say, without comments and docstrings, and what
makes a library of them, the C layer of FMUs among it. It holds two builds for x86-64, plain and v3
(AVX2), one of which is chosen when it is loaded; VIBROSCREEN_PROCESSOR=plain keeps to the plain
one. Only exact arithmetic is used, and LLVM may change no bit of it without fast-math: all builds
give the same numbers.
"""

from __future__ import annotations

import ast
import contextlib
import ctypes
import functools
import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from vibroscreen.compiler.language import ENTRIES, Entry

FOLDER = Path(__file__).parent
STAMP = "engine.stamp"
# No kernels, and not what compiles them; what makes a library of what the kernels say.
NO_KERNELS = ("__init__.py", "library.py")
MAKERS = ("machine.py",)
# Platforms by their folder in an FMU, and what a library is called there.
HOSTS = {
    ("Linux", "x86_64"): "linux64",
    ("Linux", "aarch64"): "aarch64-linux",
    ("Windows", "AMD64"): "win64",
    ("Darwin", "x86_64"): "darwin64",
    ("Darwin", "arm64"): "darwin64",
}
SUFFIX = {"linux64": ".so", "aarch64-linux": ".so", "win64": ".dll", "darwin64": ".dylib"}
# What browsers run, on any machine: WebAssembly, without the C layer.
WEB, WEB_SUFFIX = "wasm32", ".wasm"


# --- stamps and files ----------------------------------------------------------------------------
def cache_folder() -> Path:
    """Where the user's computer keeps what can be made anew."""
    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(caches) / "vibroscreen"


def says(text: bytes) -> str:
    """What a source says, without comments, docstrings and layout."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                first.value.value = ""
    return ast.dump(tree)


def digest_of(texts: Mapping[str, bytes]) -> str:
    """Sixteen digits that change with every byte of source files, by name."""
    return _digest(*(piece for name in sorted(texts) for piece in (name.encode(), texts[name])))


def _digest(*parts: bytes) -> str:
    return hashlib.sha256(b"\0".join(parts)).hexdigest()[:16]


def keep(path: Path, content: bytes) -> None:
    """Write a file that appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as unfinished:
        unfinished.write(content)
    Path(unfinished.name).replace(path)


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """One process at a time, where the system knows locks of files that end with the process."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as file:
        with contextlib.suppress(ImportError):
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX)
        yield


# --- engines -------------------------------------------------------------------------------------
_C_KIND = {"int64": ctypes.c_int64, "float64": ctypes.c_double, "void": None}
_POINTER = ctypes.POINTER(ctypes.c_double)


def _address(values: Any) -> Any:
    """Where the doubles of an array begin."""
    assert values.dtype == float, f"kernels take doubles, not {values.dtype}"
    assert values.flags.c_contiguous, "kernels take numbers one after the other"
    return values.ctypes.data_as(_POINTER)


class Compiled:
    """An engine of compiled functions, by their names in C."""

    def __init__(self, function: Callable[[str, Any], Any]) -> None:
        self._function = function

    def caller(self, entry: Entry) -> Callable[..., Any]:
        """What Python calls for an entry."""
        rank = {"vector": 1, "matrix": 2}
        taken: list[Any] = []
        for kind in entry.arguments:
            scalar = _C_KIND.get(kind)
            taken += [_POINTER, *[ctypes.c_int64] * rank[kind]] if kind in rank else [scalar]
        form = ctypes.CFUNCTYPE(_C_KIND[entry.returned], *taken)
        function = self._function(f"vibroscreen_{entry.name}", form)
        if entry.arguments[0] == "vector" and not set(entry.arguments[1:]) & set(rank):
            start = ctypes.c_double.from_buffer  # a third of the time of the general way

            def call_row(buffer: Any, *numbers: Any) -> Any:
                return function(start(buffer), buffer.size, *numbers)

            return call_row

        def call(*arguments: Any) -> Any:
            given: list[Any] = []
            for kind, value in zip(entry.arguments, arguments, strict=True):
                given += [_address(value), *value.shape] if kind in rank else [value]
            return function(*given)

        return call

    def caller_on(self, entry: Entry, buffer: Any) -> Callable[..., Any]:
        """What Python calls for an entry whose one array is this buffer."""
        kinds: list[Any] = [_C_KIND[kind] for kind in entry.arguments[1:]]
        form = ctypes.CFUNCTYPE(_C_KIND[entry.returned], ctypes.c_void_p, ctypes.c_int64, *kinds)
        function = self._function(f"vibroscreen_{entry.name}", form)
        _address(buffer)
        return functools.partial(function, buffer.ctypes.data, buffer.size)


class Plain:
    """Kernels as they stand, in Python."""

    def caller(self, entry: Entry) -> Callable[..., Any]:
        """What Python calls for an entry."""
        return entry.function

    def caller_on(self, entry: Entry, buffer: Any) -> Callable[..., Any]:
        """What Python calls for an entry whose one array is this buffer."""
        return functools.partial(entry.function, buffer)


def _loaded(path: Path) -> Compiled:
    library = ctypes.CDLL(str(path))
    return Compiled(lambda name, form: form((name, library)))


# --- libraries -----------------------------------------------------------------------------------
class Library:
    """Kernels and the C layer over them as a library.

    module: as which Python runs what makes it (`make`); folder: of the kernels, and of libraries
    that came with them; layer: files of the C layer, those that there are; load: imports all
    modules that have entries; c_sources: gives the C layer by file name, for a platform; records:
    what the kernels' records are, which other sources than theirs say.
    """

    def __init__(
        self,
        module: str,
        folder: Path,
        layer: tuple[Path, ...],
        load: Callable[[], None],
        c_sources: Callable[[str], dict[str, bytes]],
        records: Callable[[], str],
    ) -> None:
        self.module, self.folder, self.layer = module, folder, layer
        self.load, self.c_sources, self.records = load, c_sources, records
        self.stamps = functools.cache(self._stamps)
        self.engine = functools.cache(self._engine)

    def entry(self, signature: str) -> Callable[[Callable[..., Any]], Entry]:
        """Make a kernel an entry: signature such as "int64(vector, float64)"."""
        return lambda function: Entry(function, signature, self.engine)

    def sources(self) -> list[Path]:
        """The files of the kernels, and of what compiles them and makes a library of them."""
        layer = (path for path in self.layer if path.exists())
        found = [*sorted(self.folder.rglob("*.py")), *sorted(FOLDER.glob("*.py")), *layer]
        return [path for path in found if path.name not in NO_KERNELS]

    def _stamps(self) -> tuple[str, str]:
        texts = self._watched({path.name: path.read_bytes() for path in self.sources()})
        bytes_of = digest_of(texts)
        # Parsing takes longer than all the rest of a start: what bytes say is remembered.
        note = cache_folder() / f"{bytes_of}.stamp"
        for known in (self.folder / STAMP, note):
            with contextlib.suppress(OSError, ValueError):
                held, kernels, makers = known.read_text().split()
                if held == bytes_of:
                    return kernels, makers
        said = {
            name: says(text).encode() if name.endswith(".py") else text
            for name, text in texts.items()
        }
        makers_of = (*MAKERS, *(path.name for path in self.layer))
        made = {name: said.pop(name) for name in makers_of if name in said}
        found = digest_of(said), digest_of(made)
        with contextlib.suppress(OSError):
            keep(note, f"{bytes_of} {' '.join(found)}\n".encode())
        return found

    def _watched(self, texts: Mapping[str, bytes]) -> dict[str, bytes]:
        """What a stamp is of: source files by name, and the records."""
        own = {name: text for name, text in texts.items() if name not in NO_KERNELS}
        return {**own, "records": self.records().encode()}

    def note(self, texts: Mapping[str, bytes]) -> bytes:
        """What lies beside source files, by name, whose library comes with them."""
        return f"{digest_of(self._watched(texts))} {' '.join(self.stamps())}\n".encode()

    def _engine(self) -> Compiled | Plain:
        chosen = os.environ.get("VIBROSCREEN_ENGINE", "")
        if chosen not in ("", "library", "jit", "python"):
            raise RuntimeError(
                f"VIBROSCREEN_ENGINE = {chosen!r} is unknown: give library, jit or python"
            )
        if chosen == "python" or os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
            return Plain()
        path = None if chosen == "jit" else self.path_of()
        return _loaded(path) if path else self._in_memory()

    def _in_memory(self) -> Compiled:
        """The engine made by numba in this process, for this processor."""
        from vibroscreen.compiler import machine

        code = machine.InMemory(self.kept_code())
        return Compiled(lambda name, form: form(code.address(name)))

    def kept_code(self) -> bytes:
        """Intermediate code of all entries and what they call, for no processor in particular.

        It is kept in the user's cache folder.
        """
        path = cache_folder() / f"engine-{self.stamps()[0]}.bc"
        if not path.exists():
            from vibroscreen.compiler import whole

            self.load()
            keep(path, bytes(whole.intermediate_code(ENTRIES.values()).as_bitcode()))
        return path.read_bytes()

    def make(self, path: Path, target: str) -> None:
        """Make the library of a platform, or that for browsers, at a path."""
        from vibroscreen.compiler import machine

        code = self.kept_code()
        self.load()
        if target == WEB:
            keep(path, machine.web_library(code))
        else:
            keep(path, machine.engine_library(code, target, self.c_sources(target)))

    def name_of(self, target: str) -> str:
        """File name of the library for a platform, or for browsers."""
        suffix = WEB_SUFFIX if target == WEB else SUFFIX[target]
        return f"engine-{'-'.join(self.stamps())}-{target}{suffix}"

    def at_hand(self) -> dict[str, Path]:
        """The libraries that there are, by platform; this machine's is made if it is not there."""
        self.path_of()
        found = {target: self._found(target) for target in SUFFIX}
        return {target: path for target, path in found.items() if path}

    def path_of(self, target: str | None = None) -> Path | None:
        """The library for a platform, this machine's if none is named; made if there is none.

        None where it cannot be made.
        """
        target = target or host()
        if target is None:
            return None
        path = self._found(target)
        if path is not None:
            return path
        if not (FOLDER / "machine.py").exists():
            raise RuntimeError(
                f"this FMU has no engine for {platform.system()} {platform.machine()}: "
                "build one there"
            )
        kept = cache_folder() / self.name_of(target)
        with _locked(kept.with_suffix(".lock")):
            return kept if kept.exists() or self.made(kept, target) else None

    def _found(self, target: str) -> Path | None:
        """Where the library for a platform lies, if it does."""
        name = self.name_of(target)
        return next((f / name for f in (self.folder, cache_folder()) if (f / name).exists()), None)

    def made(self, path: Path, target: str) -> bool:
        """Make the library of a platform in a process of its own; False without a linker for it."""
        other = target != host() or not shutil.which(os.environ.get("CC", "cc"))
        if importlib.util.find_spec("ziglang") is None and other:
            return False
        text = f"vibroscreen compiles its engine for {target}, once: a minute or two"
        print(text, file=sys.stderr, flush=True)
        command = [sys.executable, "-W", "ignore", "-m", self.module]
        plain = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
        places = os.pathsep.join(place for place in sys.path if place)
        # The same bytes every time: no settings of the caller, no random order of sets.
        own = {"PYTHONPATH": places, "PYTHONHASHSEED": "0", "NUMBA_CPU_NAME": "generic"}
        run = subprocess.run([*command, str(path), target], env={**plain, **own}, check=False)
        return run.returncode == 0


def host() -> str | None:
    """This machine's platform, by its folder in an FMU."""
    return HOSTS.get((platform.system(), platform.machine()))
