"""What the python runtime cannot do: pythonfmu's library, which no slave can mend from inside.

Measured with pythonfmu 0.7.0 on Linux, hosts in Python and in C (tests/fmu/test_python_limits.py,
test_bare_host.py).
"""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

__all__ = ["HOST_SETUP", "IN_SHORT", "LOST", "PYTHON_LIMITS", "Paragraph", "lost_characters"]

# Characters of a path that a URI writes as %xx, but the space; so are all outside of ASCII.
LOST = "()[]{}&,;:=@!?$'\"`^*|<>%#+"
# A text, commands (a text of several lines), or a list.
Paragraph = str | tuple[str, ...]

# What a host that is not Python needs before it starts, from the Python that the FMU shall run in.
# PYTHONHOME comes last: it changes what the others would print.
HOST_SETUP = """\
export PYTHONPATH="$(python -c 'import sysconfig as s; print(s.get_path("purelib"))')"
export LD_PRELOAD="$(python -c 'import sysconfig as s
print(s.get_config_var("LIBDIR") + "/" + s.get_config_var("INSTSONAME"))')"
export PYTHONHOME="$(python -c 'import sys; print(sys.base_prefix)')"
"""
IN_SHORT = (
    "python runtime: for Python hosts; others need LD_PRELOAD, PYTHONHOME and PYTHONPATH "
    "(documentation/index.html in the FMU)",
    "it ends a host that unzips it in a folder with other characters than A-Z a-z 0-9 . _ - ~ and "
    "space in its path; runtime = native does not",
)
PYTHON_LIMITS: tuple[Paragraph, ...] = (
    "pythonfmu's library runs the Python inside. What follows is its own and cannot be mended from "
    "Python; runtime = native has none of it.",
    "These end the host, by a segmentation fault or an abort:",
    (
        "a folder in the path of the unzipped FMU with a character that a URI writes as %xx, but "
        f"the space: {' '.join(LOST)} and all outside of ASCII. "
        '"Program Files (x86)" and "R&D" are such folders. Letters, digits, . _ - ~ and space are '
        "fine, and so is a host that writes the path as it is, without %xx",
        "a resource location file:/path or file://localhost/path, an empty one, and NULL: only "
        "file:///path and a bare path are understood",
        "a callback logger that is NULL, or callbacks that are overwritten after fmi2Instantiate, "
        "as soon as something is logged",
        "OMSimulator 3 that ends without fmi2Terminate (a plain C host and fmpy end well), or in "
        "which a set or an initialisation is refused: that is logged without a category",
    ),
    "A host that is not Python has to bring a shared libpython 3.11 or newer and numpy; without "
    "the first the library does not load (undefined symbol: _Py_NoneStruct), without the others "
    "there is no instance. In a shell, with python that which has numpy, before the host starts:",
    HOST_SETUP,
    "A refused step returns fmi2Discard. A refused set, get or initialisation returns fmi2Fatal, "
    "the only error that the library knows; the instance still works after it.",
    "lastSuccessfulTime belongs to the library: after fmi2SetFMUstate it stays at the last step's "
    "end, until the next step.",
    "The GUID of the caller is not compared with that of the file.",
)


def lost_characters(folder: Path) -> str:
    """Characters in the path of a folder that end the host of an FMU that is unzipped there."""
    parts = folder.resolve().parts[1:]  # without the root
    return "".join(dict.fromkeys(c for part in parts for c in part if c != " " and quote(c) != c))
