"""Which vibration, slope and mesh do the duty of 300 t/h with the least power, and what is gained?

12.0 Hz, a stroke of 9.8 mm, 3.8 degrees and a mesh of 18 mm: 6.3 kW, the default draws 11.7 kW,
46 % less, at an efficiency of 93.0 % (default 93.2 %). Held by: deck[1].efficiency at least 0.93;
motion.frequency_hz from 12. The undersize is 0/18 then, 0/16 today.

The search is searches/quarry.toml: a particle swarm over frequency, stroke, slope and a catalogue
of meshes for the screen of screens/quarry.toml. At least 93 % of the undersize of the mesh has to
pass, at an acceleration of at most 5.5 g. What is found was solved again at a tolerance of 1e-5.
`vibroscreen design` does the same on the command line.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pandas as pd
import typer

from vibroscreen import Screen, ScreenConfig, SteadyResult
from vibroscreen.design import Found, Search, search
from vibroscreen.units import KW, MM, PERCENT, T_H

HERE = Path(__file__).resolve()
SEARCH = Search.load(HERE.with_name("searches") / "quarry.toml")


def default() -> SteadyResult:
    """The screen as its file says, under its duty."""
    assert isinstance(SEARCH.subject, ScreenConfig)
    return Screen(SEARCH.subject.with_values({"solver.tolerance": 1e-5})).solve_steady()


def compared(found: Found, today: SteadyResult) -> pd.DataFrame:
    """What the search changed, and what came of it, beside the default."""
    best, config = found.nearest, SEARCH.subject
    assert isinstance(config, ScreenConfig)
    panel, deck = config.decks[0].panels[0], today.decks[0]
    rows = {
        "frequency, Hz": (config.motion.frequency, best["motion.frequency_hz"]),
        "stroke, mm": (2.0 * config.motion.amplitude / MM, best["motion.stroke_mm"]),
        "mesh, mm": (panel.aperture / MM, best["deck[1].panel[1].aperture_mm"]),
        "efficiency, %": (deck.efficiency / PERCENT, best["deck[1].efficiency"] / PERCENT),
        "undersize, t/h": (today.undersize.mass_flow_rate / T_H, best["undersize_t_h"]),
        "K": (today.acceleration_number, best["K"]),
        "power, kW": (today.drive_power / KW, best["drive_power_kw"]),
    }
    return pd.DataFrame(rows, index=["default", "found"], dtype=float).T


def answer(found: Found, today: SteadyResult) -> str:
    """The answer to the question at the top."""
    if found.best.empty:
        return f"None: {found.why}."
    best, table = found.nearest, compared(found, today)
    (passed, passes), (was, power) = table.loc[["efficiency, %", "power, kW"]].to_numpy()
    return (
        f"{best['motion.frequency_hz']:.1f} Hz, a stroke of {best['motion.stroke_mm']:.1f} mm, "
        f"{best['deck[1].panel[1].inclination_deg']:.1f} degrees and a mesh of "
        f"{best['deck[1].panel[1].aperture_mm']:.0f} mm: {power:.1f} kW, the default draws "
        f"{was:.1f} kW, {(1.0 - power / was) / PERCENT:.0f} % less, at an efficiency of "
        f"{passes:.1f} % (default {passed:.1f} %). "
        f"Held by: {'; '.join(found.binding)}."
    )


def draw(found: Found, today: SteadyResult, path: Path) -> None:
    """The least power by the designs that were solved."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.4, 3.6), layout="constrained")
    axes = figure.subplots()
    met = found.history[found.history["missed"] <= 0.0]
    axes.plot(met["evaluations"], met["cost"], "o-", ms=3, label="best that meets all conditions")
    axes.axhline(today.drive_power / KW, color="0.4", ls="--", label="default")
    axes.set(xlabel="designs solved", ylabel="drive power, kW", ylim=(0.0, None))
    axes.set_title(SEARCH.name)
    axes.legend()
    figure.savefig(path, dpi=110)


def main(
    picture: Annotated[bool, typer.Option("--plot/--no-plot", help="Draw the picture.")] = True,
) -> Found:
    """Search; print what was found beside the default, draw the search."""
    found, today = search(SEARCH), default()
    if picture:
        draw(found, today, HERE.with_suffix(".png"))
    print(compared(found, today).round(2).to_string())
    print(answer(found, today))
    return found


if __name__ == "__main__":
    typer.run(main)
