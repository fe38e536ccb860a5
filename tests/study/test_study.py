"""Studies of circuits: the best design, parts that are kept, and what goes wrong on the way."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pandas.testing import assert_frame_equal
from typer.testing import CliRunner

from tests.places import ROOT
from vibroscreen.circuit import solve_circuit
from vibroscreen.cli import app
from vibroscreen.errors import ConfigError, InputError
from vibroscreen.study import Axis, Study, collect, run, runner
from vibroscreen.study.pictures import ENERGY, best_of, draw_study, front_of

CIRCUITS = ROOT / "plant_examples" / "circuits"
TEXT = """
name = "settings"
circuit = "closed.toml"
plan = "{plan}"
designs = 60
seed = 3
[[axis]]
key = "crusher.closed_side_setting_mm"
from = 12
to = 18
count = 8
[[axis]]
key = "screen.deck[1].panel[1].aperture_mm"
values = [15, 16, 18]
"""


def study(plan: str = "grid") -> Study:
    return Study.loads(TEXT.format(plan=plan), CIRCUITS)


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts of ten designs."""
    monkeypatch.setattr(runner, "CHUNK", 10)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """The study in one go, in one part."""
    folder = tmp_path_factory.mktemp("whole")
    run(study(), folder)
    return collect(study(), folder)


def test_designs_are_those_of_the_circuit_one_by_one(whole: pd.DataFrame) -> None:
    plan = study()
    assert len(whole) == plan.count == 24
    for design in (0, 13, 23):
        row = whole.iloc[design]
        numbers = {
            "crusher.closed_side_setting": row["crusher.closed_side_setting_mm"] / 1000,
            "screen.deck[1].panel[1].aperture": row["screen.deck[1].panel[1].aperture_mm"] / 1000,
        }
        alone = solve_circuit(plan.fast.with_values(numbers)).frame().iloc[0]
        assert row["status"] == alone["status"]
        assert row["circulating load, %"] == pytest.approx(alone["circulating load, %"], abs=0.05)


def test_the_best_is_closed_and_within_capacity(whole: pd.DataFrame) -> None:
    """The least energy of all rows is not it, if that one chokes: such rows have none."""
    best = best_of(whole)
    assert best is not None
    closed = whole[whole["status"] == "closed"]
    assert "over capacity" in set(whole["status"])
    assert whole[ENERGY][best] == closed[ENERGY].min()
    front = whole.loc[front_of(whole)]
    assert front.index[0] == best
    for _, row in closed.iterrows():
        beaten = (front[ENERGY] <= row[ENERGY]) & (
            front["circulating load, %"] <= row["circulating load, %"]
        )
        assert beaten.any()
    assert best_of(whole[whole["status"] != "closed"].reset_index(drop=True)) is None


@pytest.mark.usefixtures("small_parts")
def test_parts_however_they_are_solved_are_the_same(whole: pd.DataFrame, tmp_path: Path) -> None:
    """One after the other, by threads, by processes, by two runs that share, and resumed."""
    plan = study()
    run(plan, tmp_path / "here")
    with ThreadPoolExecutor(2) as threads:
        run(plan, tmp_path / "threads", executor=threads)
    with ProcessPoolExecutor(2, get_context("spawn")) as processes:
        run(plan, tmp_path / "processes", executor=processes)
    run(plan, tmp_path / "shared", part=(2, 2))
    with pytest.raises(InputError, match=r"lacks 2 of 3 parts, the first is part-000000\.parquet"):
        collect(plan, tmp_path / "shared")
    run(plan, tmp_path / "shared", part=(1, 2))
    run(plan, tmp_path / "resumed")
    (tmp_path / "resumed" / "part-000001.parquet").unlink()
    (tmp_path / "resumed" / "part-000002.parquet").write_bytes(b"PAR1 cut off")
    with pytest.warns(UserWarning, match=r"part-000002\.parquet is damaged: it is solved again"):
        run(plan, tmp_path / "resumed")
    for name in ("here", "threads", "processes", "shared", "resumed"):
        assert_frame_equal(collect(plan, tmp_path / name), whole, check_exact=True)


