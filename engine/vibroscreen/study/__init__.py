"""Energy studies of circuits: many designs, kept as they come, on one machine or many."""

from __future__ import annotations

from vibroscreen.study.plan import Axis, Study
from vibroscreen.study.runner import collect, run
from vibroscreen.study.settled import Settled, settle

__all__ = ["Axis", "Settled", "Study", "collect", "run", "settle"]
