"""`vibroscreen solve`: what it prints is what the engine found; what is wrong is told by text."""

from __future__ import annotations

import csv
import io
import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner, Result

from tests.places import SCREENS
from vibroscreen import Screen, ScreenConfig
from vibroscreen.cli import app
from vibroscreen.cli.solved import schema
from vibroscreen.layout import Layout

QUARRY, TWO_DECK = SCREENS / "quarry.toml", SCREENS / "two_deck.toml"


def run(*arguments: object) -> Result:
    """`vibroscreen` with its streams apart."""
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def solved(*arguments: object) -> dict[str, Any]:
    """The document of `solve --json`, which its schema holds."""
    done = run("solve", *arguments, "--json")
    assert done.exit_code == 0, done.output
    found: dict[str, Any] = json.loads(done.stdout)
    jsonschema.validate(found, schema())
    return found


def table(text: str, title: str) -> list[list[str]]:
    """The rows of a printed table, cells in a list."""
    lines = text.partition(f"\n{title}\n")[2].split("\n\n")[0].splitlines()
    return [line.split() for line in lines]


# --- for machines --------------------------------------------------------------------------------
@pytest.mark.parametrize("screen", ["quarry.toml", "two_deck.toml", "banana.toml"])
def test_the_document_is_what_python_finds(screen: str) -> None:
    """Every stream and figure, in the units of its key."""
    found = solved(SCREENS / screen)
    steady = Screen(ScreenConfig.load(SCREENS / screen)).solve_steady()
    streams = found["streams"]
    over = [streams["oversize"]] + [
        streams[f"intermediate[{k}]"] for k in range(1, len(steady.decks))
    ]
    for said, stream in zip(over, (steady.oversize, *steady.intermediate), strict=True):
        assert said["rate_t_h"] == pytest.approx(stream.mass_flow_rate * 3.6)
        assert_allclose(said["mass_fraction"], stream.mass_fraction)
    assert streams["undersize"]["p80_mm"] == pytest.approx(steady.undersize_p80 * 1e3)
    assert streams["feed"]["rate_t_h"] == pytest.approx(
        sum(s["rate_t_h"] for s in [*over, streams["undersize"]])
    )
    assert_allclose(found["recovery"], steady.recovery)
    for said, deck in zip(found["decks"], steady.decks, strict=True):
        assert said["efficiency"] == pytest.approx(deck.efficiency)
        assert said["cut_size_mm"] == pytest.approx(deck.cut_size * 1e3)
        assert said["oversize_rate_t_h"] == pytest.approx(deck.oversize_rate * 3.6)
        assert said["transport_velocity_m_s"] == pytest.approx(deck.transport_velocity)
    assert found["box"]["drive_power_kw"] == pytest.approx(steady.drive_power / 1e3)
    assert found["box"]["exciter_force_kn"] == pytest.approx(steady.exciter_force / 1e3)
    assert [alarm["name"] for alarm in found["alarms"]] == list(steady.alarms)


def test_the_schema_is_one_and_holds() -> None:
    """It is a schema; a key more, a key less or a text for a number is refused."""
    jsonschema.Draft202012Validator.check_schema(schema())
    found = solved(QUARRY)
    for spoil in (
        lambda d: d.update(more=1),
        lambda d: d.pop("recovery"),
        lambda d: d["decks"][0].update(efficiency="0.9"),
        lambda d: d["streams"].update(middle=d["streams"]["feed"]),
        lambda d: d["alarms"].append({"name": "alarm.none", "reason": ""}),
    ):
        broken = json.loads(json.dumps(found))
        spoil(broken)
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(broken, schema())


def test_what_there_is_nothing_of_is_null() -> None:
    """An aperture that lets all through leaves no oversize, so it has no P80."""
    found = solved(QUARRY, "--set", "deck[1].panel[1].aperture_mm=400", "--set", "feed.rate_t_h=1")
    assert found["streams"]["oversize"]["rate_t_h"] == pytest.approx(0.0, abs=1e-3)
    assert found["decks"][0]["sizing_rules"]["vsma_efficiency"] == 0.95
    assert found["decks"][0]["sizing_rules"]["beyond"]


