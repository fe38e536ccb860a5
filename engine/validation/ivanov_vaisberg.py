"""Does the engine meet the experiments of Ivanov and Vaisberg, and the paper's own models?

Table 1 of "Screen separation: computational model building experience" has four experiments, two
apertures at two capacities each, with recoveries by class measured and by the paper's three
versions. Each version is rebuilt and fitted by itself, and so is ours: the improved separation with
the classes split. Then each experiment, and each aperture, is left out of the fit and predicted.

What the paper does not say and had to be assumed, the same for all versions:

- deck 0.3 x 0.6 m, 40 % open, bed at 0.1 m/s, 1600 kg/m3, all scaled away by the fitted velocities
  but the depth of the bed: 10 mm at 1.76 t/h;
- top size 4 mm: there a Rosin-Rammler line through the two coarsest sieves reaches 95 %;
- contact layer and layers above 4 mm deep: one coarsest grain.

Run `python engine/validation/ivanov_vaisberg.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from evidence import DATA, PICTURES, Section, table
from vibroscreen import ScreenConfig
from vibroscreen.calibrate import Calibration, Parameter, Run, calibrate
from vibroscreen.sections import Bed, Deck, Displacement, Panel, Passage, Segregation, Solver
from vibroscreen.size_classes import SizeClasses
from vibroscreen.stream import Feed
from vibroscreen.units import MM, PERCENT, T_H

Array = NDArray[np.float64]

TABLE_1 = DATA / "ivanov_vaisberg_table1.csv"
PAPER = ("original", "improved_screening", "improved_separation")

TOP_SIZE = 4.0 * MM
LAYER = 4.0 * MM
WIDTH, LENGTH, OPEN_AREA, VELOCITY = 0.3, 0.6, 0.40, 0.1

WIDE, FINE = ("1", "2"), ("3", "4")  # experiments with 0.63 and 0.315 mm openings
U_WIDE = Parameter("u at 0.63 mm, m/s", 1e-4, 10.0, 0.05, sets=("passage.velocity",), runs=WIDE)
U_FINE = Parameter("u at 0.315 mm, m/s", 1e-4, 10.0, 0.05, sets=("passage.velocity",), runs=FINE)
CHI = Parameter("segregation.proportion", 0.0, 1.0, 0.5, scale="linear")
W = Parameter("segregation.velocity", 1e-4, 1.0, 2e-3)
DILATION = Parameter("segregation.dilation", 1e-6, 2e-2, 1e-3)
DEPTH = Parameter(
    "bed.contact_depth", 1.0 * MM, 9.0 * MM, LAYER, sets=("bed.contact_depth", "bed.layer_depth")
)


@dataclass(frozen=True)
class Version:
    """A model of the screen and the numbers that are fitted to all four experiments together."""

    law: str
    segregation: str
    subdivision: int
    parameters: tuple[Parameter, ...]


VERSIONS = {
    "original": Version("gaudin", "proportional", 1, (U_WIDE, U_FINE, CHI)),
    "improved screening": Version("pelevin", "proportional", 1, (U_WIDE, U_FINE, CHI)),
    "improved separation": Version("pelevin", "exchange", 1, (U_WIDE, U_FINE, W, DILATION)),
    "ours": Version("pelevin", "exchange", 0, (U_WIDE, U_FINE, W, DILATION)),
}
OURS = VERSIONS["ours"]

# How u is carried from one aperture to another: u = c (a/0.5 mm)^n. n = -1: a grain on its way over
# the deck has one try at every opening it meets, and meets them in proportion to 1/a; n = 1/2: the
# table that is shipped, u = 0.25 sqrt(g a); n = 0: the same u.
CARRIED = {"u ~ 1/a": -1.0, "u constant": 0.0, "u ~ sqrt(a)": 0.5}
U_SCALE = Parameter("u at 0.5 mm, m/s", 1e-4, 10.0, 0.05, sets=())


def experiments() -> pd.DataFrame:
    """Table 1 by experiment and class, finest first; fractions."""
    return pd.read_csv(TABLE_1, comment="#", dtype={"experiment": str})


def edges_of(part: pd.DataFrame, top_size: float) -> tuple[float, ...]:
    """Limits of the classes of an experiment [m]: 0, the sieves, the top size assumed."""
    sieves = [float(name.split("+")[0].lstrip("-")) * MM for name in part["class_mm"][:-1]]
    return (0.0, *sieves, top_size)


def rosin_rammler_top(part: pd.DataFrame) -> float:
    """Size [m] at which a Rosin-Rammler line through the two coarsest sieves reaches 95 %."""
    sieves = np.log(edges_of(part, TOP_SIZE)[-3:-1])
    passing = part["content_pct"].to_numpy().cumsum()[-3:-1] * PERCENT
    ordinate = np.log(-np.log1p(-passing))
    slope = np.diff(ordinate)[0] / np.diff(sieves)[0]
    size = sieves[1] + (np.log(-np.log(0.05)) - ordinate[1]) / slope
    return float(np.exp(size))


def runs_of(
    version: Version,
    top_size: float = TOP_SIZE,
    layer: float = LAYER,
    velocity: float = VELOCITY,
    by_aperture: bool = False,
) -> list[Run]:
    """The four experiments as runs of a version; classes coarser than the aperture say nothing."""
    runs = []
    for name, part in experiments().groupby("experiment"):
        aperture = float(part["aperture_mm"].iloc[0]) * MM
        edges = edges_of(part, top_size)
        config = ScreenConfig(
            SizeClasses(edges, version.subdivision),
            decks=(Deck(WIDTH, (Panel(LENGTH, 0.0, aperture, OPEN_AREA),)),),
            displacement=Displacement("prescribed", velocity),
            passage=Passage(version.law, 0.05),
            segregation=Segregation(version.segregation),
            bed=Bed(layer, layers=40),
            solver=Solver(1e-4),
            feed=Feed(
                float(part["capacity_t_h"].iloc[0]) * T_H,
                tuple(part["content_pct"] / part["content_pct"].sum()),
            ),
            name=f"experiment {name}",
        )
        passes = np.array(edges[1:]) <= aperture * (1.0 + 1e-9)
        recovery = np.where(passes, part["exp"], np.nan)
        group = f"{part['aperture_mm'].iloc[0]:g} mm" if by_aperture else ""
        runs.append(Run(str(name), config, recovery, group=group))
    return runs


def carried(exponent: float) -> Callable[[Mapping[str, float], Run], Mapping[str, float]]:
    """u of a run from the one at 0.5 mm by a power of the aperture."""

    def closure(values: Mapping[str, float], run: Run) -> Mapping[str, float]:
        aperture = run.config.decks[0].panels[0].aperture
        return {"passage.velocity": values[U_SCALE.name] * (aperture / (0.5 * MM)) ** exponent}

    return closure


@dataclass(frozen=True)
class Comparison:
    """The versions fitted to all four, ours under other assumptions, and how u is carried."""

    fits: dict[str, Calibration]
    assumptions: dict[str, Calibration]
    apertures: dict[str, Calibration]
    table: pd.DataFrame  # a row per non-trivial recovery

    @property
    def paper_rmse(self) -> dict[str, float]:
        """RMSE of the paper's columns over the same values."""
        error = {name: self.table[f"paper {name}"] - self.table["measured"] for name in PAPER}
        return {name: float(np.sqrt((e**2).mean())) for name, e in error.items()}


