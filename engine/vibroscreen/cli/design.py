"""`vibroscreen design`: search for the best screen or circuit."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from vibroscreen.cli.options import Json, Plot, Scheduler, cluster
from vibroscreen.cli.terminal import picture, progress, row_of, say, say_json, table, written
from vibroscreen.design import Found, Search, search
from vibroscreen.report.pictures import COLOURS, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXAMPLES = """vibroscreen design search.toml
vibroscreen design search.toml --output kept --plot search.png
vibroscreen design search.toml --csv front.csv"""


def command(
    search_file: Annotated[
        Path,
        typer.Argument(
            metavar="SEARCH", help="What may change, what must hold, what is wanted (TOML)."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Where what was solved is kept: a search that was ended goes on there.",
        ),
    ] = None,
    scheduler: Scheduler = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="The designs that were found.")
    ] = None,
    as_json: Json = False,
    plot: Plot = None,
) -> None:
    """Search for the best design of a screen or a circuit."""
    what = Search.load(search_file)
    with ExitStack() as stack:
        executor = cluster(scheduler, stack)
        advance = stack.enter_context(progress(f"{what.generations} generations"))
        found = search(what, folder=output, executor=executor, progress=advance)
    if csv is not None:
        found.best.to_csv(csv, index=False)
        written(csv)
    if plot is not None:
        picture(_drawn(found), plot)
    if as_json:
        told = {
            "name": what.name,
            "evaluations": found.evaluations,
            "why": found.why,
            "binding": list(found.binding),
            "best": [row_of(row.to_dict()) for _, row in found.best.iterrows()],
        }
        say_json(told)
    else:
        _print(found)
    if found.best.empty:
        raise typer.Exit(code=1)


def _print(found: Found) -> None:
    what = found.search
    say(f"{what.name}: {found.evaluations} designs by {what.algorithm}", "bold")
    say()
    if found.best.empty:
        say(f"Infeasible: {found.why}", "yellow")
    keys = [key for variable in what.variables for key in variable.keys]
    asked = [goal.of for goal in what.goals] + [condition.of for condition in what.conditions]
    names = list(dict.fromkeys([*keys, *asked]))
    shown = found.best if len(what.goals) > 1 and len(found.best) else found.nearest.to_frame().T
    places = np.linspace(0, len(shown) - 1, min(len(shown), 4)).astype(int)
    columns = [shown.iloc[place] for place in places]
    head = "The best" if not found.best.empty else "The nearest"
    several = len(what.goals) > 1 and not found.best.empty
    title = f"{len(found.best)} designs that none beats, such as" if several else head
    table(
        f"{title}, solved to 1e-5",
        ("", *("" for _ in columns)),
        [(name, *(f"{float(column[name]):.5g}" for column in columns)) for name in names],
    )
    if several:
        return
    say()
    for text in found.binding:
        say(f"held by {text}")
    if len(found.sensitivity):
        say()
        table(
            "What 1 % of a range changes",
            ("", "", *(str(name) for name in found.sensitivity)),
            [
                (str(key), str(step), *(f"{value:+.3g}" for value in row))
                for (key, step), row in zip(
                    found.sensitivity.index, found.sensitivity.to_numpy(), strict=True
                )
            ],
            left=2,
        )


def _drawn(found: Found) -> Figure:
    """The front of two goals, or how the best design came about."""
    from matplotlib.figure import Figure

    what = found.search
    with styled():
        figure = Figure(figsize=(7.4, 4.2), layout="constrained")
        axes = figure.subplots()
        if len(what.goals) > 1:
            across, up = (goal.of for goal in what.goals[:2])
            axes.plot(found.best[across], found.best[up], "o", color=COLOURS[0])
            axes.set(xlabel=across, ylabel=up, title=f"{what.name[:60]}: none beats these")
            return figure
        goal = what.goals[0]
        cost = found.history["cost"].where(np.isfinite(found.history["cost"]))
        sign = 1.0 if goal.minimise else -1.0
        axes.plot(found.history["evaluations"], sign * cost, color=COLOURS[0])
        axes.set(xlabel="designs solved", ylabel=f"best {goal.of}", title=what.name[:80])
        return figure
