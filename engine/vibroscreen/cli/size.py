"""`vibroscreen size`: the standard size of a screen for a duty."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from vibroscreen.cli.options import Json, ScreenFile, Set, load
from vibroscreen.cli.terminal import finite, say, say_json, table, written
from vibroscreen.size import choose
from vibroscreen.sizing_rules import rules_of
from vibroscreen.units import KN, KW

EXAMPLES = """vibroscreen size duty.toml
vibroscreen size duty.toml --efficiency 0.92 -o screen.toml
vibroscreen size duty.toml --set feed.rate_t_h=450"""

SHOWN = 3  # sizes below and above the chosen one


def command(
    screen: ScreenFile,
    efficiency: Annotated[
        float, typer.Option(metavar="SHARE", help="What every deck must recover.")
    ] = 0.95,
    bed_over_aperture: Annotated[
        float | None,
        typer.Option(metavar="N", help="Deepest bed at the discharge; by default the alarm's."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="The screen of that size, as TOML."),
    ] = None,
    changes: Set = None,
    as_json: Json = False,
) -> None:
    """Choose the standard size of a screen for a duty."""
    config = load(screen, changes)
    found = choose(config, efficiency, bed_over_aperture)
    deck, steady = found.config.decks[0], found.steady
    area = deck.width * deck.length
    if output is not None:
        output.write_text(found.config.to_toml(), encoding="utf-8")
        written(output)
    if as_json:
        told = {
            "name": found.config.name,
            "width_m": deck.width,
            "length_m": deck.length,
            "area_m2": area,
            "efficiency": [float(d.efficiency) for d in steady.decks],
            "drive_power_kw": steady.drive_power / KW,
            "exciter_force_kn": steady.exciter_force / KN,
            "support_force_kn": found.support_force / KN,
            "vsma_area_m2": finite(found.vsma_area),
            "beside_vsma": found.beside_vsma,
            "karra_recovery": [finite(r.karra_recovery) for r in rules_of(found.config)],
        }
        say_json(told)
        return
    say(f"{config.name}: {deck.width:g} x {deck.length:g} m for {efficiency:.0%}", "bold")
    say()
    place = int(found.table["fits"].to_numpy().argmax())
    near = found.table.iloc[max(place - SHOWN, 0) : place + SHOWN + 1]
    decks = range(1, len(found.config.decks) + 1)
    table(
        "Sizes by area",
        (
            "m x m",
            "m2",
            *(f"deck {k}\nrecovers" for k in decks),
            *(f"deck {k} bed\napertures" for k in decks),
            "drive\nkW",
            "exciter\nkN",
            "",
        ),
        [
            (
                f"{row['width_m']:g} x {row['length_m']:g}",
                f"{row['area_m2']:.1f}",
                *(f"{row[f'deck[{k}].efficiency']:.3f}" for k in decks),
                *(f"{row[f'deck[{k}].bed_over_aperture']:.2f}" for k in decks),
                f"{row['drive_power_kw']:.1f}",
                f"{row['exciter_force_kn']:.0f}",
                "chosen" if index == place else "",
            )
            for index, row in zip(near.index, near.to_dict("records"), strict=True)
        ],
    )
    say()
    say(f"VSMA asks for {found.vsma_area:.1f} m2 at 95 %, this is {area:.1f} m2")
    if found.beside_vsma:
        say(f"  {found.beside_vsma}", "dim")
    for rules in rules_of(found.config):
        say(f"Karra expects deck {rules.deck} to recover {rules.karra_recovery:.3f}")
        for text in rules.beyond:
            say(f"  {text}", "dim")
    say(
        f"Force on the supports: {found.support_force / KN:.1f} kN each way, on springs that the "
        "weight compresses by 50 mm"
    )
    for name, reason in steady.alarm_reasons.items():
        say(f"{name}: {reason}", "yellow")
