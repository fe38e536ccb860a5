"""The benchmark's yardsticks are right, and its command runs: no times are asserted here."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks import (
    circuits,
    dem_scale,
    design,
    import_time,
    many,
    page,
    replay,
    step_cost,
    week,
)
from tests.benchmarks import work_precision as bench
from tests.benchmarks.baseline import (
    PASSED,
    ColumnMarch,
    FixedCells,
    engine_nodes,
    problem_of,
    uniform_slices,
)
from tests.fixed import fixed_screen, fixed_segregation
from tests.kernels.numerics import exact
from vibroscreen import Feed, Screen, ScreenConfig, register
from vibroscreen.circuit import RunningCircuit
from vibroscreen.kernels import library, state
from vibroscreen.sections import Solver
from vibroscreen.units import MINUTE

MODELS = ("well_mixed", "proportional", "exchange", "classified")
DEFAULT = ScreenConfig.default()


def screen_of(model: str, subdivision: int = 0) -> Screen:
    fixed = fixed_screen()
    classes = dataclasses.replace(fixed.size_classes, subdivision=subdivision)
    segregation = fixed_segregation(model)
    return Screen(fixed.replace(size_classes=classes, segregation=segregation, solver=Solver(1e-9)))


def slope(settings: list[int], errors: list[float]) -> float:
    """Order of convergence: fall of the error with the setting, in log-log."""
    return -float(np.polyfit(np.log(settings), np.log(errors), 1)[0])


# --- exact solutions ---------------------------------------------------------------------------
EDGES = np.linspace(0.0, 0.2, 101)
COLUMNS: dict[str, tuple[Callable[[np.ndarray, float], np.ndarray], float]] = {
    "mixed": (lambda z, t: exact.two_kinds_mixed(z, t, 0.4, 0.01, 0.2), 0.4),
    "stacked": (lambda z, t: exact.two_kinds_stacked(z, t, 0.08, 0.01, 0.2), 0.6),
    "hindered": (lambda z, t: exact.hindered_kinds_mixed(z, t, 0.3, 0.01, 0.2), 0.3),
}


@pytest.mark.parametrize("time", [1e-9, 3.0, 7.0, 9.0, 13.0, 17.0, 25.0, 38.0, 41.0])
@pytest.mark.parametrize("name", COLUMNS)
def test_closed_column_keeps_its_fine_grains(name: str, time: float) -> None:
    profile, fine = COLUMNS[name]
    try:
        means = exact.layer_means(lambda z: profile(z, time), EDGES)
    except ValueError:
        assert name == "hindered"
        assert time > 20.0
        return
    assert means.mean() == pytest.approx(fine, abs=2e-4)
    assert means.min() >= 0.0
    assert means.max() <= 1.0


def test_sorted_column_has_all_fine_grains_below() -> None:
    for name in ("mixed", "stacked"):
        profile, fine = COLUMNS[name]
        z = np.array([0.1, 0.9]) * 0.2
        assert profile(z, 60.0).tolist() == [1.0, 0.0]
        assert profile(np.array([0.2 * fine + 1e-6]), 60.0) == 0.0


def test_fan_between_shocks_by_hand() -> None:
    """Coarse 0.1 m under fine 0.1 m, w t = 0.16 m: shocks at z = 0.1 + w t - 2 sqrt(0.1 w t)."""
    low = 0.1 + 0.16 - 2.0 * math.sqrt(0.016)
    z = np.array([low - 1e-6, low + 1e-6, 0.1, 0.2 - low - 1e-6, 0.2 - low + 1e-6])
    fine = exact.two_kinds_stacked(z, 16.0, 0.1, 0.01, 0.2)
    at_shock = 0.5 * (1.0 + (low - 0.1) / 0.16)
    assert fine == pytest.approx([1.0, at_shock, 0.5, 1.0 - at_shock, 0.0], abs=1e-4)


def test_hindered_shock_runs_at_the_tangent() -> None:
    """From F = 0.4 the tangent to F (1 - F)^2 touches at 0.8: jump and wave move alike."""

    def flux(f: float) -> float:
        return f * (1.0 - f) ** 2

    speed = (1.0 - 0.8) * (3.0 * 0.8 - 1.0)
    assert (flux(0.4) - flux(0.8)) / (0.8 - 0.4) == pytest.approx(speed, rel=1e-12)
    z = 0.01 * speed * 5.0 + np.array([-1e-9, 1e-9])
    fine = exact.hindered_kinds_mixed(z, 5.0, 0.4, 0.01, 0.2)
    assert fine == pytest.approx([0.8, 0.4], abs=1e-6)


@pytest.mark.parametrize("scene", bench.column_scenes(), ids=lambda s: s.title[:2])
def test_engine_and_march_converge_to_the_exact_column(scene: bench.ColumnScene) -> None:
    register("segregation", scene.law.__name__, scene.law, layered=True)
    layers = [16, 32, 64]
    ours, theirs = [], []
    for count in layers:
        column = bench.ClosedColumn(scene, count, 1e-4)
        column.follow()
        load = column.load()
        ours.append(column.error(load))
        march, steps = column.march()
        march.advance(scene.time, steps)
        theirs.append(column.error(march.load))
        assert march.load.sum() == pytest.approx(load.sum(), rel=1e-12)
    for errors in (ours, theirs):
        assert slope(layers, errors) > 0.6  # upwind: between 1/2 and 1 where there are shocks
        assert errors[-1] < 0.08


# --- baselines ---------------------------------------------------------------------------------
@pytest.mark.parametrize("model", MODELS)
def test_column_march_is_of_first_order(model: str) -> None:
    screen = screen_of(model)
    reference = screen.solve_steady().recovery
    march = ColumnMarch(problem_of(screen), engine_nodes(screen))
    steps, errors = [256, 512, 1024, 2048], []
    for count in steps:
        march.run(count)
        errors.append(float(abs(march.recovery - reference).max()))
        assert march.load.min() > -1e-9
        whole = march.load.sum(axis=0) + march.node[PASSED]
        assert whole == pytest.approx(march.fed, rel=1e-12)
    assert slope(steps, errors) == pytest.approx(1.0, abs=0.1)
    assert errors[-1] < 1e-3


@pytest.mark.parametrize("model", ["well_mixed", "exchange"])
def test_heun_march_is_of_second_order(model: str) -> None:
    screen = screen_of(model)
    reference = screen.solve_steady().recovery
    march = ColumnMarch(problem_of(screen), engine_nodes(screen), 2)
    steps, errors = [32, 64, 128], []
    for count in steps:
        march.run(count)
        errors.append(float(abs(march.recovery - reference).max()))
        whole = march.load.sum(axis=0) + march.node[PASSED]
        assert whole == pytest.approx(march.fed, rel=1e-12)
    assert slope(steps, errors) > 1.5
    assert errors[-1] < 1e-4


@pytest.mark.parametrize("model", ["exchange", "proportional"])
def test_cells_at_cfl_1_are_the_column_march(model: str) -> None:
    screen = screen_of(model)
    problem, nodes = problem_of(screen), engine_nodes(screen)
    deck, march = FixedCells(problem, nodes, 48), ColumnMarch(problem, nodes)
    deck.run(1e-6)
    march.run(48)
    assert deck.recovery == pytest.approx(march.recovery, abs=1e-12)


@pytest.mark.parametrize("model", ["exchange", "proportional"])
def test_cells_at_cfl_half_are_of_second_order(model: str) -> None:
    screen = screen_of(model)
    reference = screen.solve_steady().recovery
    columns, errors = [16, 32, 64], []
    for count in columns:
        deck = FixedCells(problem_of(screen), engine_nodes(screen), count, 0.5)
        deck.run(1e-7)
        errors.append(float(abs(deck.recovery - reference).max()))
    assert slope(columns, errors) > 1.5
    assert errors[-1] < 2e-4


def test_cells_hold_what_they_were_fed() -> None:
    """Feed up by a fifth and a slower bed, in steps that do not fit: undersize at the new rate."""
    config = DEFAULT.replace(solver=Solver(1e-9))
    screen = Screen(config)
    nodes = engine_nodes(screen)
    more = Feed(1.2 * config.feed.mass_flow_rate, config.feed.mass_fraction)
    slower = dataclasses.replace(config.motion, frequency=14.0)
    deck = FixedCells(problem_of(screen), nodes, 64, 0.5)
    deck.run(1e-7)
    deck.impose(problem_of(screen, more, slower), nodes)
    deck.let_pass(100.0)
    passed = np.bincount(nodes.class_index, deck.let_pass(7.77), 12) / 7.77
    steady = screen.solve_steady(more, slower).undersize.class_rates
    assert passed == pytest.approx(steady, abs=2e-4 * more.mass_flow_rate)


def test_slices_keep_the_classes_and_converge_to_the_reference() -> None:
    """Nodes of the engine, 24 a piece, against equal slices extrapolated: the same solution."""
    screen = screen_of("exchange", 24)
    reference, problem = screen.solve_steady().recovery, problem_of(screen)
    limits, errors, slices = [], [], [8, 16, 32]
    for count in slices:
        sub = uniform_slices(problem, count)
        assert np.bincount(sub.class_index, sub.fraction) == pytest.approx(
            problem.fraction, abs=1e-15
        )
        march = ColumnMarch(problem, sub)
        march.run(2048)
        coarse = march.recovery
        march.run(4096)
        limits.append(2.0 * march.recovery - coarse)
        errors.append(float(abs(limits[-1] - reference).max()))
    assert slope(slices, errors) == pytest.approx(2.0, abs=0.2)
    finest = (4.0 * limits[-1] - limits[-2]) / 3.0
    assert finest == pytest.approx(reference, abs=2e-6)


# --- the command --------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, dict], Path]:
    folder = tmp_path_factory.mktemp("work_precision")
    return bench.main(folder, quick=True)["scenes"], folder


def test_quick_run_writes_a_report(result: tuple[dict[str, dict], Path]) -> None:
    scenes, folder = result
    assert list(scenes) == ["a", "b", "c1", "c2", "c3", "d", "e", "f1", "f2"]
    written = json.loads((folder / "work_precision.json").read_text())
    assert set(written["scenes"]) == set(scenes)
    assert (folder / "work_precision.png").stat().st_size > 20_000


def test_errors_fall_as_settings_are_refined(result: tuple[dict[str, dict], Path]) -> None:
    scenes, _ = result
    for name, solver in (
        ("a", "ours"),
        ("a", "march"),
        ("a", "cells"),
        ("b", "ours"),
        ("b", "march"),
        *((c, s) for c in ("c1", "c2", "c3") for s in ("ours", "march")),
        *((f, s) for f in ("f1", "f2") for s in ("ours", "cells", "cells_half")),
    ):
        errors = [row["error"] for row in scenes[name][solver]]
        assert len(errors) >= 2
        assert errors[-1] < 0.7 * errors[0], f"scene {name}, {solver}"
    rows = scenes["a"]["march"]
    order = slope([row["steps"] for row in rows], [row["error"] for row in rows])
    assert order == pytest.approx(1.0, abs=0.15)


OURS = ("ours", "ours_bare", "same_ours", "same_ours_bare")


def test_settings_at_a_level_reach_it(result: tuple[dict[str, dict], Path]) -> None:
    scenes, _ = result
    for name in ("d", "e"):
        assert scenes[name]["march_limit_less_reference"] < 2e-4
        for row in scenes[name]["levels"]:
            for solver in (*OURS, "march", "heun", "cells", "same_march"):
                if row[solver] is not None and math.isfinite(row[solver]["error"]):
                    assert row[solver]["error"] <= row["level"]
            assert row["same_ours"] is not None
            assert row["same_ours_bare"] is not None
            assert set(row["ratio"]) >= set(bench.RATIO)
            assert all(ratio > 0.0 for ratio in row["ratio"].values())
    assert scenes["d"]["rmse_to_measured"] < 0.06
    for name in ("f1", "f2"):
        assert scenes[name]["reference_change"] < 1e-4


# --- cost: structure and order, no seconds ------------------------------------------------------
@pytest.fixture(scope="module")
def costs(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    folder = tmp_path_factory.mktemp("step_cost")
    return step_cost.main(3, folder, quick=True), folder


def test_step_cost_writes_a_report(costs: tuple[dict, Path]) -> None:
    result, folder = costs
    written = json.loads((folder / "step_cost.json").read_text())
    assert set(written["steps"]) == set(step_cost.screens())
    assert (folder / "step_cost.png").stat().st_size > 20_000
    for row in result["steps"].values():
        assert tuple(row["us"]) == step_cost.STEPS
        assert all(0.0 < cost < math.inf for cost in row["us"].values())
    assert [row["switch"] for row in result["skips"]] == list(state.SWITCH)
    assert {row["what"] for row in result["targets"]} >= {"new frequency every step, us"}


def test_all_ways_in_are_timed(costs: tuple[dict, Path]) -> None:
    """Python, the FMU's C functions, fmpy; the native runtime driven by a program in C."""
    ways = costs[0]["ways"]
    assert list(ways) == [
        "engine",
        "Screen.advance",
        "Screen.step, with a result",
        "FMU, C calls",
        "FMU, fmpy",
    ]
    for row in ways.values():
        assert list(row) == ["steady scene", "frequency"]
        assert all(0.0 < cost < math.inf for cost in row.values())
    edge, native = costs[0]["edge"], costs[0]["native"]
    assert edge["more"] == pytest.approx(edge["FMU, C calls"] - edge["engine"])
    assert len(native) == 4
    assert all(0.0 < cost < math.inf for cost in native.values())
    assert len(costs[0]["targets"]) >= len(step_cost.TARGET)


