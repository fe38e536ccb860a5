"""Python blocks and commands of the README, the guide, the model and the validation run as shown."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.places import ROOT
from vibroscreen.cli import COMMANDS as NAMES
from vibroscreen.cli import app

PAGES = (
    ROOT / "README.md",
    ROOT / "engine" / "MODEL.md",
    ROOT / "engine" / "validation" / "VALIDATION.md",
    *sorted((ROOT / "engine" / "docs").glob("*.md")),
)
TEXTS = {page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8") for page in PAGES}
OPENING = "```python"
BLOCK = re.compile(rf"^{OPENING}\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"\b(?:engine|fmu_src|plant_examples|tests)/[\w./]*\w")
# Written when the guide is built.
GENERATED = ("engine/docs/examples", "engine/docs/solve_json")


@pytest.mark.parametrize("page", [page for page, text in TEXTS.items() if OPENING in text])
def test_blocks_run(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of the page, one after the other, in the folder of the project."""
    monkeypatch.chdir(ROOT)
    blocks = list(BLOCK.finditer(TEXTS[page]))
    assert len(blocks) == TEXTS[page].count(OPENING)
    names: dict[str, object] = {"__name__": "guide"}
    for block in blocks:
        lines_before = TEXTS[page].count("\n", 0, block.start(1))
        exec(compile("\n" * lines_before + block[1], page, "exec"), names)


@pytest.mark.parametrize("page", TEXTS)
def test_files_are_there(page: str) -> None:
    """No page sends its reader to a file that is not in the repository."""
    missing = {file for file in FILE.findall(TEXTS[page]) if not (ROOT / file).exists()}
    assert {file for file in missing if not file.startswith(GENERATED)} == set()


# --- the command line ----------------------------------------------------------------------------
# Pages of the guide with commands as they print, and how many there are.
COMMANDS = {"command_line.md": 7, "replay.md": 1}
FENCE = re.compile(
    r"^```(?:console|\{code-block\} text\n:caption: (?P<file>[\w.]+))\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


@pytest.mark.parametrize("page", COMMANDS)
def test_the_commands_print_what_the_page_shows(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the order of the page, with its files; `...` stands for any lines or words.

    Numbers of a result may differ by a tenth: they are examples.
    """
    monkeypatch.chdir(tmp_path)
    ran = 0
    for block in FENCE.finditer(TEXTS[f"engine/docs/{page}"]):
        if block["file"]:
            (tmp_path / block["file"]).write_text(block["text"])
            continue
        for part in block["text"].split("$ ")[1:]:
            command, _, shown = part.partition("\n")
            line, _, target = command.partition(" > ")
            words = shlex.split(line)
            assert words.pop(0) == "vibroscreen"
            done = CliRunner().invoke(app, words)
            if target:
                (tmp_path / target).write_text(done.stdout)
            printed = (done.stderr if target else done.output) + (
                f"exit code {done.exit_code}\n" if done.exit_code else ""
            )
            assert_alike(shown.split(), printed.split(), command)
            ran += 1
    assert ran == COMMANDS[page]
    assert [picture for picture in tmp_path.glob("*.png") if picture.stat().st_size > 10_000]


def assert_alike(shown: list[str], printed: list[str], command: str) -> None:
    """What is shown is printed, word by word; `...` stands for any words."""
    parts: list[list[str]] = [[]]
    for word in shown:
        if word == "...":
            parts.append([])
        else:
            parts[-1].append(word)
    place = 0
    for k, part in enumerate(parts):
        there = [
            at
            for at in range(place, len(printed) - len(part) + 1)
            if all(map(alike, part, printed[at : at + len(part)]))
        ]
        assert there, f"{command}: not printed: {' '.join(part)}"
        assert k > 0 or there[0] == 0, f"{command}: not at the beginning: {' '.join(part)}"
        place = (there[-1] if k == len(parts) - 1 and part else there[0]) + len(part)
    assert parts[-1] == [] or place == len(printed), f"{command}: more than {' '.join(parts[-1])}"


def alike(shown: str, printed: str) -> bool:
    """The same words, with numbers that differ by a tenth at most."""
    one, other = (NUMBER.findall(word) for word in (shown, printed))
    same = NUMBER.sub("#", shown) == NUMBER.sub("#", printed)
    return same and all(
        float(b) == pytest.approx(float(a), rel=0.1) for a, b in zip(one, other, strict=True)
    )


def test_the_page_names_every_command() -> None:
    """Every command of the command line stands on its page."""
    text = TEXTS["engine/docs/command_line.md"]
    assert [name for name in NAMES if f"vibroscreen {name} " not in text] == []