def compare() -> Comparison:
    """Fit everything."""
    work: dict[tuple[str, str], Callable[[], Calibration]] = {}
    for name, version in VERSIONS.items():
        work["fits", name] = partial(calibrate, runs_of(version), version.parameters)
    for name, runs in {
        "top size 3 mm": runs_of(OURS, top_size=3.0 * MM),
        "top size 5 mm": runs_of(OURS, top_size=5.0 * MM),
        "layers of 3 mm": runs_of(OURS, layer=3.0 * MM),
        "layers of 5 mm": runs_of(OURS, layer=5.0 * MM),
        "bed at 0.07 m/s": runs_of(OURS, velocity=0.07),
        "bed at 0.14 m/s": runs_of(OURS, velocity=0.14),
    }.items():
        work["assumptions", name] = partial(calibrate, runs, OURS.parameters)
    deeper = (*OURS.parameters, DEPTH)
    work["assumptions", "depth of the layers fitted too"] = partial(
        calibrate, runs_of(OURS), deeper
    )
    for name, exponent in CARRIED.items():
        three = partial(calibrate, parameters=(U_SCALE, W, DILATION), closure=carried(exponent))
        work["assumptions", name] = partial(three, runs_of(OURS))
        work["apertures", name] = partial(three, runs_of(OURS, by_aperture=True))
    found: dict[str, dict[str, Calibration]] = {"fits": {}, "assumptions": {}, "apertures": {}}
    for (kind, name), solve in track(work.items(), "fitting", transient=True):
        found[kind][name] = solve()
    data = experiments()
    rows = found["fits"]["ours"].frame()
    place = data.groupby("experiment").cumcount() + 1
    keys = pd.MultiIndex.from_arrays([data["experiment"], place])
    given = data.set_index(keys).loc[list(zip(rows["run"], rows["size_class"], strict=True))]
    result = pd.DataFrame(
        {
            "experiment": rows["run"],
            "aperture": given["aperture_mm"].to_numpy(),
            "class": given["class_mm"].to_numpy(),
            "measured": rows["measured"],
            **{f"paper {name}": given[name].to_numpy() for name in PAPER},
            **{name: fit.frame()["modelled"] for name, fit in found["fits"].items()},
            "ours, left out": rows["held_out"],
        }
    )
    return Comparison(found["fits"], found["assumptions"], found["apertures"], result)


