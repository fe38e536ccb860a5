"""Kinds of runs: what several have alike and others not, such as a frequency or a feed rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from vibroscreen.config import ScreenConfig
from vibroscreen.sweep import places

__all__ = ["kinds_of"]

FEED_RATE = "feed.mass_flow_rate"
BY_CLASS = ("feed.mass_fraction", "size_class")
# Values of one level: feed rates of a level differ as scales do, all else not.
ALIKE_RATE, ALIKE = 0.1, 1e-9


class Grouped(Protocol):
    """A run of a survey."""

    @property
    def config(self) -> ScreenConfig:
        """With the screen and duty of the run."""
        ...

    @property
    def group(self) -> str:
        """What is left out together with it."""
        ...


def kinds_of(runs: Sequence[Grouped]) -> dict[str, frozenset[str]]:
    """Groups of runs that share a number which differs over the survey, by what they share.

    Levels of one run, or of all, are none. Kinds that are of the same runs are one.
    """
    shared: dict[frozenset[str], list[str]] = {}
    everyone = frozenset(run.group for run in runs)
    names = set.intersection(*(set(places(run.config)) for run in runs))
    for name in places(runs[0].config):
        if name not in names or name.startswith(BY_CLASS):
            continue
        values = np.array([run.config.value_of(name) for run in runs])
        if values.min() == values.max():
            continue
        alike = ALIKE_RATE if name == FEED_RATE else ALIKE
        order = np.argsort(values, kind="stable")
        rises = np.diff(values[order]) > alike * np.abs(values[order][:-1])
        for level in np.split(order, np.flatnonzero(rises) + 1):
            groups = frozenset(runs[k].group for k in level)
            if len(groups) > 1 and groups != everyone:
                low, high = values[level].min(), values[level].max()
                upto = f" to {high:.4g}" if high > low else ""
                shared.setdefault(groups, []).append(f"{name} = {low:.4g}{upto}")
    return {", ".join(said): groups for groups, said in shared.items()}
