"""How many runs must a survey have to calibrate the quarry screen?

A screen whose numbers are known is surveyed at several feed rates, every recovery with a random
error; passage velocity, percolation velocity and dilation are fitted back. Forty surveys of each
kind say how wide the 95 % intervals are, whether they hold the truth in 95 of 100 cases, and when
the data are too few. The survey `data/quarry_survey.csv` is one of them, for the command

    vibroscreen calibrate engine/validation/data/quarry_survey.csv \
        plant_examples/screens/quarry.toml

Run `python engine/validation/survey_planning.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from evidence import DATA, SCREENS, Section, table
from vibroscreen import ScreenConfig, solve_steady_many
from vibroscreen.calibrate import Calibration, Fit, Parameter, Run, calibrate
from vibroscreen.survey import read_survey
from vibroscreen.units import MM, T_H

Array = NDArray[np.float64]

SCREEN = SCREENS / "quarry.toml"
SURVEY = DATA / "quarry_survey.csv"

# The truth: what the engine has when it follows Karra's curves (engineering_rules.py), rounded.
TRUTH = {
    "passage.relative_velocity": 0.85,
    "segregation.relative_velocity": 0.04,
    "segregation.relative_dilation": 0.45,
}
PARAMETERS = (
    Parameter("passage.relative_velocity", 0.05, 10.0),
    Parameter("segregation.relative_velocity", 1e-3, 1.0),
    Parameter("segregation.relative_dilation", 0.01, 5.0),
)
NOISE = 0.02  # standard error of a recovery
SLOWEST, FASTEST = 200.0 * T_H, 800.0 * T_H
COUNTS = (1, 2, 4, 8)  # runs of a survey
SURVEYS = 40
SEED = 4  # of the survey in the data folder
ENOUGH = 2.5  # upper over lower limit of an interval


@dataclass(frozen=True)
class Plan:
    """What surveys of so many runs gave: a fit each."""

    runs: int
    fits: tuple[Fit, ...]

    @property
    def spread(self) -> Array:
        """Median of upper over lower limit of the 95 % interval, by parameter."""
        spread: Array = np.median([fit.upper / fit.lower for fit in self.fits], axis=0)
        return spread

    @property
    def covered(self) -> Array:
        """Share of the surveys whose interval holds the truth, by parameter."""
        truth = np.array(list(TRUTH.values()))
        inside = [(fit.lower <= truth) & (truth <= fit.upper) for fit in self.fits]
        share: Array = np.mean(inside, axis=0)
        return share

    @property
    def warned(self) -> float:
        """Share of the surveys whose fit warns."""
        return float(np.mean([len(fit.warnings) > 0 for fit in self.fits]))


def surveyed(config: ScreenConfig, count: int, rng: np.random.Generator) -> list[Run]:
    """Runs at feed rates from slowest to fastest, recoveries of the true screen with errors."""
    rates = np.geomspace(SLOWEST, FASTEST, count) if count > 1 else np.array([400.0 * T_H])
    recovery = solve_steady_many(config.with_values(TRUTH), {"feed.mass_flow_rate": rates}).recovery
    passes = config.size_classes.upper <= config.decks[0].panels[0].aperture
    measured = np.where(passes, recovery + NOISE * rng.standard_normal(recovery.shape), np.nan)
    return [
        Run(f"{rate / T_H:.0f} t/h", config.with_values({"feed.mass_flow_rate": rate}), row)
        for rate, row in zip(rates, measured, strict=True)
    ]


def survey_text(runs: list[Run]) -> str:
    """A survey as a CSV file."""
    lines = [
        "# Four runs of the quarry screen, not measured: made up by survey_planning.py with",
        f"# {', '.join(f'{name} {value:g}' for name, value in TRUTH.items())}",
        f"# and random errors of {NOISE:g}.",
        "run,lower_mm,upper_mm,rate_t_h,feed_fraction,recovery",
    ]
    for run in runs:
        config = run.config
        classes = config.size_classes
        for k, recovery in enumerate(run.recovery):
            cells = (
                run.name,
                f"{classes.lower[k] / MM:g}",
                f"{classes.upper[k] / MM:g}",
                f"{config.feed.mass_flow_rate / T_H:.1f}",
                f"{config.feed.mass_fraction[k]:.6f}",
                "" if np.isnan(recovery) else f"{recovery:.4f}",
            )
            lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def study(surveys: int = SURVEYS) -> list[Plan]:
    """Fit many surveys of each number of runs."""
    config, rng = ScreenConfig.load(SCREEN), np.random.default_rng(20)
    parameters = tuple(replace(p, start=TRUTH[p.name]) for p in PARAMETERS)
    fits: dict[int, list[Fit]] = {count: [] for count in COUNTS}
    plan = [count for count in COUNTS for _ in range(surveys)]
    for count in track(plan, "surveys", transient=True):
        runs = surveyed(config, count, rng)
        fits[count].append(calibrate(runs, parameters, starts=1, leave_out=False).fit)
    return [Plan(count, tuple(found)) for count, found in fits.items()]


def calibrated() -> Calibration:
    """The survey of the data folder on the screen of the file, as the command line does it."""
    return calibrate(read_survey(SURVEY, ScreenConfig.load(SCREEN)), PARAMETERS)


def frame_of(plans: list[Plan]) -> pd.DataFrame:
    """A row a number of runs: median interval (upper over lower) and coverage by parameter."""
    rows = []
    for plan in plans:
        row: dict[str, float] = {"runs": plan.runs}
        for name, spread, covered in zip(TRUTH, plan.spread, plan.covered, strict=True):
            row[f"{name}: interval, factor"] = spread
            row[f"{name}: holds the truth"] = covered
        rows.append(row | {"fits that warn": plan.warned})
    return pd.DataFrame(rows).set_index("runs")


def write(pictures: Path) -> str:
    """Section of VALIDATION.md."""
    from vibroscreen.report import draw_calibration

    plans, one = study(), calibrated()
    draw_calibration(one, pictures / "calibration.png")
    frame = frame_of(plans)
    rows = [
        (f"{count:g}", *(f"{value:.3g}" if value < 100.0 else "> 100" for value in row))
        for count, row in frame.iterrows()
    ]
    fit = one.fit
    fitted = [
        (p.name, f"{TRUTH[p.name]:.3g}", f"{v:.3g}", f"{low:.3g} to {high:.3g}")
        for p, v, low, high in zip(fit.parameters, fit.value, fit.lower, fit.upper, strict=True)
    ]
    warnings = "".join(f"- {warning}\n" for warning in fit.warnings) or "- none\n"
    return f"""\
