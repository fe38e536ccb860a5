"""Do the intervals of a calibration hold the truth as often as they say?

Surveys of the quarry screen are made up with known numbers: recoveries with an error of 0.02;
recoveries with one run in four a third too low, fitted with Cauchy's loss; three products by class,
5 % uncertain; three products by scales of 4 % and sieves of 0.8 points. Passage and percolation
velocity are fitted back. Printed is how often 95 % intervals hold them, beside the range that
chance leaves to intervals that are right, and of `vibroscreen reconcile` how often a belt scale
that reads 10 % high is named, and how often an error is named where there is none.

Run `python engine/validation/survey_coverage.py --surveys 200`; by default few, to see that it
runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from numpy.typing import NDArray

import survey_planning as planning
from evidence import Section, table
from vibroscreen import ScreenConfig, solve_steady_many
from vibroscreen.calibrate import Fit, Parameter, Run, calibrate
from vibroscreen.survey import Sheet, Survey, SurveyRun, reconcile
from vibroscreen.survey.streams import StreamRun, stream_runs

Array = NDArray[np.float64]

FITTED = planning.PARAMETERS[:2]
RUNS = 4
SCALE, SIEVE, BY_CLASS = 0.04, 0.008, 0.05
LOW = 0.67  # of the recoveries of a run with a gross error
HIGH = 1.1  # of the rates of a scale that reads too high
KINDS = ("recoveries", "one gross error", "streams by class", "scales and sieves")
NAMED = "a scale 10 % high"  # a kind that is not fitted but reconciled
TOLD = ("named", "named with another", "false alarms")
SURVEYS, RECONCILED = 200, 300  # of the report


def products(config: ScreenConfig, runs: int = RUNS) -> list[dict[str, Array]]:
    """Streams of the true screen by class [kg/s], from slow to fast feeding."""
    rates = np.geomspace(planning.SLOWEST, planning.FASTEST, runs)
    table = solve_steady_many(config, {"feed.mass_flow_rate": rates})
    pairs = zip(table.undersize, table.oversize, strict=True)
    return [{"feed": u + o, "undersize": u, "oversize": o} for u, o in pairs]


def measured(
    config: ScreenConfig,
    streams: list[dict[str, Array]],
    rng: np.random.Generator,
    *,
    by_class: bool,
    factor: dict[str, float] | None = None,
) -> Survey:
    """What a survey would say of the streams; scales read by a factor."""
    sizes = config.size_classes.edges[1:]
    runs = []
    for place, run in enumerate(streams):
        sheets = {}
        for name, rates in run.items():
            if by_class:
                noisy = rates * (1.0 + BY_CLASS * rng.standard_normal(rates.size))
                sheets[name] = Sheet(name, name, sizes, class_rates=noisy)
                continue
            passing = np.cumsum(rates)[:-1] / rates.sum()
            passing = np.clip(passing + SIEVE * rng.standard_normal(passing.size), 0.0, 1.0)
            reads = (factor or {}).get(name, 1.0) * (1.0 + SCALE * rng.standard_normal())
            sheets[name] = Sheet(name, name, sizes[:-1], rates.sum() * reads, passing=passing)
        runs.append(SurveyRun(f"run {place + 1}", sheets, {}))
    return Survey(tuple(runs))


def fitted(kind: str, config: ScreenConfig, rng: np.random.Generator) -> Fit:
    """A survey of a kind, and the fit to it."""
    numbers = [Parameter(p.name, p.lower, p.upper, planning.TRUTH[p.name]) for p in FITTED]
    runs: list[Run | StreamRun] = []
    loss = "linear"
    if kind in KINDS[:2]:
        runs += planning.surveyed(config, RUNS, rng)
        if kind == KINDS[1]:
            place, loss = int(rng.integers(RUNS)), "cauchy"
            wrong = planning.surveyed(config, RUNS, rng)[place]
            runs[place] = replace(wrong, recovery=wrong.recovery * LOW)
    else:
        survey = measured(config, products(config), rng, by_class=kind == KINDS[2])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # gross errors by chance
            runs += stream_runs(survey, config)
    return calibrate(runs, numbers, starts=1, leave_out=False, loss=loss).fit


def coverage(kind: str, surveys: int, seed: int = 0) -> Array:
    """Share of the surveys whose 95 % intervals hold the truth, by number."""
    config = ScreenConfig.load(planning.SCREEN).with_values(planning.TRUTH)
    truth = np.array([planning.TRUTH[p.name] for p in FITTED])
    rng = np.random.default_rng(seed)
    fits = [fitted(kind, config, rng) for _ in range(surveys)]
    share: Array = np.mean([(f.lower <= truth) & (truth <= f.upper) for f in fits], axis=0)
    return share


def named(surveys: int, runs: int = RUNS, seed: int = 0) -> Array:
    """Shares of surveys in which a scale that reads too high is named, and of false alarms.

    Named at all, of these beside another scale that would explain the readings as well.
    """
    config = ScreenConfig.load(planning.SCREEN).with_values(planning.TRUTH)
    streams, rng = products(config, runs), np.random.default_rng(seed)
    counts = np.zeros(len(TOLD))
    for k in range(surveys):
        name = ("feed", "undersize", "oversize")[k % 3]
        wrong = measured(config, streams, rng, by_class=False, factor={name: HIGH})
        said = " ".join(reconcile(wrong).gross_errors)
        right = measured(config, streams, rng, by_class=False)
        here = f"{name} read" in said
        false = reconcile(right).gross_errors
        counts += [here, here and "or those of" in said, len(false) > 0]
    found: Array = counts / surveys
    return found


def text_of(held: Mapping[str, Array], scales: Mapping[int, Array], surveys: int) -> str:
    """Section of VALIDATION.md from shares by kind, and by number of runs."""
    names = tuple(p.name for p in FITTED)
    chance = 2.0 * (0.95 * 0.05 / surveys) ** 0.5
    covered = [(kind, *(f"{share:.3f}" for share in row)) for kind, row in held.items()]
    told = [(f"{runs}", *(f"{share:.3f}" for share in row)) for runs, row in scales.items()]
    return f"""\