def draw(comparison: Comparison, path: Path) -> None:
    """Recovery curves of the four experiments: measured, the paper's best, ours."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 6.4), layout="constrained")
    panels = figure.subplots(2, 2, sharey=True)
    for axes, (name, part) in zip(panels.flat, comparison.table.groupby("experiment"), strict=True):
        place = np.arange(len(part))
        axes.plot(place, part["paper improved_separation"], "s--", color="0.55", ms=4)
        axes.plot(place, part["ours"], "o-", color="C0", ms=4)
        axes.plot(place, part["ours, left out"], ":", color="C0")
        axes.plot(place, part["measured"], "kx", ms=8, mew=2)
        axes.set(title=f"experiment {name}, {part['aperture'].iloc[0]:g} mm", ylim=(0.4, 1.03))
        axes.set_xticks(place, part["class"], fontsize="small")
    panels[0, 0].legend(
        [
            "paper, improved separation",
            "ours, fitted to all four",
            "ours, this one left out",
            "measured",
        ],
        fontsize="small",
        loc="lower left",
    )
    for axes in panels[:, 0]:
        axes.set_ylabel("recovery to undersize")
    for axes in panels[1]:
        axes.set_xlabel("class, mm")
    figure.savefig(path, dpi=100)


def rows_of(comparison: Comparison) -> list[tuple[str, ...]]:
    """The table of Figure 4 with ours beside it, and the RMSE of each column."""
    frame = comparison.table
    names = list(frame.columns[3:])
    rows = [
        (f"{row['experiment']}, {row['class']}", *(f"{row[name]:.3f}" for name in names))
        for _, row in frame.iterrows()
    ]
    errors = np.sqrt(((frame[names].to_numpy() - frame[["measured"]].to_numpy()) ** 2).mean(axis=0))
    return [*rows, ("RMSE", "", *(f"{error:.4f}" for error in errors[1:]))]


def summary(comparison: Comparison) -> list[tuple[str, int, float, float]]:
    """Version, numbers fitted, RMSE on all four, RMSE with each experiment left out."""
    both = {**comparison.fits, **{f"ours, {k}": v for k, v in comparison.assumptions.items()}}
    return [
        (name, len(c.fit.parameters), c.fit.rmse, c.fit.held_out_rmse) for name, c in both.items()
    ]


def write(pictures: Path) -> str:
    """Section of VALIDATION.md."""
    comparison = compare()
    draw(comparison, pictures / "ivanov_vaisberg.png")
    head = ("experiment, class mm", *(n.replace("_", " ") for n in comparison.table.columns[3:]))
    ours = comparison.fits["ours"].fit
    three = comparison.assumptions["u ~ 1/a"].fit
    paper = comparison.paper_rmse
    values = [
        (p.name, f"{v:.3g}", f"{low:.2g} to {high:.2g}")
        for p, v, low, high in zip(ours.parameters, ours.value, ours.lower, ours.upper, strict=True)
    ]
    fits = [
        (name, count, f"{rmse:.4f}", f"{held:.4f}")
        for name, count, rmse, held in summary(comparison)
    ]
    apertures = [
        (name, f"{c.fit.rmse:.4f}", f"{c.fit.held_out_rmse:.4f}")
        for name, c in comparison.apertures.items()
    ]
    warnings = "".join(f"- {warning}\n" for warning in ours.warnings) or "- none\n"
    return f"""\
