"""`vibroscreen new`: the file that it writes is the screen that was described."""

from __future__ import annotations

from pathlib import Path

import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner, Result

from vibroscreen import Screen, ScreenConfig
from vibroscreen.cli import app
from vibroscreen.sizing_rules import usual_open_area

SIEVES = "size_mm;passing_pct\n45;100\n31,5;80\n16;55\n8;35\n4;20\n"
# What is asked, in its order, for a linear screen.
QUESTIONS = (
    "Name of the screen",
    "Feed of dry solids, t/h",
    "Sieve analysis of the feed, a CSV file",
    "Apertures of the decks, mm, top deck first",
    "Motion: linear, circular, elliptical",
    "Length of the decks, m",
    "Width of the decks, m",
    "Inclination, deg, down to the discharge",
    "Stroke, mm, from end to end",
    "Speed, 1/min",
    "Throw angle, deg",
    "Bulk density, t/m3",
)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the commands run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sieves.csv").write_text(SIEVES)
    return tmp_path


def new(*arguments: object, answers: str | None = None) -> Result:
    """`vibroscreen new screen.toml`."""
    return CliRunner().invoke(app, ["new", "screen.toml", *map(str, arguments)], input=answers)


def test_from_a_sieve_analysis() -> None:
    """Its sizes are the limits of the classes, its shares the feed; nothing is asked."""
    done = new("--from", "sieves.csv", "--rate", 250, "--aperture", 31.5, "--aperture", 8)
    assert done.exit_code == 0, done.output
    assert done.stderr == "written: screen.toml\nnext: vibroscreen check screen.toml\n"
    config = ScreenConfig.load("screen.toml")
    assert config.name == "screen"
    assert_allclose(config.size_classes.edges, [0.0, 0.004, 0.008, 0.016, 0.0315, 0.045])
    assert_allclose(config.feed.mass_fraction, [0.20, 0.15, 0.20, 0.25, 0.20])
    assert config.feed.mass_flow_rate == pytest.approx(250 / 3.6)
    assert config.apertures == (0.0315, 0.008)
    for aperture, deck in zip(config.apertures, config.decks, strict=True):
        assert deck.panels[0].open_area == pytest.approx(usual_open_area(aperture), abs=0.005)
    assert Screen(config).solve_steady().undersize.mass_flow_rate > 0.0


def test_every_key_has_a_comment_and_its_default() -> None:
    """What is left out is a default: the file says the screen that it was written from."""
    assert new("--yes").exit_code == 0
    text = Path("screen.toml").read_text()
    lines = text.splitlines()
    assert max(map(len, lines)) <= 100
    for place, line in enumerate(lines):
        if " = " in line and not line.startswith(("#", "name", "edges_mm")):
            assert "  # " in line or lines[place - 1].startswith("# "), line
    assert "stroke_mm = 10.0              # Stroke from end to end, twice the amplitude" in lines
    default = ScreenConfig.default()
    panel = default.decks[0].panels[0]
    written = ScreenConfig.load("screen.toml")
    assert written.value_of("deck[1].panel[1].open_area") == pytest.approx(0.59)
    same = written.with_values({"deck[1].panel[1].open_area": panel.open_area})
    assert same.replace(name=default.name) == default


def test_what_is_set_is_written() -> None:
    """Also in sections that are left out else."""
    done = new("--yes", "-s", "motion.stroke_mm=9", "-s", "solver.tolerance=1e-3", "-s", "name=x")
    assert done.exit_code == 0
    config = ScreenConfig.load("screen.toml")
    assert config.motion.amplitude == pytest.approx(0.0045)
    assert config.solver.tolerance == 1e-3
    assert config.name == "x"
    text = Path("screen.toml").read_text()
    assert "\n[solver]\n" in text
    assert "\ntolerance = 0.001\n" in text
    assert "[passage]" not in text
    assert "displacement, passage, segregation and bed have typical ones" in text


def test_enter_takes_what_is_usual() -> None:
    """All questions answered by Enter give the screen of --yes."""
    done = new(answers="\n" * len(QUESTIONS))
    assert done.exit_code == 0, done.output
    places = [done.stderr.index(question) for question in QUESTIONS]
    assert places == sorted(places)
    asked = ScreenConfig.load("screen.toml")
    assert new("--yes", "--force").exit_code == 0
    assert asked.name == "my screen"
    assert asked.replace(name="screen") == ScreenConfig.load("screen.toml")


