"""The first path of a newcomer, every command in a process of its own; its cost is printed."""

from __future__ import annotations

from tests.benchmarks import newcomer
from vibroscreen.cli import COMMANDS


def test_the_path() -> None:
    """From a sieve analysis on, every command that there is ends well, in its order."""
    found = newcomer.main(quick=True)
    there = [name for name in ("new", "check", "solve", "report", "explore") if name in COMMANDS]
    assert list(found) == ["--help", *there, "whole path"]
    assert found["whole path"]["processor"] > found["new"]["processor"] > 0.0
