"""Two-stage crushing: the gate makes the order, all of it balances, the answer is the docstring's."""

from __future__ import annotations

from pathlib import Path

import pytest

import two_stage
from vibroscreen.circuit import solve_circuit
from vibroscreen.units import T_H


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> two_stage.Plant:
    return two_stage.main(tmp_path_factory.mktemp("two_stage"), picture=False)


def test_the_gate_makes_the_order(plant: two_stage.Plant) -> None:
    """40 t/h leave; a gate a little less open makes less; everything else is what was fed."""
    made = two_stage.rates(plant.ordered)
    assert made["32/90"] == pytest.approx(two_stage.ORDER, rel=1e-5)
    assert sum(made.values()) == pytest.approx(200.0 * T_H, rel=1e-12)
    share = made["32/90"] / plant.ordered.feed("gate")[0].sum()
    less = solve_circuit(two_stage.TODAY.with_values({"gate.share": 0.99 * share}))
    assert two_stage.rates(less)["32/90"] < 0.999 * two_stage.ORDER
    assert set(plant.today.status) == set(plant.ordered.status) == {"closed"}


def test_the_plant_settles_where_the_steady_circuit_is(plant: two_stage.Plant) -> None:
    end, made = plant.start.iloc[-1], two_stage.rates(plant.ordered)
    for name, rate in made.items():
        assert end[name] == pytest.approx(rate, abs=1e-4 * plant.ordered.fresh[0])
    assert plant.found == pytest.approx(list(made.values()), abs=1e-6 * plant.ordered.fresh[0])


def test_the_answer_is_that_of_the_docstring(plant: two_stage.Plant, tmp_path: Path) -> None:
    assert two_stage.answer(plant) in " ".join((two_stage.__doc__ or "").split())
    two_stage.draw(plant, tmp_path / "start.png")
    assert (tmp_path / "start.png").stat().st_size > 10_000
