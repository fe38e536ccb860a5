"""`vibroscreen check`: all errors at once; else how the screen stands, in words."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner, Result

from tests.places import SCREENS
from vibroscreen import Screen, ScreenConfig
from vibroscreen.cli import app
from vibroscreen.practice import findings

QUARRY, TWO_DECK = SCREENS / "quarry.toml", SCREENS / "two_deck.toml"
DEEP = ("--set", "feed.rate_t_h=900")


def check(*arguments: object) -> Result:
    """`vibroscreen check`."""
    return CliRunner().invoke(app, ["check", *map(str, arguments)])


def test_all_errors_of_a_file_at_once(tmp_path: Path) -> None:
    """A line each, in its keys and units, and nothing else; exit code 1."""
    path = tmp_path / "screen.toml"
    path.write_text(
        "[size_classes]\nedges_mm = [0, 8, 4]\n[[deck]]\nwidth_m = 240\n"
        "[motion]\nrpm = 930\n[feed]\nrate_t_h = -1\nmoisture = 0.1\n"
    )
    done = check(path)
    assert done.exit_code == 1
    assert done.stdout == ""
    *errors, where = done.stderr.splitlines()
    assert where == f"in {path}"
    assert len(errors) == 5
    for key in ("size_classes.edges_mm[3]", "deck[1].width_m", "motion.rpm", "feed.rate_t_h", "feed.moisture"):  # fmt: skip
        assert any(error.startswith(key) for error in errors), key


def test_words_for_every_finding() -> None:
    """What is printed is what `practice.findings` found: level, subject and reason, in order."""
    done = check(TWO_DECK, *DEEP)
    assert done.exit_code == 0
    text = " ".join(done.stdout.split())
    assert text.startswith("No errors. double-deck quarry screen: 6 x 2.4 m, 31.5 / 8 mm, 5 deg,")
    config = ScreenConfig.load(TWO_DECK, {"feed.rate_t_h": 900})
    found = findings(Screen(config).solve_steady())
    assert {one.level for one in found} >= {"green", "red"}
    place = 0
    for one in found:
        word = {"green": "good", "amber": "look", "red": "bad"}[one.level]
        place = text.index(f"{word} {one.subject} {one.reason}", place)
    assert text.endswith("Something is bad: see what to change.")
    assert max(map(len, done.stdout.splitlines())) <= 80


def test_what_the_numbers_rest_on() -> None:
    """The named set and its error; what lies beyond it is told, by check, solve and JSON."""
    config = ScreenConfig.load(TWO_DECK)
    rests = f'"{config.calibration.name}", fitted to {config.calibration.fitted_to}'
    steep = (
        "--set",
        "deck[1].panel[1].inclination_deg=14",
        "--set",
        "deck[1].panel[2].inclination_deg=14",
    )
    told = "lies outside of 0 to 10 deg, where"
    assert f"deck[1].panel[1].inclination = 14 deg {told}" in " ".join(
        check(TWO_DECK, *steep).stdout.split()
    )
    assert f"The numbers of the model: {rests}" in " ".join(check(TWO_DECK, *steep).stdout.split())
    solved = CliRunner().invoke(app, ["solve", str(TWO_DECK), *steep])
    assert f"Numbers of the model: {rests}" in " ".join(solved.stdout.split())
    assert f"beyond it: deck[1].panel[1].inclination = 14 deg {told}" in " ".join(
        solved.stdout.split()
    )
    found = json.loads(CliRunner().invoke(app, ["solve", str(TWO_DECK), *steep, "--json"]).stdout)
    assert found["calibration"]["name"] == config.calibration.name
    assert any(told in one for one in found["calibration"]["beyond"])


def test_levels() -> None:
    """The last line is about the worst of all."""
    assert check(TWO_DECK).stdout.endswith("All is as plants find good.\n")
    slow = ("-s", "feed.rate_t_h=50", "-s", "motion.stroke_mm=4.5")
    assert check(QUARRY, *slow).stdout.endswith("Nothing is bad; look at what is unusual.\n")


def test_for_machines() -> None:
    """The same as JSON, with the alarms."""
    found = json.loads(check(QUARRY, *DEEP, "--json").stdout)
    config = ScreenConfig.load(QUARRY, {"feed.rate_t_h": 900})
    steady = Screen(config).solve_steady()
    assert found["level"] == "red"
    assert found["alarms"] == list(steady.alarms)
    of_steady = [finding.reason for finding in findings(steady)]
    assert [one["reason"] for one in found["findings"]][: len(of_steady)] == of_steady


def test_strict() -> None:
    """3 where an alarm is set, 0 where none is."""
    assert check(QUARRY, *DEEP, "--strict").exit_code == 3
    assert check(QUARRY, "--set", "feed.rate_t_h=100", "--strict").exit_code == 0


def test_a_screen_that_does_not_convey() -> None:
    """Why, and what to do; exit code 1."""
    done = check(QUARRY, "--set", "motion.throw_angle_deg=120")
    assert done.exit_code == 1
    assert "so there is no steady state: raise them, turn the throw angle down-slope" in done.stderr
