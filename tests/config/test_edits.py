"""Values by key in the place of those of a file; through the command line: tests/cli/test_solve.py."""

from __future__ import annotations

import copy
import tomllib
from typing import Any

import pytest

from tests.places import SCREENS
from vibroscreen import ConfigError, ScreenConfig
from vibroscreen.edits import edited

TREE: dict[str, Any] = tomllib.loads((SCREENS / "two_deck.toml").read_text(encoding="utf-8"))


def test_a_key_is_set_and_the_tree_stays() -> None:
    """Only the place that is named, in a copy."""
    before = copy.deepcopy(TREE)
    found = edited(ScreenConfig, TREE, {"deck[1].panel[2].aperture_mm": 28.0, "name": "x"})
    assert before == TREE
    assert [panel["aperture_mm"] for panel in found["deck"][0]["panel"]] == [31.5, 28.0]
    assert found["deck"][1] == TREE["deck"][1]
    assert found["name"] == "x"


def test_tables_that_are_not_there_are_made() -> None:
    """With one place each; a file without decks has the usual one."""
    found = edited(ScreenConfig, {}, {"deck[1].panel[1].aperture_mm": 18, "solver.tolerance": 1e-3})
    assert found == {"deck": [{"panel": [{"aperture_mm": 18}]}], "solver": {"tolerance": 1e-3}}


def test_what_says_the_same_goes() -> None:
    """One of passing and mass_fraction; others stay."""
    found = edited(ScreenConfig, TREE, {"feed.passing": [0.0, 1.0]})
    assert found["feed"] == {"rate_t_h": 250.0, "passing": [0.0, 1.0]}


def test_none_takes_a_key_out() -> None:
    """Also one that is not there."""
    found = edited(ScreenConfig, TREE, {"feed.rate_t_h": None, "motion.sense": None})
    assert "rate_t_h" not in found["feed"]
    assert found["motion"] == TREE["motion"]


@pytest.mark.parametrize("key", ["", ".", "deck[0].width_m", "deck[-1].width_m", "deck[1]..x", "a b", "deck[1]x"])  # fmt: skip
def test_what_is_no_key(key: str) -> None:
    """Refused by name."""
    with pytest.raises(ConfigError) as caught:
        edited(ScreenConfig, TREE, {key: 1})
    assert str(caught.value).startswith(key)


def test_a_screen_with_other_values() -> None:
    """As if the file said so."""
    path = SCREENS / "two_deck.toml"
    found = ScreenConfig.load(path, {"feed.rate_t_h": 360, "deck[2].panel[1].aperture_mm": 10})
    same = ScreenConfig.load(path).with_values(
        {"feed.mass_flow_rate": 100.0, "deck[2].panel[1].aperture": 0.01}
    )
    assert found == same