def test_every_skip_works_and_changes_nothing(costs: tuple[dict, Path]) -> None:
    for row in costs[0]["skips"]:
        assert row["works"], row
        assert row["difference"] < 1e-4, row
    for counted in costs[0]["steps"]["default"]["counted"].values():
        assert counted["packages_integrated"] > 10.0


def test_error_falls_and_work_rises_with_the_tolerance(costs: tuple[dict, Path]) -> None:
    for rows in costs[0]["steady"].values():
        errors, nodes = [r["error"] for r in rows], [r["nodes"] for r in rows]
        assert errors == sorted(errors, reverse=True)
        assert nodes == sorted(nodes)
        assert all(row["error"] <= row["tolerance"] for row in rows)


def test_work_grows_no_faster_than_the_number_of_layers() -> None:
    """Evaluations of rates, which no clock disturbs: a deeper bed of such layers needs no more."""
    rates = [
        step_cost.Solution(step_cost.deep_deck(n, 0.01 * n, 0.01)).rates() for n in (4, 16, 64)
    ]
    assert step_cost.slope([4, 16, 64], rates) < 0.1


def test_packages_follow_the_cells(costs: tuple[dict, Path]) -> None:
    rows = {row["title"]: row for row in costs[0]["growth"]}
    for title in ("packages", "packages, no spare room"):
        assert rows[title]["number"] == sorted(rows[title]["number"])
    assert all(math.isfinite(row["slope"]) for row in rows.values())