def test_the_table() -> None:
    """A row a class; streams sum to the feed."""
    done = run("solve", TWO_DECK, "--csv")
    rows = list(csv.DictReader(io.StringIO(done.stdout)))
    assert list(rows[0]) == [
        "lower_mm", "upper_mm", "feed_t_h", "oversize_t_h", "intermediate[1]_t_h", "undersize_t_h", "recovery",
    ]  # fmt: skip
    numbers = np.array([[float(value) for value in row.values()] for row in rows])
    assert_allclose(numbers[:, 3:6].sum(axis=1), numbers[:, 2], atol=1e-7)
    assert numbers[:, 2].sum() == pytest.approx(250.0)
    assert numbers[6, :2].tolist() == [11.2, 16.0]


# --- for people ----------------------------------------------------------------------------------
def test_what_is_printed_sums_up() -> None:
    """Products to the feed, classes to their totals; figures of decks under their deck."""
    text = run("solve", TWO_DECK).stdout
    products = table(text, "Products")[1:]
    rates = [float(row[-4]) for row in products[:-1]]
    assert products[-1][-2:] == ["250.0", "100.0"]
    assert rates[0] == pytest.approx(sum(rates[1:]), abs=0.15)
    classes = table(text, "By class, t/h")[2:]
    total = classes.pop()
    assert total[0] == "total"
    columns = np.array([[float(cell) for cell in row[3:7]] for row in classes])
    assert_allclose(columns.sum(axis=0), [float(cell) for cell in total[1:5]], atol=0.4)
    passing = table(text, "Passing, %")[2:]
    assert [row[1] for row in passing][::12] == ["100.0", "0.0"]
    decks = {" ".join(row[:-2]): row[-2:] for row in table(text, "Decks")[1:]}
    assert decks["aperture, mm"] == ["31.5", "8"]
    found = solved(TWO_DECK)["decks"]
    for cell, deck in zip(decks["efficiency: undersize that passes, %"], found, strict=True):
        assert float(cell) == pytest.approx(100 * deck["efficiency"], rel=1e-3)
    assert "No alarms" in text


def test_alarms_are_told_and_strict_ends_with_3() -> None:
    """With their reason; without alarms --strict ends with 0."""
    deep = ("--set", "feed.rate_t_h=900")
    done = run("solve", QUARRY, *deep)
    assert done.exit_code == 0
    assert "alarm.bed_depth: the bed of deck 1 is" in done.stdout
    assert run("solve", QUARRY, *deep, "--strict").exit_code == 3
    assert run("solve", QUARRY, *deep, "--strict", "--json").exit_code == 3
    assert run("solve", QUARRY, "--strict", "--set", "feed.rate_t_h=100").exit_code == 0


def test_a_picture(tmp_path: Path) -> None:
    """In the format of its name; where it went is said beside the result, not in it."""
    for suffix, first in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        path = tmp_path / f"screen{suffix}"
        done = run("solve", QUARRY, "--json", "--plot", path)
        assert done.stderr == f"written: {path}\n"
        assert path.read_bytes().startswith(first)
        json.loads(done.stdout)


