"""A month of 1-minute data through a screen: how long it takes, and in how much memory.

    python tests/benchmarks/replay.py [--screen FILE] [--rows 43200] [--quick] [--output DIR]

The data are made up: feed rate and gradation with noise, a stop each night, cells that are empty or
no numbers, rows that are missing, a belt scale on the undersize. Read from CSV, written to parquet.
Beside it: some hours in steps of 60 s and of 1 s, whose products should differ by less than the
tolerance. Times are those of the processor, on one core. Writes replay.json.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import pandas as pd

from tests.benchmarks.output import write_json
from tests.places import SCREENS
from vibroscreen import Feed, Motion, Screen, ScreenConfig
from vibroscreen.replay import PlantData, Summary, read_plant, replay, table_file
from vibroscreen.replay.run import moments
from vibroscreen.units import MM, T_H

KIB = 1024.0


def export(config: ScreenConfig, rows: int) -> pd.DataFrame:
    """What a historian might hold: `rows` minutes, a hundredth of them missing or spoilt."""
    rng = np.random.default_rng(0)
    minutes = np.arange(rows)
    rate = config.feed.mass_flow_rate / T_H * (1.0 + 0.1 * np.sin(minutes / 300.0))
    rate = rate * (1.0 + 0.03 * rng.standard_normal(rows))
    rate[minutes % 1440 < 60] = 0.0
    coarser = 1.0 - np.cumsum(config.feed.mass_fraction)[:-1]
    exponent = np.exp(0.05 * rng.standard_normal(rows) + 0.1 * np.sin(minutes / 700.0))
    passing = 1.0 - coarser[None, :] ** exponent[:, None]
    inner = config.size_classes.edges[1:-1]
    found = pd.DataFrame({"time": pd.date_range("2024-05-01", periods=rows, freq="1min")})
    found["rate_t_h"] = [f"{one:.1f}" for one in rate]
    for k, edge in enumerate(inner):
        found[f"passing_{edge / MM:g}_mm"] = (100.0 * passing[:, k]).round(4)
    found["undersize_t_h"] = (0.45 * rate * (1.0 + 0.05 * rng.standard_normal(rows))).round(1)
    spoilt = rng.random(rows)
    found.loc[spoilt < 0.004, "rate_t_h"] = ""
    found.loc[(spoilt > 0.004) & (spoilt < 0.006), "rate_t_h"] = "Bad"
    return found[spoilt < 0.996]


def worst_apart(config: ScreenConfig, plant: PlantData, rows: int) -> float:
    """Largest difference of a product by class and row, 60 s steps against 1 s, over the duty."""
    coarse, fine, worst = Screen(config), Screen(config), 0.0
    for (feed, motion), lasts in zip(moments(config, plant), plant.lasts[:rows], strict=False):
        once = products(coarse, lasts, feed, motion)
        steps = round(lasts)
        means = sum(products(fine, lasts / steps, feed, motion) for _ in range(steps)) / steps
        worst = max(worst, float(abs(once - means).max()))
    return worst / config.feed.mass_flow_rate


def products(screen: Screen, dt: float, feed: Feed, motion: Motion) -> np.ndarray:
    """Products of a step by class [kg/s]."""
    result = screen.step(dt, feed, motion)
    return np.array([stream.class_rates for stream in result.products.values()])


def peak() -> float:
    """The most memory that this process has had so far [MiB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / KIB


def main(
    rows: int = 43_200,
    compared: int = 180,
    screen: Path = SCREENS / "quarry.toml",
    output: Path | None = None,
) -> dict[str, float]:
    """Measure, print, and write into `output` if it is given."""
    config = ScreenConfig.load(screen)
    Screen(config).step(1.0)  # the engine is there
    with tempfile.TemporaryDirectory() as folder:
        export(config, rows).to_csv(Path(folder, "plant.csv"), index=False)
        begin = time.process_time()
        plant = read_plant(Path(folder, "plant.csv"), config)
        read, before = time.process_time() - begin, peak()
        summary = Summary(tuple(plant.products))
        with table_file(Path(folder, "month.parquet")) as write:
            for part in replay(config, plant):
                summary.add(part)
                write(part)
        ran = time.process_time() - begin - read
        size = Path(folder, "month.parquet").stat().st_size / KIB**2
    found = {
        "rows": summary.rows,
        "filled": summary.filled,
        "read_s": read,
        "run_s": ran,
        "row_ms": 1e3 * ran / summary.rows,
        "memory_mib": before,
        "more_memory_mib": peak() - before,
        "file_mib": size,
        "worst": worst_apart(config, plant, compared),
        "tolerance": config.solver.tolerance,
    }
    print(f"{config.name}: {summary.rows} rows of {plant.interval:g} s, {summary.filled} filled in")
    print(f"read {read:.1f} s, run and written {ran:.1f} s, {found['row_ms']:.2f} ms a row")
    print(f"memory {before:.0f} MiB, {found['more_memory_mib']:.0f} MiB more by the run")
    print(
        f"60 s steps against 1 s over {compared} rows: products differ by at most "
        f"{found['worst']:.1e} of the feed, tolerance {found['tolerance']:g}"
    )
    if output is not None:
        write_json(output, "replay", found)
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--screen", type=Path, default=SCREENS / "quarry.toml")
    parser.add_argument("--rows", type=int, default=43_200)
    parser.add_argument("--quick", action="store_true", help="an hour, for a test")
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    short = {"rows": 60, "compared": 5} if given.quick else {"rows": given.rows}
    main(screen=given.screen, output=given.output, **short)
