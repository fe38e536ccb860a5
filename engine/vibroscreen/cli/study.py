"""`vibroscreen study`: designs of a circuit, the one of least energy, and what cannot be run."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer

from vibroscreen.circuit import solve_circuit
from vibroscreen.circuit.results import CLOSED
from vibroscreen.cli.options import Json, Plot, Scheduler, cluster
from vibroscreen.cli.terminal import picture, progress, row_of, say, say_json, table, tell, written
from vibroscreen.study import Study, collect, run, settle
from vibroscreen.study.pictures import ENERGY, best_of, draw_study

EXAMPLES = """vibroscreen study study.toml
vibroscreen study study.toml --output results --plot map.png
vibroscreen study study.toml --output shared --part 1/4
vibroscreen study study.toml --scheduler tcp://127.0.0.1:8786"""

SHOWN = ("circulating load, %", ENERGY)


def command(
    study: Annotated[
        Path, typer.Argument(metavar="STUDY", help="A circuit, and what is varied of it (TOML).")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Where parts are kept; a run goes on there. By default beside the study.",
        ),
    ] = None,
    part: Annotated[
        str,
        typer.Option(metavar="K/N", help="Solve every Nth part from the Kth on, for job arrays."),
    ] = "1/1",
    scheduler: Scheduler = None,
    check: Annotated[
        bool, typer.Option("--check/--no-check", help="Run the best one through time as well.")
    ] = True,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="All designs as CSV.")
    ] = None,
    as_json: Json = False,
    plot: Plot = None,
) -> None:
    """Find the design of a circuit that needs the least energy."""
    plan = Study.load(study)
    folder = output or study.with_suffix("")
    share = _part(part)
    with ExitStack() as stack:
        executor = cluster(scheduler, stack)
        advance = stack.enter_context(progress(f"{plan.count} designs"))
        run(plan, folder, executor=executor, part=share, progress=advance)
    if share[1] > 1:
        tell(f"part {part} is in {folder}; with all there: vibroscreen study {study} -o {folder}")
        return
    found = collect(plan, folder)
    best = best_of(found)
    settled = None
    if best is not None:
        values = {key: np.array([found[key][best]]) for key in plan.table()}
        circuit = plan.circuit.with_values({n: v[0] for n, v in plan.values(values).items()})
        again = solve_circuit(circuit)
        settled = settle(circuit) if check else None
    if csv is not None:
        found.to_csv(csv)
        written(csv)
    if plot is not None:
        picture(draw_study(plan, found), plot)
    if as_json:
        told = {
            "name": plan.name,
            "designs": len(found),
            "status": found["status"].value_counts().to_dict(),
            "best": None
            if best is None
            else {"design": best, **row_of(found.iloc[best].to_dict())},
        }
        say_json(told)
        return
    say(f"{plan.name}: {len(found)} designs of {plan.circuit.name}", "bold")
    say()
    _tell_status(found)
    if best is None:
        say("No design can be run and keeps to its specification", "yellow")
        return
    say()
    rows = [(name, _shown(found[name][best])) for name in found.columns if name != "reason"]
    table(f"Of least energy: design {best}", ("", ""), rows)
    say()
    energy = float(again.frame()[ENERGY][0])
    say(f"Solved again at the tolerance of its file: {energy:.4g} kWh/t, {again.status[0]}")
    if settled is not None:
        say(
            f"Run from empty for {settled.time / 60:.0f} min: {settled.energy:.4g} kWh/t over the "
            f"last ten, balance within {abs(settled.balance_error):.0e} of the feed"
        )


def _tell_status(found: pd.DataFrame) -> None:
    """How many designs can be run, and the commonest reason of the others."""
    rows = []
    for status, these in found.groupby("status", sort=True):
        example = ""
        if status != CLOSED:
            example = f"such as design {these.index[0]}: {these['reason'].iloc[0]}"
        rows.append((str(status), str(len(these)), example))
    for status, count, example in rows:
        say(f"{count:>7} {status}{', ' + example if example else ''}")
    outside = (found["status"] == CLOSED) & ~np.isfinite(found[ENERGY])
    if outside.any():
        say(f"{outside.sum():>7} of the closed ones make nothing within the band of the product")


def _shown(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _part(text: str) -> tuple[int, int]:
    first, slash, last = text.partition("/")
    if not slash or not first.isdigit() or not last.isdigit() or not 1 <= int(first) <= int(last):
        raise typer.BadParameter(
            f"{text!r} is not K/N with K from 1 to N: write --part 1/4", param_hint="--part"
        )
    return int(first), int(last)