Data: Table 1 of Ivanov and Vaisberg, `data/ivanov_vaisberg_table1.csv`: 14
recoveries of classes that can pass, two apertures at two capacities. They are ratios of small
integers (5/6, 25/47), so the finest class is uncertain by about 0.1, and the first experiment is
not monotone in size: no model that is gets below 0.0143.

**Headline: each experiment left out in turn, RMSE {ours.held_out_rmse:.4f}** (target 0.046).
Fitted to all four with {len(ours.parameters)} numbers: {ours.rmse:.4f} (target 0.028). The paper's
columns, all of them fitted: {", ".join(f"{error:.4f}" for error in paper.values())}. With u ~ 1/a
three numbers do: {three.held_out_rmse:.4f} left out, {three.rmse:.4f} fitted.

![Recovery curves of the four experiments](ivanov_vaisberg.png)

{table(head, rows_of(comparison))}
Columns without "paper" are fitted by this project to all four experiments, each version by itself;
"ours, left out" is fitted to the other three. Our original and improved screening hardly differ:
what Pelevin's law adds, the fitted u takes away. The paper's second column falls below its first in
every entry, although eq. 6 only adds passage to eq. 5: its versions must have been fitted
separately, so no column is to be matched.

{table(("version", "numbers fitted", "RMSE", "RMSE, experiment left out"), fits)}
"ours" is the improved separation (exchange) with the classes split. The rows below it change one
assumption each; the assumptions were chosen with these fits in view, so the honest range of the
left-out error is that of these rows. Where the depth of the layers is fitted too, three experiments
do not fix it and the fourth is missed.

**Each aperture left out**, u carried by a law; three numbers (u at 0.5 mm, w, dilation):

{table(("u over the aperture", "RMSE, all four", "RMSE, aperture left out"), apertures)}
1/a says that a grain has one try at every opening it meets on its way. The exponent was chosen from
these three knowing the data; with a constant u the other aperture is not predicted.

Fitted, with 95 % intervals:

{table(("number", "value", "95 %"), values)}
What the fit says of itself:

{warnings}
Assumed, as the paper does not say: deck {LENGTH} x {WIDTH} m, {OPEN_AREA:.0%} open, bed at
{VELOCITY} m/s (so 10 mm deep at 1.76 t/h), top size {TOP_SIZE / MM:g} mm (Rosin-Rammler through the
two coarsest sieves reaches 95 % there), layers {LAYER / MM:g} mm deep, one coarsest grain. The
velocities belong to these assumptions.
"""


SECTION = Section("Table 1", "python engine/validation/ivanov_vaisberg.py", write)


def main(
    output: Annotated[Path, typer.Option(help="Where the picture goes.")] = (
        PICTURES / "ivanov_vaisberg.png"
    ),
    plot: Annotated[bool, typer.Option(help="Draw the picture.")] = True,
) -> Comparison:
    """Fit all versions, print the table of Figure 4 with ours beside it, draw Figure 5."""
    comparison = compare()
    console = Console(width=160)
    figures = Table("experiment, class", title="Recovery to undersize (Figure 4)")
    for name in comparison.table.columns[3:]:
        figures.add_column(name.replace("_", " "), justify="right")
    for row in rows_of(comparison):
        figures.add_row(*row)
    console.print(figures)
    fits = Table("version", "numbers", "RMSE", "RMSE, experiment left out")
    for name, count, rmse, held in summary(comparison):
        fits.add_row(name, str(count), f"{rmse:.4f}", f"{held:.4f}")
    console.print(fits)
    for name, calibration in comparison.apertures.items():
        fit = calibration.fit
        console.print(f"{name}: RMSE {fit.rmse:.4f}, aperture left out {fit.held_out_rmse:.4f}")
    console.print(comparison.fits["ours"].fit.frame())
    if plot:
        draw(comparison, output)
    ours = comparison.fits["ours"].fit
    best = min(comparison.paper_rmse.values())
    console.print(
        f"{'Yes' if ours.held_out_rmse < best else 'No'}: each experiment is predicted from the "
        f"other three with an RMSE of {ours.held_out_rmse:.3f}; the paper's best model, fitted, "
        f"has {best:.3f}."
    )
    return comparison


if __name__ == "__main__":
    typer.run(main)
