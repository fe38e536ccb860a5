"""Search for the best design of a screen or a circuit."""

from __future__ import annotations

from vibroscreen.design.plan import Condition, Goal, Search, Total, Variable
from vibroscreen.design.search import Found, search

__all__ = ["Condition", "Found", "Goal", "Search", "Total", "Variable", "search"]
