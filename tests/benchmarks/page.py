"""How fast the page of a screen is: the first picture, a move of a slider, steps of a running screen.

    python tests/benchmarks/page.py [--repeat N] [--output DIR]

In headless Chromium, from a file. Times are medians of the wall clock, so the machine should have
nothing else to do: from the start of the page until the browser has painted the first picture;
from the event of a slider until it has painted what came of it, with the processor time of the
page's thread in it; of the steady state and the bed along the decks; and of a step of 1 s of a
running screen under a feed that changes. Targets: 1 s; 50 ms for the default screen and 150 ms for
two decks. Writes page.json.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from rich.console import Console
from rich.table import Table

from tests.benchmarks.output import write_json
from tests.explorer.browsers import WIDE, ChromiumPage, chromium
from tests.places import SCREENS
from vibroscreen import ScreenConfig
from vibroscreen.explorer import write_page

# Milliseconds.
TARGETS = {"quarry": 50.0, "two_deck": 150.0, "banana": 150.0}
FIRST_PICTURE = 1000.0
# Until the browser has painted: after the next frame, when what it does in between is done.
PAINTED = "new Promise((done) => requestAnimationFrame(() => setTimeout(done)))"
FIRST = "performance.getEntriesByName('first picture')[0].startTime"
SLIDE = f"""(async (count) => {{
    const slider = sliderOf(0), first = Number(slider.value), times = [];
    for (let k = 0; k < count; k++) {{
        slider.value = first * (1 + 0.1 * Math.sin(k));
        const start = performance.now();
        slider.dispatchEvent(new Event("input", {{ bubbles: true }}));
        const solved = performance.now();
        await {PAINTED};
        times.push(performance.now() - start);
        await new Promise((done) => setTimeout(done, 50));
    }}
    return times;
}})"""
ALONE = """((count) => {
    const start = performance.now();
    for (let k = 0; k < count; k++) { wanted[steady.at("input", "feed_mass_flow_rate")] = 60 + k; solve(); }
    return (performance.now() - start) / count;
})"""
STEPS = """((count) => {
    begin();
    advance(60);
    const start = performance.now();
    for (let k = 0; k < count; k++) { wanted[steady.at("input", "feed_mass_flow_rate")] = 60 + k % 7; advance(1); }
    return (performance.now() - start) / count;
})"""


def main(repeat: int = 40, output: Path | None = None) -> dict[str, Any]:
    """Measure the three screens and print a table."""
    rows: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        for name, target in TARGETS.items():
            config = ScreenConfig.load(SCREENS / f"{name}.toml")
            path = write_page(config, Path(folder, f"{name}.html"))
            first = []
            for _ in range(max(1, repeat // 8)):
                page = ChromiumPage(browser, path, WIDE)
                first.append(page.run(FIRST))
                page.page.close()
            page = ChromiumPage(browser, path, WIDE)
            sliding, busy = _slide(page, repeat)
            rows[name] = {
                "bytes": path.stat().st_size,
                "first_picture_ms": statistics.median(first),
                "slider_to_picture_ms": sliding,
                "slider_processor_ms": busy,
                "target_ms": target,
                "steady_with_profile_ms": page.run(f"{ALONE}({repeat})"),
                "step_ms": page.run(f"{STEPS}({5 * repeat})"),
            }
            page.page.close()
    table = Table(title=f"first picture: target {FIRST_PICTURE:g} ms")
    for column in ("screen", "MB", "first picture, ms", "slider to picture, ms (target)"):
        table.add_column(column, justify="right")
    for column in ("processor time, ms", "steady state and bed, ms", "step, ms"):
        table.add_column(column, justify="right")
    for name, row in rows.items():
        table.add_row(
            name,
            f"{row['bytes'] / 1e6:.2f}",
            f"{row['first_picture_ms']:.0f}",
            f"{row['slider_to_picture_ms']:.0f} ({row['target_ms']:.0f})",
            f"{row['slider_processor_ms']:.0f}",
            f"{row['steady_with_profile_ms']:.2f}",
            f"{row['step_ms']:.2f}",
        )
    Console(width=120).print(table)
    if output is not None:
        write_json(output, "page", {"screens": rows, "first_picture_target_ms": FIRST_PICTURE})
    return rows


def _slide(page: ChromiumPage, repeat: int) -> tuple[float, float]:
    """Time from a slider to the picture, and processor time of the page's thread in it, ms."""
    tools = page.page.context.new_cdp_session(page.page)
    tools.send("Performance.enable", {"timeDomain": "threadTicks"})

    def busy() -> float:
        found = {
            row["name"]: row["value"] for row in tools.send("Performance.getMetrics")["metrics"]
        }
        return 1e3 * float(found["TaskDuration"])

    before = busy()
    times = page.run(f"{SLIDE}({repeat})")
    return statistics.median(times), (busy() - before) / repeat


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeat", type=int, default=40)
    parser.add_argument("--output", type=Path, default=Path("dist/benchmarks"))
    given = parser.parse_args()
    main(given.repeat, given.output)
