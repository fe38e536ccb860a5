"""Where benchmarks leave what they found."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def write_json(folder: Path, name: str, found: Mapping[str, Any]) -> None:
    """Write `name`.json into a folder, which is made if it is missing; no nan, no infinity."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(json.dumps(found, indent=1, allow_nan=False) + "\n")
