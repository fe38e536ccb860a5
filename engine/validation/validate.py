"""How far is the engine from what was measured? Writes VALIDATION.md and its pictures.

`python engine/validation/validate.py` runs every data set anew; `--only "Table 1"` runs one and
keeps the other sections as they stand in the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

import bed_velocity
import dem_calibration
import engineering_rules
import ivanov_vaisberg
import practice_curves
import survey_coverage
import survey_planning
import typical_practice
from evidence import PICTURES, REPORT, Section

HEAD = """\
# Validation

The engine beside measurements and particle simulations: for each data set the figures, what was
fitted and what was held out. Written by `python engine/validation/validate.py`; do not edit by
hand. The command of a section gives its figures alone. Numerical verification (exact solutions,
conservation, convergence) is in [MODEL.md](../MODEL.md#verification) and `tests/`.
"""

SECTIONS: tuple[Section, ...] = (
    ivanov_vaisberg.SECTION,
    survey_planning.SECTION,
    survey_coverage.SECTION,
    bed_velocity.SECTION,
    *dem_calibration.SECTIONS,
    practice_curves.SECTION,
    engineering_rules.SECTION,
    typical_practice.SECTION,
)


def sections_of(text: str) -> dict[str, str]:
    """Body of every section of a report by its title."""
    _, *parts = ("\n" + text).split("\n## ")
    bodies = (part.partition("\n") for part in parts)
    return {title: body.strip() for title, _, body in bodies}


def report(bodies: dict[str, str]) -> str:
    """Text of the report from the bodies of its sections, in the order of SECTIONS."""
    written = (
        f"## {section.title}\n\n{bodies[section.title]}\n"
        for section in SECTIONS
        if section.title in bodies
    )
    return "\n".join([HEAD, *written])


def main(
    only: Annotated[str | None, typer.Option(help="Title of the one section to run.")] = None,
    output: Annotated[Path, typer.Option(help="Where the report goes.")] = REPORT,
    pictures: Annotated[Path, typer.Option(help="Folder of the pictures.")] = PICTURES,
) -> None:
    """Run the data sets and write the report."""
    titles = [section.title for section in SECTIONS]
    if only is not None and only not in titles:
        raise typer.BadParameter(f"{only!r} is no section: give one of {', '.join(titles)}")
    console = Console(stderr=True)
    bodies = sections_of(output.read_text(encoding="utf-8")) if only and output.exists() else {}
    pictures.mkdir(parents=True, exist_ok=True)
    for section in SECTIONS:
        if only in (None, section.title):
            console.print(f"{section.title}: {section.command}")
            text = section.write(pictures).strip()
            bodies[section.title] = f"Command: `{section.command}`\n\n{text}"
    output.write_text(report(bodies), encoding="utf-8")
    print(output)


if __name__ == "__main__":
    typer.run(main)
