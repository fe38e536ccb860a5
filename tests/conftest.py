"""Set up before numba is imported: compiled kernels go to a folder named by their sources.

numba does not see changes in a called module, so what an older version compiled must not be found.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

from hypothesis import settings

KERNELS = Path(__file__).parent.parent / "engine" / "vibroscreen" / "kernels"


def _cache_folder() -> Path:
    """Folder for the kernels as they are now, shared by all runs of one user."""
    digest = hashlib.sha256()
    for path in sorted(KERNELS.glob("*.py")):
        digest.update(path.read_bytes())
    home = os.environ.get("XDG_CACHE_HOME") or tempfile.gettempdir()
    user = str(os.getuid()) if hasattr(os, "getuid") else "user"
    return Path(home) / f"vibroscreen-tests-{user}" / digest.hexdigest()[:16]


os.environ.setdefault("NUMBA_CACHE_DIR", str(_cache_folder()))

# No folder of examples beside the sources.
settings.register_profile("vibroscreen", database=None)
settings.load_profile("vibroscreen")
