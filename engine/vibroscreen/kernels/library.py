"""The engine: all kernels in one library, and the C layer of FMUs over them (compiler/library.py).

    python -m vibroscreen.kernels.library LIBRARY [PLATFORM]

makes that of a platform, this machine's if none is given.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

from vibroscreen.compiler.library import STAMP, SUFFIX, Library, cache_folder, host

__all__ = ["STAMP", "SUFFIX", "cache_folder", "host"]

FOLDER = Path(__file__).parent
NATIVE = FOLDER.parent / "native"
# The C layer of FMUs, and what writes its header.
LAYER = ("fmi2.c", "fmi2.h", "place.h", "processor.h", "sheet.h")


def _load() -> None:
    import vibroscreen.kernels.entry
    import vibroscreen.kernels.plan  # noqa: F401


def _records() -> str:
    """The records of the buffer, whose numbers the sections of a configuration say."""
    from vibroscreen.kernels import state

    return repr(state.KINDS)


def native_sources(target: str) -> dict[str, bytes]:
    """The C layer of FMUs, with its header for a platform."""
    from vibroscreen.compiler import machine

    header = import_module("vibroscreen.native.header")  # which an FMU does not bring
    _load()
    files = {name: (NATIVE / name).read_bytes() for name in LAYER}
    text = machine.prototypes() + header.header("-".join(stamps()), SUFFIX[target])
    return {**files, "engine.h": text.encode()}


def library_with(native: Path) -> Library:
    """The library of the kernels with the C layer of a folder."""
    layer = tuple(native / name for name in ("header.py", *LAYER))
    return Library("vibroscreen.kernels.library", FOLDER, layer, _load, native_sources, _records)


KERNELS = library_with(NATIVE)
entry, engine, stamps, sources = KERNELS.entry, KERNELS.engine, KERNELS.stamps, KERNELS.sources
note = KERNELS.note
library, library_name, at_hand = KERNELS.path_of, KERNELS.name_of, KERNELS.at_hand

if __name__ == "__main__":
    from vibroscreen.compiler.machine import host as this_machine

    KERNELS.make(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else this_machine())