@pytest.mark.parametrize("plan", ["random", "latin", "sobol"])
def test_plans_fill_the_axes_and_repeat(plan: str) -> None:
    one, again = study(plan).table(), study(plan).table()
    for key, column in one.items():
        np.testing.assert_array_equal(column, again[key])
        assert column.size == 60
    setting = one["crusher.closed_side_setting_mm"]
    assert 12 <= setting.min() < 12.7
    assert 17.3 < setting.max() < 18
    assert set(one["screen.deck[1].panel[1].aperture_mm"]) == {15, 16, 18}
    if plan == "latin":  # one in each of 60 strata
        assert sorted(((setting - 12) / 0.1).astype(int)) == list(range(60))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            'key = "crusher.closed_side_setting_mm"',
            'key = "crusher.css_mm"',
            "is no number of the ci",
        ),
        ("from = 12", "", "has to: give values, or from and to"),
        ("from = 12", "from = 19", "from = 19 is not less than to = 18: swap them"),
        ('"closed.toml"', '"none.toml"', "circuit = 'none.toml' cannot be read"),
        ('plan = "grid"', 'plan = "grids"', "plan = 'grids' is unknown: give one of grid, random"),
        ("designs = 60", "design = 60", "design is unknown: did you mean designs?"),
    ],
)
def test_a_study_that_is_none_is_told(old: str, new: str, said: str) -> None:
    text = TEXT.format(plan="grid")
    assert old in text
    with pytest.raises(ConfigError) as error:
        Study.loads(text.replace(old, new), CIRCUITS)
    assert said in str(error.value)
    with pytest.raises(ConfigError, match="the grid has 100000000 designs"):
        Study(
            circuit=study().circuit,
            axes=tuple(
                Axis(key=f"{key}", low=1.0, high=2.0, count=10_000)
                for key in ("crusher.closed_side_setting_mm", "fresh.rate_t_h")
            ),
        )


@pytest.mark.usefixtures("small_parts")
def test_a_folder_belongs_to_one_study_and_one_run(tmp_path: Path) -> None:
    plan = study()
    run(plan, tmp_path, part=(1, 3))
    with pytest.raises(InputError, match="holds another study, or an earlier state of this one"):
        run(study("random"), tmp_path)
    with (
        runner._alone(tmp_path, "run-1-of-1.lock"),
        pytest.raises(InputError, match="another run writes into"),
    ):
        run(plan, tmp_path)
    (tmp_path / "study.json").unlink()
    with pytest.raises(InputError, match=r"holds parts without study\.json"):
        run(plan, tmp_path)


@pytest.mark.usefixtures("small_parts")
def test_a_full_disk_loses_nothing(tmp_path: Path) -> None:
    """The second part is written to where the system says that no space is left."""
    plan = study()
    (tmp_path / f".part-000001.parquet.{os.getpid()}").symlink_to("/dev/full")
    with pytest.raises(InputError, match="has no room left: 1 parts are kept"):
        run(plan, tmp_path)
    assert sorted(p.name for p in tmp_path.glob("*part*")) == ["part-000000.parquet"]
    run(plan, tmp_path)
    assert len(collect(plan, tmp_path)) == plan.count