def test_the_same_with_and_without_a_terminal() -> None:
    """But for colours: a pseudo-terminal of 80 and of 200 columns, and a pipe."""
    command = [sys.executable, "-m", "vibroscreen", "solve", str(QUARRY), "-s", "feed.rate_t_h=900"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    environment.pop("COLUMNS", None)
    piped = subprocess.run(command, capture_output=True, check=True, env=environment).stdout
    for columns in ("80", "200"):
        shown = {**environment, "COLUMNS": columns, "TERM": "xterm-256color"}
        here, there = pty.openpty()
        child = subprocess.Popen(command, stdout=there, stderr=there, env=shown)
        os.close(there)
        seen = b""
        while True:
            try:
                part = os.read(here, 65536)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            seen += part
        child.wait()
        os.close(here)
        assert b"\x1b[" in seen
        plain = seen.replace(b"\r\n", b"\n")
        assert re.sub(rb"\x1b\[[0-9;]*m", b"", plain) == piped


def test_a_product_that_does_not_flow() -> None:
    """A blank plate lets nothing pass: no sizes, no gradation of nothing."""
    text = run("solve", QUARRY, "--set", "deck[1].panel[1].open_area=0").stdout
    under = next(row for row in table(text, "Products") if row[0] == "undersize")
    assert under == ["undersize", "0.0", "0.0", "-", "-"]
    assert {row[-1] for row in table(text, "Passing, %")[2:]} == {"-"}


def test_more_memory_than_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Told without a traceback, as of 100 000 packages of 10 000 layers, which are 400 GB."""

    def refuse(layout: Layout) -> None:
        raise MemoryError(f"unable to allocate {8 * layout.size} bytes")

    monkeypatch.setattr(Layout, "buffer", refuse)
    done = run("solve", QUARRY)
    assert done.exit_code == 1
    assert done.stderr == (
        "there is not enough memory for this screen: give fewer bed.layers, solver.packages or "
        "size classes\n"
    )


# --- what is set ---------------------------------------------------------------------------------
def test_what_is_set_is_as_if_the_file_said_it(tmp_path: Path) -> None:
    """Numbers, texts, lists, one of a list; keys that are taken out; what says the same goes."""
    text = QUARRY.read_text()
    assert "aperture_mm = 16.0" in text
    other = tmp_path / "other.toml"
    other.write_text(text.replace("aperture_mm = 16.0", "aperture_mm = 18"))
    assert solved(QUARRY, "--set", "deck[1].panel[1].aperture_mm=18") == solved(other)
    assert solved(QUARRY, "-s", "deck.panel.aperture_mm = 18") == solved(other)
    assert solved(QUARRY, "-s", "size_classes.edges_mm[13]=80")["edges_mm"][-1] == 80.0
    circular = ("motion.kind=circular", "motion.throw_angle_deg=", 'motion.sense="with_flow"')
    found = solved(QUARRY, *(f"--set={one}" for one in (*circular, "displacement.model=bed")))
    assert found["box"]["acceleration_number"] == pytest.approx(
        0.005 * (2 * np.pi * 15.5) ** 2 / 9.81
    )
    passing = [round(k / 12, 4) for k in range(13)]
    found = solved(QUARRY, "--set", f"feed.passing={passing}", "--set", "name=a b")
    assert_allclose(found["streams"]["feed"]["passing"], passing, atol=1e-9)
    assert found["name"] == "a b"
    assert solved(QUARRY, "--set", "solver.tolerance=.001")["decks"]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (["deck[2].width_m=3"], "deck[2].width_m: the file has deck[1] only: give one of these"),
        (["deck[1].panel[1].aperture=18"], "is unknown: write deck[1].panel[1].aperture_mm = 18"),
        (["feed.rate=350"], "feed.rate = 350 is unknown: write feed.rate_t_h = 350"),
        (["motion.frequency_hz=fast"], "motion.frequency_hz = 'fast' is not a number (0 to"),
        (["deck.panel.aperture_mm=0"], "deck[1].panel[1].aperture_mm = 0 is out of range"),
        (["size_classes.edges_mm[99]=80"], "the file has size_classes.edges_mm[1] to size_classes.edges_mm[13]"),
        (["name[1]=x"], "name[1]: the file gives no list name there: give all of it"),
        (["name.first=x"], "name.first: name is no table of the file"),
        (["deck(1).width_m=3"], "deck(1).width_m is no key: write it as deck[1].panel[1].aperture_mm"),
        (["size_classes.edges_mm="], "size_classes.edges_mm is missing, it has no default: give it"),
        (["feed.rate_t_h=0"], "feed.mass_flow_rate = 0 kg/s has no steady separation"),
        (["motion.throw_angle_deg=120"], "do not convey, so there is no steady state"),
        (["passage.velocity_table=nix.csv"], "nix.csv cannot be read"),
    ],
)  # fmt: skip
def test_what_cannot_be_set(changes: list[str], told: str) -> None:
    """All that is wrong is told, and the file; exit code 1, no traceback."""
    options = [part for change in changes for part in ("--set", change)]
    done = run("solve", QUARRY, *options)
    assert done.exit_code == 1
    assert told in done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr


def test_of_two_decks_one_must_be_named() -> None:
    """A key that fits several is refused."""
    done = run("solve", TWO_DECK, "--set", "deck.width_m=3")
    assert done.exit_code == 1
    assert done.stderr.startswith("deck.width_m: the file has deck[1] to deck[2]: say which")


def test_all_that_is_wrong_at_once() -> None:
    """Three errors, three lines, and the file."""
    done = run(
        "solve", QUARRY, "-s", "feed.rate_t_h=x", "-s", "motion.stroke_mm=-1", "-s", "drive.mass=3"
    )
    assert len(done.stderr.splitlines()) == 4
    assert done.stderr.splitlines()[-1] == f"in {QUARRY} with what was set"


def test_usage() -> None:
    """What is no option, no value or two formats ends with 2."""
    for arguments, told in (
        (
            ("--set", "deck"),
            "'deck' is not KEY=VALUE: write --set 'deck[1].panel[1].aperture_mm=18'",
        ),
        (("--set", "=3"), "'=3' is not KEY=VALUE"),
        (
            ("--json", "--csv"),
            "Invalid value for --csv: --json and --csv exclude each other: give one",
        ),
        (("--jsn",), "No such option: --jsn"),
    ):
        done = run("solve", QUARRY, *arguments)
        assert done.exit_code == 2
        assert told in " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("contents", "told"),
    [
        (None, "screen.toml: no such file or directory"),
        (b"\xff\xfe\x00", "screen.toml is not text in UTF-8: save it in this encoding"),
        (b"deck = [", "the text is not TOML"),
        (b"", "size_classes is missing, it has no default: give it"),
        (b"name = '\x1b[31mred\x1b[0m'", "the text is not TOML"),
        (b"size_classes = 3", "size_classes = 3 is not a table: write [size_classes]"),
        (b"deck = 3\n[size_classes]\nedges_mm=[0,1]", "deck = 3 is not a list of tables: write [[deck]]"),
    ],
)  # fmt: skip
def test_files_that_are_no_screen(contents: bytes | None, told: str, tmp_path: Path) -> None:
    """Missing, no text, no TOML, empty, of wrong kinds: a line, exit code 1."""
    path = tmp_path / "screen.toml"
    if contents is not None:
        path.write_bytes(contents)
    done = run("solve", path)
    assert done.exit_code == 1
    assert told in done.stderr
    assert "Traceback" not in done.stderr


def test_pictures_that_cannot_be(tmp_path: Path) -> None:
    """A format that is none, a folder that is not there."""
    done = run("solve", QUARRY, "--plot", tmp_path / "screen.xls")
    assert done.exit_code == 1
    assert "'.xls' is no format of a picture: let the name end in .png, .svg or .pdf" in done.stderr
    done = run("solve", QUARRY, "--plot", tmp_path / "none" / "screen.png")
    assert done.exit_code == 1
    assert "screen.png: no such file or directory" in done.stderr


def test_who_has_read_enough_ends_it_quietly() -> None:
    """`vibroscreen solve screen.toml | head -1`."""
    command = [sys.executable, "-m", "vibroscreen", "solve", str(QUARRY)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    child = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    )
    assert child.stdout is not None
    assert child.stderr is not None
    child.stdout.close()
    assert child.stderr.read() == b""
    child.stderr.close()
    child.wait()


def test_hostile_names_are_text(tmp_path: Path) -> None:
    """Markup, tags, quotes and length go through as they are."""
    name = (
        "[bold red]x[/] <script>alert('1')</script> \"quoted\" {0} %s :smile: \x1b[31m\x07"
        + "y" * 300
    )
    path = tmp_path / "screen.toml"
    path.write_text(
        f"name = {json.dumps(name)}\n" + QUARRY.read_text().replace('name = "quarry screen"', "")
    )
    assert solved(path)["name"] == name
    shown = "".join(line.rstrip() for line in run("solve", path).stdout.splitlines()[:8])
    assert "[bold red]x[/]" in shown
    assert "<script>alert('1')</script>" in shown
    assert r"\x1b[31m\x07yyy" in shown