Data: made up. The quarry screen with known numbers is surveyed at feeds of {SLOWEST / T_H:.0f} to
{FASTEST / T_H:.0f} t/h, recoveries with a random error of {NOISE}; three numbers are fitted back.
{SURVEYS} surveys of each number of runs, started at the truth:

{table(("runs", *frame.columns), rows)}
An interval should hold the truth in 95 of 100 cases; with {SURVEYS} surveys the share is uncertain
by 0.07 (95 %). Intervals are those of linear regression at the optimum: where they are wide, as
from one run, they are no more than a sign that the survey is too small, and the fit says so.

One survey of four runs, `data/quarry_survey.csv`, from eight starts: RMSE
{fit.rmse:.4f}, each run left out {fit.held_out_rmse:.4f} (noise {NOISE}).

{table(("number", "truth", "fitted", "95 %"), fitted)}
Warnings of that fit:

{warnings}
![Measured against modelled recoveries](calibration.png)
"""


SECTION = Section("Calibration", "python engine/validation/survey_planning.py", write)


def main(
    surveys: Annotated[int, typer.Option(help="Surveys of each number of runs.")] = SURVEYS,
) -> pd.DataFrame:
    """Fit the surveys and say how many runs are enough."""
    frame = frame_of(study(surveys))
    console = Console(width=120)
    console.print(frame.T.round(2))
    enough = frame[frame.filter(like="factor").max(axis=1) < ENOUGH].index
    said = f"{enough[0]:g} runs fix" if len(enough) else "None of these surveys fixes"
    console.print(f"{said} all three numbers to an interval of a factor of {ENOUGH:g} (95 %).")
    return frame


if __name__ == "__main__":
    typer.run(main)