def test_dem_cases_are_those_of_the_data(tmp_path: Path) -> None:
    config, areal_mass, spheres = dem_scale.batch()
    assert spheres == 2317
    assert areal_mass / (2650.0 * 0.58) == pytest.approx(0.035, rel=0.1)  # nominal bed
    assert sum(config.feed.mass_fraction) == pytest.approx(1.0, abs=1e-12)
    found = dem_scale.main(1, tmp_path)
    for row in found["rows"]:
        assert row["ratio"] > 1.0
        assert 0.0 < row["undersize_recovery"] <= 1.0
    steps, steady = found["rows"][1:]
    assert steps["undersize_recovery"] == pytest.approx(steady["undersize_recovery"], abs=1e-4)
    assert json.loads((tmp_path / "dem_scale.json").read_text())["constants_fitted"] is False


def test_start_is_timed_in_fresh_processes(tmp_path: Path) -> None:
    cache = library.cache_folder().parent
    laps = import_time.medians([import_time.run_fresh(import_time.FIRST, cache)])
    assert list(laps) == [
        "import vibroscreen",
        "first screen",
        "first step",
        "first steady solution",
    ]
    assert all(0.0 < lap < math.inf for lap in laps.values())
    with pytest.raises(RuntimeError, match="no_such_module"):
        import_time.run_fresh("import no_such_module", cache)