def test_answers() -> None:
    """A circular double deck with a sieve analysis; what cannot be is asked again."""
    answers = (
        'north "A"', "250x", "250", "nix.csv", "sieves.csv", "31.5, abc", "31,5 / 8", "zigzag", "c",
        "5,5", "0", "2", "", "9", "960", "sideways", "against_flow", "1.7",
    )  # fmt: skip
    done = new(answers="\n".join(answers) + "\n")
    assert done.exit_code == 0, done.output
    for told in (
        "Error: feed.rate_t_h = '250x' is not a number (0 to 18000 t/h): give a finite rate",
        "Error: nix.csv: no such file or directory",
        "Error: 'abc' is no number: give apertures such as 31.5 8",
        "Error: 'zigzag' is no motion: give one of linear, circular, elliptical",
        "Error: deck[1].width_m = 0 is out of range (0.001 to 10 m)",
        "Error: motion.sense = 'sideways' is unknown: give one of with_flow, against_flow",
    ):
        assert told in done.stderr
    config = ScreenConfig.load("screen.toml")
    assert config.name == 'north "A"'
    assert config.apertures == (0.0315, 0.008)
    assert [(deck.length, deck.width) for deck in config.decks] == [(5.5, 2.0)] * 2
    assert config.value_of("deck[2].panel[1].inclination") == pytest.approx(0.314159, rel=1e-5)
    assert config.motion.ellipticity == -1.0
    assert config.motion.frequency == pytest.approx(16.0)
    assert config.motion.amplitude == pytest.approx(0.0045)
    assert config.material.bulk_density == pytest.approx(1700.0)
    assert len(config.size_classes.edges) == 6


def test_an_elliptical_screen() -> None:
    """It is asked for its ellipticity."""
    answers = ["", "", "", "", "e", "", "", "", "", "", "40", "0.4", ""]
    assert new(answers="\n".join(answers) + "\n").exit_code == 0
    motion = ScreenConfig.load("screen.toml").motion
    assert (motion.ellipticity, motion.throw_angle) == pytest.approx((0.4, 0.698132), rel=1e-5)


def test_what_was_taken_for_granted_is_said() -> None:
    """Notes on the sieve analysis."""
    Path("sieves.csv").write_text("size_mm;passing\n8;30\n16;65\n31.5;95\n")
    done = new("--from", "sieves.csv")
    assert done.stderr.startswith("note: 5 % are coarser than the largest sieve, 31.5 mm: taken as")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--from", "nix.csv"), "nix.csv: no such file or directory"),
        (("--from", "."), ".: is a directory"),
        (("--yes", "--rate", "-3"), "feed.rate_t_h = -3 is out of range (0 to 18000 t/h)"),
        (("--yes", "--aperture", "9000"), "deck[1].panel[1].aperture_mm = 9000 is out of range"),
        (("--yes", "--aperture", "8", "--aperture", "16"), "is larger than any opening of the deck above"),
        (("--yes", "--set", "drive.power=3"), "drive.power is unknown: did you mean drive."),
    ],
)  # fmt: skip
def test_what_cannot_be_written(arguments: tuple[str, ...], told: str) -> None:
    """A message, exit code 1, no file."""
    done = new(*arguments)
    assert done.exit_code == 1
    assert told in done.stderr
    assert not Path("screen.toml").exists()


def test_a_file_that_is_there_stays() -> None:
    """Unless --force says otherwise."""
    Path("screen.toml").write_text("mine")
    done = new("--yes")
    assert done.exit_code == 1
    assert done.stderr == "screen.toml is there already: give another name, or --force\n"
    assert Path("screen.toml").read_text() == "mine"
    assert new("--yes", "--force").exit_code == 0


def test_no_more_answers() -> None:
    """Where nobody answers: what to do instead, no file."""
    done = new(answers="a\n")
    assert done.exit_code == 1
    assert "no more answers, no file: --yes takes what is usual, --from SIEVES asks" in done.stderr
    assert [path.name for path in Path().iterdir()] == ["sieves.csv"]
