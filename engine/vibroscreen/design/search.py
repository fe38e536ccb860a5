"""Search for the best design: whole populations through the engine at once.

Particle swarms, as in the paper of Ivanov and Vaisberg, differential evolution, and NSGA-II for
several goals, all of pymoo. What is reported was solved again at a tolerance of 1e-5, and meets its
conditions there.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vibroscreen.design.plan import SHARP, SLACK, Search
from vibroscreen.study.plan import fingerprint
from vibroscreen.study.runner import keep, workers_of

__all__ = ["Found", "generations", "search"]

Array = NDArray[np.float64]

AGAIN = 20  # candidates that are solved again at first; twice as many if none of them holds
PART = 100  # designs that one worker solves at once
SHARE = "share "  # what columns of shares of the ranges are called where they are kept


@dataclass(frozen=True)
class Found:
    """What a search found.

    best: designs that meet all conditions at a tolerance of 1e-5, the best first; with several
    goals those that none beats in all. Empty if there is none: then `nearest` is the design that
    misses least, and `why` says what it misses. history: the best cost, or the least miss, by
    generation. binding: conditions and bounds that hold the best design where it is.
    sensitivity: by variable, what the goals do where it goes up and down by 1 % of its range.
    evaluations: how many designs went through the engine.
    """

    search: Search
    best: pd.DataFrame
    nearest: pd.Series[Any]
    why: str
    binding: tuple[str, ...]
    sensitivity: pd.DataFrame
    history: pd.DataFrame
    evaluations: int


def search(
    what: Search,
    *,
    folder: Path | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Found:
    """Search for the best design; a seed gives the same one again.

    folder: where what was solved is kept: a search that was ended goes on there, as what it solved
    before need not be solved again. executor: any of `concurrent.futures`, or of a cluster, which
    solves parts of large populations; what is found is the same. progress is called with the
    generations done and of all.
    """
    memory = _Memory(what, folder, executor)
    history = _optimise(what, memory, progress)
    seen = memory.frame()
    shares = memory.shares()
    by_condition = what.missed(seen)
    missed = np.maximum(by_condition, 0.0).sum(axis=1)
    good = np.flatnonzero(missed <= SLACK * (1 + len(what.conditions)))
    best = _again(what, shares, _ranked(what.costs(seen), good), by_condition)
    if best:
        place = best[0]
        rows = what.measured(*what.values(shares[best]), tolerance=SHARP)
    else:
        place = int(np.argmin(missed))
        rows = None
    near = what.measured(*what.values(shares[[place]]), tolerance=SHARP)
    return Found(
        what,
        near.iloc[:0] if rows is None else rows,
        near.iloc[0],
        "" if best else _why(what, near),
        _binding(what, shares[place], near),
        _sensitivity(what, shares[place]),
        history,
        len(seen),
    )


def _part(what: Search, shares: Array) -> pd.DataFrame:
    """Results of designs at shares of the ranges."""
    return what.measured(*what.values(shares))


class _Memory:
    """What went through the engine already, so that it need not go twice."""

    def __init__(self, what: Search, folder: Path | None, executor: Executor | None) -> None:
        self._what, self._executor = what, executor
        self._rows: dict[bytes, int] = {}
        self._shares: list[Array] = []
        self._frames: list[pd.DataFrame] = []
        self._path: Path | None = None
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            self._path = folder / f"search-{fingerprint(what)}.parquet"
            if self._path.exists():
                self._recall(self._path)

    def _recall(self, path: Path) -> None:
        from pyarrow import ArrowException

        try:
            frame = pd.read_parquet(path)
        except (ArrowException, OSError):
            warnings.warn(f"{path} is damaged: what it held is solved again", stacklevel=2)
            return
        own = [name for name in frame if str(name).startswith(SHARE)]
        self._add(frame[own].to_numpy(float), frame.drop(columns=own))

    def _add(self, shares: Array, frame: pd.DataFrame) -> None:
        start = len(self._rows)
        self._rows |= {row.tobytes(): start + k for k, row in enumerate(shares)}
        self._shares.append(shares)
        self._frames.append(frame)

    def results(self, shares: Array) -> pd.DataFrame:
        """Results at shares of the ranges; what is new goes through the engine, all at once."""
        shares = np.ascontiguousarray(shares + 0.0)
        new = {row.tobytes(): row for row in shares if row.tobytes() not in self._rows}
        if new:
            rows = np.array(list(new.values()))
            self._add(rows, self._solved(rows))
            self._keep()
        return self.frame().iloc[[self._rows[row.tobytes()] for row in shares]]

    def _solved(self, rows: Array) -> pd.DataFrame:
        """Results of new designs, here or in parts by the executor."""
        if self._executor is None:
            return _part(self._what, rows)
        parts = [rows[start : start + PART] for start in range(0, len(rows), PART)]
        with workers_of(self._path and self._path.parent):
            found = list(self._executor.map(_part, [self._what] * len(parts), parts))
        return pd.concat(found, ignore_index=True)

    def _keep(self) -> None:
        if self._path is not None:
            names = [f"{SHARE}{k}" for k in range(len(self._what.variables))]
            whole = self.frame().join(pd.DataFrame(self.shares(), columns=names))
            keep(whole, self._path)

    def frame(self) -> pd.DataFrame:
        """All results, in the order of the engine."""
        if len(self._frames) > 1:
            self._frames = [pd.concat(self._frames, ignore_index=True)]
        return self._frames[0]

    def shares(self) -> Array:
        """All designs."""
        if len(self._shares) > 1:
            self._shares = [np.concatenate(self._shares)]
        return self._shares[0]


def generations(what: Search, evaluate: Callable[[Array], tuple[Array, Array]]) -> Iterator[None]:
    """Let the optimiser of a search run, a generation at a time.

    evaluate: costs [design, goal] and how far conditions are missed [design, condition] at shares
    of the ranges [design, variable].
    """
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.algorithms.soo.nonconvex.de import DE
    from pymoo.algorithms.soo.nonconvex.pso import PSO
    from pymoo.core.problem import Problem
    from pymoo.termination import get_termination

    class Designs(Problem):
        def _evaluate(self, x: Array, out: dict[str, Array], *_: Any, **__: Any) -> None:
            out["F"], out["G"] = evaluate(np.clip(x, 0.0, 1.0))

    makers = {"pso": PSO, "de": DE, "nsga2": NSGA2}
    algorithm = makers[what.algorithm](pop_size=what.population)
    count = len(what.variables)
    problem = Designs(
        n_var=count, n_obj=len(what.goals), n_ieq_constr=1 + len(what.conditions), xl=0.0, xu=1.0
    )
    algorithm.setup(problem, termination=get_termination("n_gen", what.generations), seed=what.seed)
    while algorithm.has_next():
        algorithm.next()
        yield


def _optimise(
    what: Search, memory: _Memory, progress: Callable[[int, int], None] | None
) -> pd.DataFrame:
    """Let the optimiser run; the best cost and the least miss by generation."""

    def evaluate(shares: Array) -> tuple[Array, Array]:
        frame = memory.results(shares)
        return what.costs(frame), what.missed(frame)

    history = []
    for _ in generations(what, evaluate):
        frame = memory.frame()
        missed = np.maximum(what.missed(frame), 0.0).sum(axis=1)
        costs = what.costs(frame)[missed <= SLACK, 0]
        history.append(
            {"evaluations": len(frame), "cost": costs.min(initial=np.inf), "missed": missed.min()}
        )
        if progress is not None:
            progress(len(history), what.generations)
    return pd.DataFrame(history)


def _ranked(costs: Array, good: NDArray[np.intp]) -> list[int]:
    """Good designs, the best first; with several goals those that none beats in all."""
    if costs.shape[1] == 1:
        return list(good[np.argsort(costs[good, 0], kind="stable")])
    front: list[int] = []
    for design in good[np.lexsort(costs[good].T[::-1])].tolist():
        beaten = [(costs[other] <= costs[design]).all() for other in front]
        if not any(beaten):
            front.append(design)
    return front


def _again(what: Search, shares: Array, ranked: Sequence[int], missed: Array) -> list[int]:
    """Of ranked designs those that meet all conditions at a tolerance of 1e-5.

    One goal: they are ranked again by what they cost there, and the first ones are enough. What
    conditions are missed by more at that tolerance, at least, is expected of the others too: those
    that it would make miss come last. missed[design, condition]: at the tolerance of the search.
    """
    several = len(what.goals) > 1
    left, more = np.array(ranked, dtype=np.intp), np.zeros(missed.shape[1])
    count = len(left) if several else AGAIN
    while left.size:
        likely = (missed[left] + more <= SLACK).all(axis=1)
        left = np.concatenate([left[likely], left[~likely]])
        some, left = left[:count], left[count:]
        frame = what.measured(*what.values(shares[some]), tolerance=SHARP)
        sharp = what.missed(frame)
        good = np.flatnonzero((sharp <= SLACK).all(axis=1))
        if good.size or several:
            if not several:
                good = good[np.argsort(what.costs(frame)[good, 0], kind="stable")]
            return [int(design) for design in some[good]]
        more, count = (sharp - missed[some]).min(axis=0), 2 * count
    return []


def _why(what: Search, near: pd.DataFrame) -> str:
    """What the design that misses least misses."""
    if near["refused"].iloc[0]:
        return f"no design can be run, such as this one: {near['refused'].iloc[0]}"
    missed = what.missed(near)[0, 1:]
    told = [
        f"{condition.of} is {near[condition.of].iloc[0]:.4g} ({condition.text} is wanted)"
        for condition, miss in zip(what.conditions, missed, strict=True)
        if miss > SLACK
    ]
    return "no design meets all conditions; of the nearest " + " and ".join(told)


def _binding(what: Search, share: Array, near: pd.DataFrame) -> tuple[str, ...]:
    """Conditions that are met by less than 1 % of their limit, and ranges that end there."""
    missed = what.missed(near)[0, 1:]
    held = [c.text for c, miss in zip(what.conditions, missed, strict=True) if abs(miss) < 0.01]
    for place, variable in enumerate(what.variables):
        if variable.low is not None and not 0.01 < share[place] < 0.99:
            end = "from" if share[place] < 0.5 else "to"
            limit = variable.low if end == "from" else variable.high
            held.append(f"{variable.key} {end} {limit:g}")
    return tuple(held)


def _sensitivity(what: Search, share: Array) -> pd.DataFrame:
    """Goals and conditions where each variable goes down and up by 1 % of its range."""
    moved, rows = [], []
    for place, variable in enumerate(what.variables):
        if variable.low is None or variable.whole:
            continue
        for step in (-0.01, 0.01):
            other = share.copy()
            other[place] = np.clip(other[place] + step, 0.0, 1.0)
            moved.append(other)
            rows.append((variable.key, f"{100 * step:+.0f} %"))
    asked = list(dict.fromkeys([g.of for g in what.goals] + [c.of for c in what.conditions]))
    if not moved:
        return pd.DataFrame(columns=asked)
    there = what.measured(*what.values(share[None]), tolerance=SHARP)[asked]
    frame = what.measured(*what.values(np.array(moved)), tolerance=SHARP)[asked]
    change = frame - there.to_numpy()
    change.index = pd.MultiIndex.from_tuples(rows, names=("variable", "of its range"))
    return change