def test_many_designs_in_short(tmp_path: Path) -> None:
    result = many.main(designs=70, repeat=1, output=tmp_path)
    assert result["same_bits"]
    assert result["designs"] == 70
    assert (tmp_path / "many.json").exists()
    assert (tmp_path / "many.png").stat().st_size > 1000


def test_many_circuits_in_short(tmp_path: Path) -> None:
    result = circuits.main(designs=70, repeat=1, output=tmp_path)
    assert sum(result["status"].values()) == 70
    assert result["worst"] <= 1e-6
    assert (tmp_path / "circuits.json").exists()
    assert (tmp_path / "circuits.png").stat().st_size > 1000


def test_a_search_in_short(tmp_path: Path) -> None:
    found = design.main(population=6, generations=2, repeat=1, output=tmp_path)
    assert list(found) == list(design.ALGORITHMS)
    assert all(6 <= told["evaluations"] <= 12 for told in found.values())
    assert all(told["cpu_s"] > 0.0 < told["optimiser_cpu_s"] for told in found.values())
    assert (tmp_path / "design.json").exists()


def test_a_week_in_short(tmp_path: Path) -> None:
    """Twenty minutes by FMUs: the whole circuit balances, and is the circuit run without them."""
    found = week.main(20 * MINUTE, tmp_path)
    assert abs(found.balance_error) < 1e-12
    sheet = week.flowsheet()
    plant, made = RunningCircuit(sheet), dict.fromkeys(found.made, 0.0)
    for feed in week.feeds(sheet, 20):
        streams = plant.step(week.STEP, {"rock": feed})
        for outlet, product in sheet.leaving.items():
            made[product] += streams[outlet].sum() * week.STEP
    assert plant.fed == pytest.approx(found.fed, rel=1e-12)
    assert found.made == pytest.approx(made, rel=1e-6)
    assert found.held == pytest.approx(plant.held, rel=1e-6)
    assert json.loads((tmp_path / "week.json").read_text())["plant_time"] == 1200.0


def test_an_hour_is_replayed(tmp_path: Path) -> None:
    """Products in steps of 60 s are those of 1 s within the tolerance."""
    found = replay.main(rows=60, compared=5, output=tmp_path)
    assert json.loads((tmp_path / "replay.json").read_text()) == found
    assert found["rows"] == 60
    assert found["worst"] < found["tolerance"]


def test_the_page_is_timed(tmp_path: Path) -> None:
    """Every time of every screen, in Chromium where it is installed."""
    rows = page.main(repeat=2, output=tmp_path)
    assert json.loads((tmp_path / "page.json").read_text())["screens"] == rows
    assert list(rows) == list(page.TARGETS)
    for row in rows.values():
        assert all(0.0 < number < math.inf for number in row.values())