Data: made up. {surveys} surveys of each kind, of {RUNS} runs of the quarry screen with known
numbers; two are fitted back. Recoveries have errors of {planning.NOISE}; of one gross error the
recoveries of a run are a third too low, and Cauchy's loss is used; streams by class are
{BY_CLASS:.0%} uncertain; scales {SCALE:.0%} and sieves {SIEVE * 100:.1f} points.
How often 95 % intervals hold the truth (target: .90 to .98; chance leaves 0.950 +- {chance:.3f} to
intervals that are right):

{table(("kind", *names), covered)}
Of `vibroscreen reconcile`, {RECONCILED} surveys with a scale {HIGH - 1.0:.0%} high, and as many
without an error: how often that scale is named (target: .90), how often beside another scale that
would explain the readings as well, and how often an error is told where there is none (at most
.05):

{table(("runs", *TOLD), told)}"""


def write(pictures: Path) -> str:
    """Section of VALIDATION.md."""
    held = {kind: coverage(kind, SURVEYS) for kind in KINDS}
    scales = {runs: named(RECONCILED, runs) for runs in (RUNS, 6)}
    return text_of(held, scales, SURVEYS)


SECTION = Section(
    "Surveys", f"python engine/validation/survey_coverage.py --surveys {SURVEYS}", write
)


def main(
    surveys: Annotated[int, typer.Option(help="Made up of each kind.")] = 4,
    kinds: Annotated[list[str] | None, typer.Option("--kind", help="Of these only.")] = None,
) -> pd.DataFrame:
    """Print the coverage of each kind, as it is found, and how often scales are named."""
    wanted: Collection[str] = kinds or (*KINDS, NAMED)
    rows = {}
    for kind in (kind for kind in KINDS if kind in wanted):
        rows[kind] = coverage(kind, surveys)
        shown = zip(FITTED, rows[kind], strict=True)
        print(f"{kind}:", ", ".join(f"{p.name} {share:.3f}" for p, share in shown), flush=True)
    chance = 2.0 * (0.95 * 0.05 / surveys) ** 0.5
    print(f"of {surveys} surveys of each kind; chance leaves 0.950 +- {chance:.3f}")
    for runs in (RUNS, 6) if NAMED in wanted else ():
        told = zip(TOLD, named(surveys * RECONCILED // SURVEYS, runs), strict=True)
        print(f"{NAMED}, {runs} runs:", ", ".join(f"{what} {share:.3f}" for what, share in told))
    return pd.DataFrame(rows, index=[p.name for p in FITTED]).T


if __name__ == "__main__":
    typer.run(main)