def test_a_killed_run_goes_on(whole: pd.DataFrame, tmp_path: Path) -> None:
    """kill -9 after the first part: what is there is kept, the rest is solved."""
    file = tmp_path / "study.toml"
    file.write_text(TEXT.format(plan="grid").replace("closed.toml", str(CIRCUITS / "closed.toml")))
    script = (
        "import sys, time; from pathlib import Path\n"
        "from vibroscreen.study import Study, run, runner\n"
        "runner.CHUNK = 10\n"
        "def wait(done, total):\n"
        "    print(done, flush=True)\n"
        "    time.sleep(60 if done == 10 else 0)\n"
        "run(Study.load(sys.argv[1]), Path(sys.argv[2]), progress=wait)\n"
    )
    folder = tmp_path / "parts"
    command = [sys.executable, "-c", script, str(file), str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert [process.stdout.readline().strip() for _ in range(2)] == ["0", "10"]
        process.send_signal(signal.SIGKILL)
    monkey = pytest.MonkeyPatch()
    with monkey.context() as patch:
        patch.setattr(runner, "CHUNK", 10)
        seen: list[int] = []
        run(Study.load(file), folder, progress=lambda done, total: seen.append(done))
        assert seen == [10, 20, 24]
        assert_frame_equal(collect(Study.load(file), folder), whole, check_exact=True)


# --- a cluster -------------------------------------------------------------------------------------
@pytest.fixture
def cluster() -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler on this machine and two workers, each in a process of its own."""
    path = os.pathsep.join([str(ROOT), *(str(ROOT / p) for p in ("engine", "fmu_src"))])
    environment = {**os.environ, "PYTHONPATH": path}
    started: list[subprocess.Popen[bytes]] = []

    def start(*arguments: str) -> None:
        command = [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], *arguments[1:]]
        quiet = subprocess.DEVNULL
        started.append(subprocess.Popen(command, env=environment, stdout=quiet, stderr=quiet))

    from socket import socket

    with socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    start("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
    address = f"tcp://127.0.0.1:{port}"
    for _ in range(2):
        start("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
    try:
        yield address, started
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
def test_a_cluster_that_loses_a_worker_loses_nothing(
    cluster: tuple[str, list[subprocess.Popen[bytes]]], whole: pd.DataFrame, tmp_path: Path
) -> None:
    from distributed import Client

    address, (_, _, worker) = cluster
    with Client(address, timeout=60, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        pool = client.get_executor(retries=5)
        monkey = pytest.MonkeyPatch()
        with monkey.context() as patch:
            patch.setattr(runner, "CHUNK", 10)

            def lose(done: int, total: int) -> None:
                if done == 10:
                    worker.kill()

            run(study(), tmp_path, executor=pool, progress=lose)
            found = collect(study(), tmp_path)
    assert worker.wait(10) != 0
    assert_frame_equal(found, whole, check_exact=True)


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
@pytest.mark.usefixtures("small_parts")
def test_a_cluster_that_is_restarted_goes_on(whole: pd.DataFrame, tmp_path: Path) -> None:
    """The first cluster is closed after a part; the next one solves what is missing."""
    from distributed import Client, LocalCluster

    runs: list[list[int]] = []
    for _ in range(2):
        with (
            LocalCluster(
                n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
            ) as workers,
            Client(workers, set_as_default=False) as client,
        ):
            runs.append([])

            def close(done: int, total: int, client: Client = client) -> None:
                runs[-1].append(done)
                if len(runs) == 1 and done:
                    client.close()

            gone = pytest.raises(InputError, match=r"lost its workers.*goes on from there")
            with gone if len(runs) == 1 else contextlib.nullcontext():
                run(study(), tmp_path, executor=client.get_executor(), progress=close)
    assert 0 < runs[0][-1] == runs[1][0] < runs[1][-1] == 24
    assert_frame_equal(collect(study(), tmp_path), whole, check_exact=True)


# --- the command -----------------------------------------------------------------------------------
def test_the_command_tells_best_and_why_not(tmp_path: Path) -> None:
    file = tmp_path / "study.toml"
    file.write_text(TEXT.format(plan="grid").replace("closed.toml", str(CIRCUITS / "closed.toml")))
    picture, csv = tmp_path / "map.png", tmp_path / "all.csv"
    said = CliRunner().invoke(
        app, ["study", str(file), "--plot", str(picture), "--csv", str(csv)], catch_exceptions=False
    )
    assert said.exit_code == 0, said.output
    text = " ".join(said.stdout.split())
    assert "settings: 24 designs of closed crushing circuit" in text
    assert "over capacity, such as design" in text
    assert "Of least energy: design" in text
    assert "Run from empty for 60 min:" in text
    assert picture.stat().st_size > 10_000
    assert len(pd.read_csv(csv)) == 24
    told = CliRunner().invoke(app, ["study", str(file), "--no-check", "--json"])
    best = json.loads(told.stdout)["best"]
    assert f"design {best['design']}" in text
    wrong = CliRunner().invoke(app, ["study", str(file), "--part", "3/2"])
    assert wrong.exit_code == 2
    assert "is not K/N with K from 1 to N" in " ".join(wrong.output.split())


@pytest.mark.parametrize("plan", ["grid", "sobol"])
def test_pictures_show_what_cannot_be_run(plan: str, tmp_path: Path) -> None:
    run(study(plan), tmp_path)
    figure = draw_study(study(plan), collect(study(plan), tmp_path))
    assert len(figure.axes) >= 2
    figure.savefig(tmp_path / "study.png")
