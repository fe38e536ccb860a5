"""Build the FMU of a vibrating screen: `python build_fmu.py [SCREEN.toml] [--runtime RUNTIME]`.

The same as `vibroscreen build`.
"""

from __future__ import annotations

import sys

from vibroscreen.cli import app
from vibroscreen_fmu.build import RUNTIMES, build, platforms_of

__all__ = ["RUNTIMES", "build", "platforms_of"]

if __name__ == "__main__":
    app(["build", *sys.argv[1:]], prog_name="vibroscreen")
