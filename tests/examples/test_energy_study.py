"""The energy study: no design beats the best, which keeps to its standard and runs through time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import energy_study
from vibroscreen.circuit import solve_circuit_many
from vibroscreen.study import Axis
from vibroscreen.units import KWH_T, MM, T_H

AXES = (
    Axis(key="crusher.closed_side_setting_mm", values=(14.0, 20.0, 21.0)),
    Axis(key="screen.deck[1].panel[1].aperture_mm", values=(16.0, 19.0, 21.0)),
    Axis(key="screen.motion.frequency_hz", values=(12.0, 15.5)),
)


@pytest.fixture(scope="module")
def found() -> energy_study.Energy:
    return energy_study.find(dataclasses.replace(energy_study.STUDY, axes=AXES))


def test_no_design_that_can_be_run_needs_less(found: energy_study.Energy) -> None:
    """All designs solved again without the study: drives over the product, by hand."""
    grid = [g.ravel() for g in np.meshgrid(*(axis.values for axis in AXES), indexing="ij")]
    values = {
        "crusher.closed_side_setting": grid[0] * MM,
        "screen.deck[1].panel[1].aperture": grid[1] * MM,
        "screen.motion.frequency": grid[2],
    }
    table = solve_circuit_many(energy_study.STUDY.circuit, values)
    product = table.product("0/16")
    finer = product[:, energy_study.STUDY.circuit.edges[1:] <= 16.001 * MM].sum(axis=1)
    usable = (table.feed("crusher").sum(axis=1) <= 620 * T_H) & (finer >= 0.9 * product.sum(axis=1))
    assert 1 < usable.sum() < usable.size
    energy = sum(table.power.values()) / product.sum(axis=1) / KWH_T
    best = float(found.best.energy[0]) / KWH_T
    assert best == pytest.approx(energy[usable].min(), rel=1e-3)
    assert "over capacity" in set(found.designs["status"])


def test_the_best_one_runs_through_time(found: energy_study.Energy) -> None:
    assert found.settled.energy == pytest.approx(float(found.best.energy[0]) / KWH_T, rel=1e-3)
    assert abs(found.settled.balance_error) < 1e-12


def test_the_answer_is_that_of_the_docstring(found: energy_study.Energy) -> None:
    """The whole study has the same best design: its numbers stand in the docstring."""
    setting, rest = energy_study.answer(found).split(". ", 1)
    text = " ".join((energy_study.__doc__ or "").split())
    assert setting in text
    assert rest.rpartition(". ")[2] in text
