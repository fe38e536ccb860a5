"""`vibroscreen reconcile`: streams of a survey that balance."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Annotated, Any

import typer

from vibroscreen.cli.options import Json
from vibroscreen.cli.terminal import say, table, tell, written
from vibroscreen.errors import InputError
from vibroscreen.sieves import COARSER
from vibroscreen.survey.read import read_sheets
from vibroscreen.survey.reconcile import Noise, Reconciled, Reconciliation, reconcile
from vibroscreen.units import MM, PERCENT, T_H

EXAMPLES = """vibroscreen reconcile survey.xlsx
vibroscreen reconcile survey.csv --scale-pct 2 --output streams.csv"""
# Adjustments that are shown, the largest tests first.
SHOWN = 8


def command(
    survey: Annotated[
        Path, typer.Argument(metavar="SURVEY", help="Sheets of streams (CSV or XLSX).")
    ],
    scale_pct: Annotated[
        float, typer.Option(help="Standard error of a rate that comes without, in % of it.")
    ] = Noise.scale / PERCENT,
    sieve_points: Annotated[
        float, typer.Option(help="Standard error of a share that passes, in points of per cent.")
    ] = Noise.sieve / PERCENT,
    class_pct: Annotated[
        float, typer.Option(help="Standard error of a rate given by class, in % of it.")
    ] = Noise.class_rate / PERCENT,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write the streams by class as CSV."),
    ] = None,
    json_: Json = False,
) -> None:
    """Make the streams of a survey balance, tell gross errors."""
    sheets = read_sheets(survey)
    noise = Noise(scale_pct * PERCENT, sieve_points * PERCENT, class_pct * PERCENT)
    try:
        found = reconcile(sheets, noise)
    except InputError as error:
        error.add_note(f"in {survey}")
        raise
    if output is not None:
        output.write_text(_text(found), encoding="utf-8")
        written(output)
    if json_:
        print(json.dumps(_tree(found), indent=2))
        return
    for run in found.runs:
        _print(run)
    worst = sorted(found.measurements, key=lambda one: -abs(one.test))[:SHOWN]
    table(
        "Adjustments, the most telling first",
        ("measured", "adjusted by", "test", "redundancy"),
        [
            (str(m), f"{m.adjustment:+.2f} sigma", f"{m.test:+.2f}", f"{m.redundancy:.2f}")
            for m in worst
        ],
    )
    if found.scales:
        table(
            "Scales",
            ("rates of", "read by", "standard error", "test"),
            [
                (s.stream, f"{s.factor:.3f}", f"{s.error:.3f}", f"{s.test:+.2f}")
                for s in found.scales
            ],
        )
    say(
        f"{found.squares:.1f} squared sigmas for a redundancy of {found.freedom}; good "
        f"measurements do no better in {found.chance / PERCENT:.3g} % of surveys"
    )
    if not found.gross_errors:
        say("No gross error is found.")
    for note in found.notes:
        tell(f"note: {note}")
    for warning in found.warnings:
        tell(f"warning: {warning}", "yellow")


def _print(run: Reconciled) -> None:
    """Streams of a run, coarsest class first, with their standard errors."""
    names = ("feed", *run.products)
    rows = [
        (_span(low, high), *(_rate(run, name, k) for name in names))
        for k, (low, high) in reversed(
            list(enumerate(zip(run.edges[:-1], run.edges[1:], strict=True)))
        )
    ]
    totals = [f"{run.rates[name].sum() / T_H:.4g}" for name in names]
    table(f"{run.name}, t/h", ("mm", *names), [*rows, ("all", *totals)])


def _span(low: float, high: float) -> str:
    return f"> {low / MM:.4g}" if math.isinf(high) else f"{low / MM:.4g} - {high / MM:.4g}"


def _rate(run: Reconciled, name: str, k: int) -> str:
    if not run.determined[name][k]:
        return "not determined"
    rate, error = run.rates[name][k] / T_H, run.error[name][k] / T_H
    return f"{rate:.4g} \u00b1{error:.2g}" if error > 0.0 else f"{rate:.4g}"


def _text(found: Reconciliation) -> str:
    """Streams by class as `read_sheets` takes them."""
    streams = [name.replace("[", "_").replace("]", "") for name in found.runs[0].rates]
    lines = [",".join(("run", "lower_mm", "upper_mm", *(f"{name}_t_h" for name in streams)))]
    for run in found.runs:
        for k, (low, high) in enumerate(zip(run.edges[:-1], run.edges[1:], strict=True)):
            if math.isinf(high):  # a limit of ISO 565 stands for none
                coarser = (size * MM for size in COARSER if size * MM > 1.2 * low)
                high = next(coarser, 1.4 * low)
            rates = (f"{float(rates[k]) / T_H!r}" for rates in run.rates.values())
            lines.append(
                ",".join((_quoted(run.name), f"{low / MM:.9g}", f"{high / MM:.9g}", *rates))
            )
    return "\n".join(lines) + "\n"


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if set(name) & set(',"') else name


def _tree(found: Reconciliation) -> dict[str, Any]:
    """All that was found, SI units."""
    return {
        "runs": [
            {
                "run": run.name,
                "edges": [None if math.isinf(edge) else edge for edge in run.edges],
                "streams": {
                    name: {
                        "rate": rates.tolist(),
                        "error": run.error[name].tolist(),
                        "determined": run.determined[name].tolist(),
                    }
                    for name, rates in run.rates.items()
                },
            }
            for run in found.runs
        ],
        "measurements": found.measurement_frame().to_dict("records"),
        "scales": [vars(scale) for scale in found.scales],
        "squares": found.squares,
        "redundancy": found.freedom,
        "chance": found.chance,
        "gross_errors": list(found.gross_errors),
        "undetermined": list(found.undetermined),
        "notes": list(found.notes),
    }
