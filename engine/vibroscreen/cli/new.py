"""`vibroscreen new`: the file that says what a screen is, with a comment on every key."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from vibroscreen.cli.options import Set, assignments
from vibroscreen.cli.terminal import tell, told, written
from vibroscreen.config import QUARRY_EDGES, ScreenConfig
from vibroscreen.edits import edited
from vibroscreen.errors import ConfigError, InputError
from vibroscreen.fields import Choice, Entry, Number, from_si, leaves, write_table
from vibroscreen.keys import reading
from vibroscreen.sieves import Sieves, read_sieves
from vibroscreen.sizing_rules import usual_open_area
from vibroscreen.toml_text import toml_value
from vibroscreen.units import MM, RPM, T_M3

EXAMPLES = """vibroscreen new screen.toml
vibroscreen new screen.toml --from sieves.csv --rate 250 --aperture 31.5 --aperture 8
vibroscreen new screen.toml --yes --set motion.stroke_mm=9 --set drive.efficiency=0.85"""

ENTRIES: dict[str, Entry] = dict(leaves(ScreenConfig))
# Of these a new file says everything; of the others what was set, as they have defaults.
SECTIONS = {
    "size_classes": "Limits of the size classes: the sieves of the analysis, the finest first.",
    "deck": "The machine. Decks from the top down, their panels from the feed end on.",
    "motion": "What shakes it.",
    "drive": "",
    "material": "The material, dry and loose.",
    "feed": "The duty.",
}
LEFT_OUT = ("size_classes.subdivision",)
# Where a key counts in another way than the number that it gives, or has no text.
OTHERWISE = {
    "motion.stroke_mm": "Stroke from end to end, twice the amplitude",
    "feed.rate_t_h": "Feed of dry solids to the top deck",
    "feed.passing": "Of the feed, finer than each limit of the classes",
    "feed.mass_fraction": "Share of each class in the feed",
}
HEAD = """\
A vibrating screen and its duty. Units stand in the keys. What is not written here has a default;
{left_out} have typical ones, which are no measurement of this
screen: vibroscreen calibrate fits them to a survey.
  vibroscreen check {name}    what is wrong or unusual
  vibroscreen solve {name}    products, decks, power"""
RATE, APERTURES = 300.0, "16"  # t/h, mm
LENGTH, WIDTH, INCLINATION, CIRCULAR_INCLINATION = 6.0, 2.4, 5.0, 18.0  # m, m, deg, deg
COLUMN, LINE = 30, 100


class Question(NamedTuple):
    """What is asked for a key; the answer times the factor is in the unit of the key."""

    text: str
    key: str
    usual: Any
    factor: float = 1.0


KINDS = ("linear", "circular", "elliptical")
THROW = Question("Throw angle, deg", "motion.throw_angle_deg", 45.0)
MOTION = {
    "linear": (THROW,),
    "circular": (Question("At the top of its orbit it moves", "motion.sense", "with_flow"),),
    "elliptical": (
        THROW,
        Question("Minor over major axis, above 0 with the flow", "motion.ellipticity", 0.5),
    ),
}


def command(
    screen: Annotated[Path, typer.Argument(metavar="SCREEN", help="The file to write (TOML).")],
    sieves: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="SIEVES",
            help="The sieve analysis of the feed (CSV): sizes and % passing or retained, in any "
            "order, per cent, fractions or masses. Then nothing is asked.",
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="T_H", help="Feed of dry solids, t/h.")
    ] = None,
    aperture: Annotated[
        list[float] | None,
        typer.Option(metavar="MM", help="Aperture of a deck, mm; again for more, top deck first."),
    ] = None,
    changes: Set = None,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Ask nothing, take what is usual.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", "-f", help="Write over a file that is there.")
    ] = False,
) -> None:
    """Write the file of a screen: asks, or takes a sieve analysis."""
    if screen.exists() and not force:
        raise InputError(f"{screen} is there already: give another name, or --force", "screen")
    if sieves is None and not yes:
        try:
            tree, analysis = _asked(rate, aperture)
        except typer.Abort:
            raise InputError(
                "no more answers, no file: --yes takes what is usual, --from SIEVES asks nothing",
                "screen",
            ) from None
    else:
        tree = {
            "name": screen.stem,
            **_tree(RATE if rate is None else rate, aperture or _apertures(APERTURES)),
        }
        analysis = None if sieves is None else read_sieves(sieves)
    if analysis is not None:
        tree["size_classes"]["edges_mm"] = [from_si(edge, MM) for edge in analysis.edges]
        tree["feed"]["passing"] = list(analysis.passing)
    tree = edited(ScreenConfig, tree, assignments(changes))
    config = ScreenConfig.from_dict(tree)
    screen.write_text(text_of(config, tree, screen.name), encoding="utf-8")
    for note in () if analysis is None else analysis.notes:
        tell(f"note: {note}", "yellow")
    written(screen)
    tell(f"next: vibroscreen check {screen}")


def _tree(rate: float, apertures: Sequence[float]) -> dict[str, Any]:
    """A usual screen with these decks, as a file has it: woven wire of the usual open area."""
    panels = [
        {
            "length_m": LENGTH,
            "inclination_deg": INCLINATION,
            "aperture_mm": aperture,
            "open_area": round(usual_open_area(aperture * MM), 2),
        }
        for aperture in apertures
    ]
    return {
        "size_classes": {"edges_mm": [from_si(edge, MM) for edge in QUARRY_EDGES]},
        "deck": [{"width_m": WIDTH, "panel": [panel]} for panel in panels],
        "motion": {"kind": "linear"},
        "feed": {"rate_t_h": rate},
    }


# --- questions -----------------------------------------------------------------------------------
def _asked(
    rate: float | None, apertures: Sequence[float] | None
) -> tuple[dict[str, Any], Sieves | None]:
    """The screen that the answers describe, and the sieve analysis of its feed if there is one."""
    tell("Enter takes what stands in brackets, Ctrl-C ends without a file.")
    name: str = _answer(Question("Name of the screen", "name", "my screen"))
    if rate is None:
        rate = _answer(Question("Feed of dry solids, t/h", "feed.rate_t_h", RATE))
    sieves = _ask("Sieve analysis of the feed, a CSV file", "none: crusher product", _analysis)
    if apertures is None:
        apertures = _ask("Apertures of the decks, mm, top deck first", APERTURES, _apertures)
    tree = {"name": name, **_tree(rate, apertures)}
    decks = [f"deck[{k}]" for k in range(1, len(apertures) + 1)]
    answers: dict[str, Any] = {}
    kind = _ask(f"Motion: {', '.join(KINDS)}", KINDS[0], _kind)
    answers["motion.kind"] = kind
    slope = CIRCULAR_INCLINATION if kind == "circular" else INCLINATION
    for text, key, usual in (
        ("Length of the decks, m", "panel[1].length_m", LENGTH),
        ("Width of the decks, m", "width_m", WIDTH),
        ("Inclination, deg, down to the discharge", "panel[1].inclination_deg", slope),
    ):
        value = _answer(Question(text, f"{decks[0]}.{key}", usual))
        answers.update({f"{deck}.{key}": value for deck in decks})
    for question in (
        Question("Stroke, mm, from end to end", "motion.stroke_mm", 10.0),
        Question("Speed, 1/min", "motion.frequency_hz", 930.0, RPM),
        *MOTION[kind],
        Question("Bulk density, t/m3", "material.bulk_density_kg_m3", 1.6, T_M3),
    ):
        answers[question.key] = _answer(question)
    return edited(ScreenConfig, tree, answers), sieves


def _ask(text: str, usual: Any, read: Callable[[Any], Any]) -> Any:
    """An answer as `read` takes it; what it refuses is told, and asked again."""

    def read_or_tell(answer: Any) -> Any:
        try:
            return read(answer)
        except (ConfigError, InputError, OSError) as error:
            raise typer.BadParameter(told(error)) from None

    return typer.prompt(text, default=usual, value_proc=read_or_tell, err=True)


def _answer(question: Question) -> Any:
    """The value of a key, checked."""
    entry = ENTRIES[question.key.replace("[1]", "")]

    def read(answer: Any) -> Any:
        value = answer
        if isinstance(entry, Number):
            with suppress(ValueError):  # the check tells what it must be
                value = float(f"{float(str(answer).replace(',', '.')) * question.factor:.10g}")
        with reading(ScreenConfig, {}):
            entry.check(question.key, entry.read(question.key, value, Path()))
        return value

    return _ask(question.text, question.usual, read)


def _analysis(answer: str) -> Sieves | None:
    return None if answer.startswith("none") else read_sieves(answer.strip().strip("\"'"))


def _apertures(answer: str) -> tuple[float, ...]:
    """Apertures from one answer: 31.5 8, or 31.5, 8, or 31,5 / 8."""
    words = answer.replace(", ", " ").replace("/", " ").replace(",", ".").split()
    entry = ENTRIES["deck.panel.aperture_mm"]
    found = []
    for word in words:
        try:
            found.append(float(word))
        except ValueError:
            raise InputError(f"{word!r} is no number: give apertures such as 31.5 8") from None
        with reading(ScreenConfig, {}):
            entry.check("aperture_mm", entry.read("aperture_mm", found[-1], Path()))
    if not found:
        raise InputError("no aperture: give one a deck, such as 31.5 8")
    return tuple(found)


def _kind(answer: str) -> str:
    found = [kind for kind in KINDS if kind.startswith(answer.strip().lower())]
    if len(found) != 1:
        raise InputError(f"{answer!r} is no motion: give one of {', '.join(KINDS)}")
    return found[0]


# --- the file ------------------------------------------------------------------------------------
def text_of(config: ScreenConfig, tree: Mapping[str, Any], name: str) -> str:
    """The text of a file with a comment on every key.

    tree: as a file has it; its feed is written as it says there, and of sections with defaults what
    it gives.
    """
    whole = write_table(config)
    whole["feed"] = tree["feed"]
    kept = {key: whole[key] for key in ("name", *SECTIONS)}
    kept.update({key: value for key, value in tree.items() if key not in kept})
    left_out = [key for key in whole if key not in kept and key != "solver"]
    told = " and ".join(filter(None, (", ".join(left_out[:-1]), *left_out[-1:])))
    lines = [f"# {line}".rstrip() for line in HEAD.format(left_out=told, name=name).splitlines()]
    return "\n".join([*lines, "", *_lines(kept, "")]) + "\n"


def _lines(table: Mapping[str, Any], name: str) -> Iterator[str]:
    """Lines of a table: values with their comments, then the tables inside it."""
    inside = {}
    for key, value in table.items():
        if isinstance(value, dict) or (isinstance(value, list) and isinstance(value[0], dict)):
            inside[key] = value
        elif f"{name}{key}" not in LEFT_OUT:
            yield from _line(key, value, _meaning(f"{name}{key}"))
    for key, value in inside.items():
        title = SECTIONS.get(key, "") if not name else ""
        several = isinstance(value, list)
        for place, one in enumerate(value if several else [value]):
            yield ""
            if title and not place:
                yield f"# {title}"
            yield f"[[{name}{key}]]" if several else f"[{name}{key}]"
            yield from _lines(one, f"{name}{key}.")


def _meaning(path: str) -> str:
    """What is said of a key: its text, and the choices that there are."""
    entry = ENTRIES.get(path)
    text = getattr(entry, "tells", "")
    if isinstance(entry, Choice):
        return ": ".join(filter(None, (text, ", ".join(entry.names()))))
    return OTHERWISE.get(path, text)


def _line(key: str, value: Any, comment: str) -> Iterator[str]:
    """A key with its value; the comment behind it, or above where it is too long."""
    line = f"{key} = {toml_value(value)}"
    if len(line) > LINE:
        body = textwrap.wrap(toml_value(value)[1:-1], LINE - 4)
        line = "\n".join([f"{key} = [", *(f"    {part}" for part in body), "]"])
    behind = f"{line:<{COLUMN}}# {comment}"
    if comment and "\n" not in line and len(behind) <= LINE:
        yield behind
    else:
        yield from (f"# {part}" for part in textwrap.wrap(comment, LINE - 2))
        yield line
