"""Folders that tests read."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SCREENS = ROOT / "plant_examples" / "screens"
DATA = ROOT / "tests" / "data"
