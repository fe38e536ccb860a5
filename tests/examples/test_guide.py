"""The Python blocks of the README, the guide, the model and the validation run as they stand."""

from __future__ import annotations

import re

import pytest

from tests.places import ROOT

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
GENERATED = ("engine/docs/examples",)


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
