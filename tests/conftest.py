"""Set up before numba is imported: compiled kernels go to a folder named by their sources.

numba does not see changes in a called module, so what an older version compiled must not be found.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
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


@pytest.fixture(scope="module", autouse=True)
def _own_sub_models_stay_in_their_module() -> Iterator[None]:
    """Sub-models that the tests of a module register are forgotten after it."""
    from vibroscreen.kernels import registry

    kept = {family: dict(models) for family, models in registry._models.items()}
    yield
    for family, models in kept.items():
        registry._models[family].clear()
        registry._models[family].update(models)
