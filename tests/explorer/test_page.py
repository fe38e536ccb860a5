"""The page with the engine inside: the bits of Python, its messages, and what people do with it.

All expected numbers and texts are what Python says of the same screen, found while the test runs.
"""

from __future__ import annotations

import hashlib
import random
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.explorer.browsers import NARROW, WIDE, ChromiumPage, FirefoxPage, Page, chromium, firefox
from tests.places import ROOT, SCREENS
from vibroscreen import ConfigError, InputError, Screen, ScreenConfig, explorer, register
from vibroscreen.fields import to_si
from vibroscreen.kernels import library
from vibroscreen.screen import roomy_layout
from vibroscreen.sections import Displacement, Passage
from vibroscreen.units import T_H

NAMES = ("quarry", "two_deck", "banana")
LARGEST = 2.5e6  # bytes of a page


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    return {
        name: explorer.write_page(
            ScreenConfig.load(SCREENS / f"{name}.toml"), folder / f"{name}.html"
        )
        for name in NAMES
    }


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.fixture
def quarry(browser: Any, pages: dict[str, Path]) -> Iterator[ChromiumPage]:
    page = ChromiumPage(browser, pages["quarry"], WIDE)
    yield page
    page.page.close()


# --- bits ---------------------------------------------------------------------------------------
# Hash of numbers of a buffer, given as [from, how many].
HASH = """(async (buffer, parts) => {
    const found = new Float64Array(parts.reduce((total, [, size]) => total + size, 0));
    let at = 0;
    for (const [start, size] of parts) {
        found.set(buffer.numbers.subarray(start, start + size), at);
        at += size;
    }
    const hash = await crypto.subtle.digest("SHA-256", found);
    return Array.from(new Uint8Array(hash), (x) => x.toString(16).padStart(2, "0")).join("");
})"""
OF_STEADY = ("output", "undersize_fraction", "oversize_fraction", "intermediate_fraction")
OF_STEADY += ("intermediate", "deck_result", "step_mass")


def hashed(*parts: np.ndarray) -> str:
    return hashlib.sha256(
        b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    ).hexdigest()


def places(config: ScreenConfig, screen: Screen, names: tuple[str, ...], *, packages: bool) -> list:
    """Where fields lie in a buffer of the page, and how many of their numbers this screen has."""
    layout, own = (
        roomy_layout(config, packages=packages),
        screen.layout if packages else screen._column,
    )
    return [[layout.offset[name], int(np.prod(own.shape[name]))] for name in names]


def sliders(page: Page) -> list[dict[str, Any]]:
    return page.run("CONTROLS")


def typed(control: dict[str, Any], rng: random.Random) -> str:
    """A number within the inner part of a slider, as somebody would type it."""
    low, high = control["low"], control["high"]
    share = rng.uniform(0.4, 0.65)
    return f"{low + share * (high - low):.4g}"


def said(page: Page) -> str:
    """What the page says is wrong."""
    return page.run("byId('said').textContent")


def alarms_of(reasons: Mapping[str, str]) -> list[str]:
    return [f"{name}: {reason}" for name, reason in reasons.items()]


def solve_scenes(page: Page, name: str, count: int) -> None:
    """Steady scenes with all numbers changed: the page's TOML, in Python, gives the page's bits."""
    rng, controls = random.Random(name), sliders(page)
    solved = 0
    for _ in range(count):
        sets = "".join(f"setNumber({k}, {typed(c, rng)!r});" for k, c in enumerate(controls))
        page.run(
            f"(() => {{ {sets} setFeed(finerBy({rng.uniform(-1.0, 1.0)})); renew(); }})() ?? 1"
        )
        config = ScreenConfig.loads(page.run("toml()"))
        screen = Screen(config)
        try:
            steady = screen.solve_steady()
        except InputError:
            assert said(page) != ""
            continue
        assert said(page) == ""
        assert page.run("shown.alarms") == alarms_of(steady.alarm_reasons)
        # The page has followed the slice along the decks since it solved this.
        page.run("(() => { steady.clear('seen'); steady.run(DO.SOLVE); })() ?? 1")
        fields = {n: screen._column.view(screen._column_buffer, n) for n in OF_STEADY}
        parts = places(config, screen, OF_STEADY, packages=False)
        assert page.run(f"{HASH}(steady, {parts})") == hashed(*fields.values())
        solved += 1
    assert solved > 0.7 * count


def run_steps(page: Page, name: str, count: int) -> None:
    """Restless steps: streams of each and the state after the last are those of Python."""
    rng = random.Random(name)
    config = ScreenConfig.load(SCREENS / f"{name}.toml")
    screen = Screen(config)
    live = [(k, c) for k, c in enumerate(sliders(page)) if c["live"] and rng.random() < 0.7]
    page.run("(() => { putBack(initial); begin(); })() ?? 1")
    settings = page.run("SCREEN.settings")
    streams = places(config, screen, OF_STEADY[:-1], packages=True)
    for _ in range(count):
        for k, control in live:
            if rng.random() < 0.15:
                text = typed(control, rng)
                page.run(f"setNumber({k}, {text!r}) ?? 1")
                factor = settings[control["place"]]["factor"]
                place = screen.layout.section["parameters"].start + control["place"]
                screen.buffer[place] = to_si(float(text), factor)
        duration = rng.uniform(0.2, 3.0)
        screen.step(duration)
        page.run(f"advance({duration}) ?? 1")
        expected = hashed(*(screen.view(n) for n in OF_STEADY[:-1]))
        assert page.run(f"{HASH}(running, {streams})") == expected
    first, last = screen.layout.persistent.start, screen.layout.persistent.stop
    names = [n for n, offset in screen.layout.offset.items() if first <= offset < last]
    state = places(config, screen, tuple(names), packages=True)
    assert page.run(f"{HASH}(running, {state})") == hashlib.sha256(screen.state).hexdigest()


@pytest.mark.parametrize("name", NAMES)
def test_steady_scenes_have_the_bits_of_python(
    browser: Any, pages: dict[str, Path], name: str
) -> None:
    solve_scenes(ChromiumPage(browser, pages[name], WIDE), name, 50)


@pytest.mark.parametrize("name", NAMES)
def test_running_steps_have_the_bits_of_python(
    browser: Any, pages: dict[str, Path], name: str
) -> None:
    run_steps(ChromiumPage(browser, pages[name], WIDE), name, 300)


def test_a_table_of_velocities_follows_the_apertures(browser: Any, tmp_path: Path) -> None:
    """Another velocity on every panel, and a number that the table does not have."""
    table = ((0.002, 0.05), (0.008, 0.08), (0.0163, 0.1), (0.05, 0.15))  # m, m/s
    config = ScreenConfig.load(SCREENS / "two_deck.toml")
    config = config.replace(passage=Passage(velocity_table=table))
    page = ChromiumPage(browser, explorer.write_page(config, tmp_path / "page.html"), WIDE)
    solve_scenes(page, "table", 5)
    page.run("(() => { putBack(initial); begin(); advance(7); advance(7); })() ?? 1")
    screen = Screen(config)
    screen.step(7.0), screen.step(7.0)
    assert page.run("running.record('output')")["hold_up"] == screen.record("output").hold_up
    page.run(f"setNumber({control_of(page, 'aperture')}, '450') ?? 1")
    assert said(page).startswith(
        "deck[1].panel[1].aperture_mm = 450 lies outside of passage.velocity_table, which ends at 50 mm"
    )


# What drives Firefox leaves sockets to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("name", NAMES)
def test_firefox_has_the_bits_of_python(pages: dict[str, Path], name: str) -> None:
    with firefox() as browser:
        page = FirefoxPage(browser, pages[name])
        solve_scenes(page, name, 10)
        run_steps(page, name, 60)


def test_a_profile_is_that_of_python(quarry: ChromiumPage) -> None:
    """Depth of the bed and what has passed along the deck, on the way from feed to discharge."""
    steady = Screen(ScreenConfig.load(SCREENS / "quarry.toml")).solve_steady()
    (profile,) = steady.profiles
    depth = quarry.run("curves(shown).bed[0][1]")
    assert depth == pytest.approx(1e3 * profile.depth, rel=1e-12)
    finer = steady.config.size_classes.upper <= steady.aperture
    fed = profile.load[0][:, finer].sum()  # nothing has passed there
    passed = quarry.run("curves(shown).recovery[0][1]")
    assert passed == pytest.approx(100.0 * profile.passed[:, finer].sum(axis=1) / fed, rel=1e-9)


# --- what is refused ----------------------------------------------------------------------------
def control_of(page: Page, label: str) -> int:
    return next(k for k, control in enumerate(sliders(page)) if control["label"] == label)


def rigid(path: Path) -> ScreenConfig:
    """A screen whose bed rides as a rigid body, which not every slope allows."""
    tree = tomllib.loads(path.read_text(encoding="utf-8"))
    tree["displacement"] = {"model": "rigid_body"}
    return ScreenConfig.from_dict(tree)


@pytest.mark.parametrize(
    ("label", "text"),
    [
        ("rate", "-5"),
        ("rate", "300000"),
        ("rate", "1e999"),
        ("frequency", "930"),
        ("frequency", "-1"),
        ("stroke", "500"),
        ("throw angle", "400"),
        ("inclination", "60"),
        ("aperture", "0.016"),
        ("aperture", "16000"),
        ("aperture", "7000"),
        ("open area", "55"),
        ("open area", "1"),
    ],
)
def test_a_refused_number_is_told_as_of_a_file(quarry: ChromiumPage, label: str, text: str) -> None:
    """Number, range and cure in the unit of the key; the pictures stay as they were."""
    k = control_of(quarry, label)
    before = quarry.run("[shown.output, toml()]")
    quarry.run(f"setNumber({k}, {text!r}) ?? 1")
    *where, last = sliders(quarry)[k]["where"]
    tree = quarry.run("SCREEN.tree")
    table = tree
    for step in where:
        table = table[step]
    table[last] = float(text)
    try:
        Screen(ScreenConfig.from_dict(tree)).solve_steady()
        expected = ""
    except (ConfigError, InputError) as error:
        expected = str(error)
    assert said(quarry) == expected
    assert expected != ""
    assert quarry.run("shown.output") == before[0]
    assert quarry.run(f"fieldOf({k}).getAttribute('aria-invalid')") == "true"
    quarry.run(f"setNumber({k}, '{sliders(quarry)[k]['value']}') ?? 1")
    assert [said(quarry), quarry.run("[shown.output, toml()]")] == ["", before]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"rate": "0"}, "feed.rate_t_h = 0 has no steady separation: give a positive feed"),
        (
            {"frequency": "0"},
            "motion.frequency_hz = 0, motion.stroke_mm = 10 do not convey, so there is no steady "
            "state: raise them, turn the throw angle down-slope, or use displacement.model = "
            '"prescribed"',
        ),
        (
            {"stroke": "abc"},
            "motion.stroke_mm = 'abc' is not a number (0 to 200 mm): give a number in this range",
        ),
        (
            {"stroke": " "},
            "motion.stroke_mm = ' ' is not a number (0 to 200 mm): give a number in this range",
        ),
    ],
)
def test_what_no_file_is_refused_for(
    quarry: ChromiumPage, changes: dict[str, str], expected: str
) -> None:
    for label, text in changes.items():
        quarry.run(f"setNumber({control_of(quarry, label)}, {text!r}) ?? 1")
    assert said(quarry) == expected


def test_a_body_that_stays_is_told_which_model_rides(browser: Any, tmp_path: Path) -> None:
    """Circular motion on a slope: Python says the same, in the names of variables."""
    config = rigid(ROOT / "tests" / "data" / "cases" / "circular_inclined.toml")
    page = ChromiumPage(browser, explorer.write_page(config, tmp_path / "page.html"), WIDE)
    with pytest.raises(InputError) as raised:
        Screen(config).solve_steady()
    wanted = str(raised.value).replace("motion.frequency = 15 Hz", "motion.frequency_hz = 15")
    assert said(page) == wanted.replace("motion.amplitude = 0.005 m", "motion.stroke_mm = 10")
    assert "grains ride down at" in wanted


def test_passing_never_falls(quarry: ChromiumPage) -> None:
    """A gradation as it was typed: the engine gets its differences."""
    quarry.run("setPassing(7, '50') ?? 1")
    assert said(quarry) == ""
    shares = ScreenConfig.loads(quarry.run("toml()")).feed.mass_fraction
    assert sum(shares[:7]) == pytest.approx(0.5, abs=1e-12)
    quarry.run("setPassing(7, '20') ?? 1")
    assert re.fullmatch(
        r"passing at 16 mm = 20 % does not lie between those at the sizes beside it \(\S+ to \S+ %\): "
        "passing never falls with size",
        said(quarry),
    )


def test_a_refused_change_leaves_a_running_screen_as_it_runs(browser: Any, tmp_path: Path) -> None:
    config = rigid(SCREENS / "quarry.toml")
    page = ChromiumPage(browser, explorer.write_page(config, tmp_path / "page.html"), WIDE)
    page.run("(() => { begin(); advance(5); })() ?? 1")
    angle = control_of(page, "inclination")
    page.run(f"setNumber({angle}, '30') ?? 1")
    tree = page.run("SCREEN.tree")
    tree["deck"][0]["panel"][0]["inclination_deg"] = 30.0
    with pytest.raises(ConfigError) as raised:
        ScreenConfig.from_dict(tree)
    assert said(page) == str(raised.value)
    text = "(() => { try { advance(5); } catch (fault) { return fault.text; } })()"
    assert page.run(text) == str(raised.value)
    screen = Screen(config)
    screen.step(5.0), screen.step(5.0)
    assert page.run("running.record('output').hold_up") == screen.record("output").hold_up


# --- the page -----------------------------------------------------------------------------------
def test_the_page_is_alone_and_quiet(browser: Any, pages: dict[str, Path]) -> None:
    """No request, no error, no warning, in both modes; small enough to send by mail."""
    for name, path in pages.items():
        assert path.stat().st_size < LARGEST
        page = ChromiumPage(browser, path, WIDE)
        page.page.check("[value=running]")
        page.page.select_option("#speed", "1000")
        page.wait("clock > 100")
        page.page.check("[value=steady]")
        assert page.requests == [path.as_uri()], name
        assert page.errors == []
        assert [text for kind, text in page.console if kind in ("error", "warning")] == []
        assert "NaN" not in page.page.inner_text("body")
        page.page.close()


HOSTILE = """</title><script>window.broken = 1</script><img src=x onerror="window.broken = 2">
{{ 7 * 7 }} "quoted" 'single' & \\ \u2028 """


def test_hostile_names_are_text(browser: Any, tmp_path: Path) -> None:
    """A name with tags and quotes, and a very long one, are shown and written as they are."""
    for name in (HOSTILE, "long " * 2000 + "x" * 5000):
        config = ScreenConfig.default().replace(name=name)
        page = ChromiumPage(browser, explorer.write_page(config, tmp_path / "page.html"), NARROW)
        assert page.run("document.querySelector('h1').textContent") == name
        assert page.run("document.title").split() == name.split()
        assert page.run("window.broken ?? null") is None
        assert ScreenConfig.loads(page.run("toml()")) == config
        assert page.run("document.documentElement.scrollWidth") <= NARROW[0]
        assert page.errors == []
        page.page.close()


def press(page: ChromiumPage, *names: str) -> None:
    for name in names:
        page.page.keyboard.press(name)


def tab_to(page: ChromiumPage, id: str) -> None:
    for _ in range(200):
        if page.run("document.activeElement.id") == id:
            return
        press(page, "Tab")
    raise AssertionError(f"{id} is not reached by the tabulator")


def test_the_keyboard_alone_works_the_page(quarry: ChromiumPage) -> None:
    """Slider, field, gradation, keeping and going back, TOML, and time."""
    rate = control_of(quarry, "rate")
    first = quarry.run("shown.output.undersize_rate")
    tab_to(quarry, "keep")
    press(quarry, "Enter")
    tab_to(quarry, f"slider{rate}")
    press(quarry, *["ArrowRight"] * 5)
    assert float(quarry.page.input_value(f"#field{rate}")) > 300.0
    assert quarry.run("shown.output.undersize_rate") != first
    assert quarry.run("models['bed: deck 1, kept'].data.y.length") > 0
    press(quarry, "Shift+Tab", "Control+a", "4", "1", "2", ".", "5", "Enter")
    assert quarry.run("shown.products[0].rate") == 412.5 * T_H
    tab_to(quarry, "finer")
    press(quarry, "ArrowRight")
    assert quarry.run("shown.products[0].passing[3]") > 0.22
    press(quarry, *["Shift+Tab"] * 8)
    tab_to(quarry, "back")
    press(quarry, "Enter")
    assert quarry.run("shown.output.undersize_rate") == first
    tab_to(quarry, "toml")
    press(quarry, "Enter")
    text = quarry.page.input_value("#text")
    assert ScreenConfig.loads(text) == ScreenConfig.load(SCREENS / "quarry.toml")
    press(quarry, "Escape")
    quarry.page.focus("[value=steady]")
    press(quarry, "ArrowRight")
    tab_to(quarry, "speed")
    press(quarry, "End")
    assert quarry.page.input_value("#speed") == "1000"
    quarry.wait("clock > 200")
    tab_to(quarry, "restart")
    press(quarry, "Enter")
    tab_to(quarry, "play")
    press(quarry, "Space")
    assert quarry.run("playing") is False


def test_time_brings_the_running_screen_to_the_steady_one(quarry: ChromiumPage) -> None:
    """Another aperture starts anew; after some minutes products and bed are as in Python."""
    quarry.run(f"setNumber({control_of(quarry, 'aperture')}, '20') ?? 1")
    steady = quarry.run("shown.output.undersize_rate")
    quarry.page.check("[value=running]")
    quarry.run("(() => { play(false); begin(); for (let k = 0; k < 40; k++) advance(5); })() ?? 1")
    rate, depth = quarry.run(
        "(() => { const one = watch(); return [one.output.undersize_rate, curves(one).bed[0]]; })()"
    )
    assert rate == pytest.approx(steady, rel=1e-4)
    screen = Screen(ScreenConfig.loads(quarry.run("toml()")))
    for _ in range(40):
        result = screen.step(5.0)
    assert result.undersize.mass_flow_rate == rate
    density = screen.config.material.bulk_density
    expected = [1e3 * screen.bed_at(place).sum() / density for place in depth[0]]
    assert depth[1] == pytest.approx(expected, rel=1e-12)


def test_pictures_out_of_view_follow_once_it_rests(browser: Any, pages: dict[str, Path]) -> None:
    """On a telephone: what is seen is drawn at every move, the rest a moment later."""
    page = ChromiumPage(browser, pages["quarry"], NARROW)
    page.wait("models['bed: deck 1'] && !inView.has('bed') && inView.has('partition')")
    lines = "[...models['partition: deck 1'].data.y], [...models['bed: deck 1'].data.y]"
    shown = "curves(shown).partition[0][1], curves(shown).bed[0][1]"
    rate = control_of(page, "rate")
    before, after = page.run(
        f"(() => {{ const old = [{lines}]; setNumber({rate}, '350'); return [old, [{lines}]]; }})()"
    )
    assert (before[0] == after[0], before[1] == after[1]) == (False, True)
    page.wait(f"JSON.stringify([{lines}]) === JSON.stringify([{shown}])")
    page.page.close()


def test_no_number_of_the_tables_is_none(quarry: ChromiumPage) -> None:
    """What there is nothing of is a dash: nothing passes a blank plate."""
    quarry.run(f"setNumber({control_of(quarry, 'open area')}, '0') ?? 1")
    assert said(quarry) == ""
    text = quarry.page.inner_text("#seen")
    assert "\u2013" in text
    assert not re.search(r"NaN|Infinity|undefined|null", text)


# --- in Python ----------------------------------------------------------------------------------
def test_a_model_of_ones_own_needs_python() -> None:
    def follow(harmonic, drive, result, work):
        result[0] = 0.3

    register("displacement", "own", follow)
    config = ScreenConfig.default().replace(displacement=Displacement("own"))
    with pytest.raises(ConfigError, match="displacement = 'own' is a sub-model of one's own"):
        explorer.page_of(config)


def test_without_bokeh_the_page_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "bokeh.resources", None)
    with pytest.raises(ImportError, match=re.escape("pip install 'vibroscreen[explore]'")):
        explorer.page_of(ScreenConfig.default())


def test_without_a_linker_and_a_wheel_there_is_no_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "library", lambda target: None)
    with pytest.raises(ConfigError, match="pip install ziglang"):
        explorer.page_of(ScreenConfig.default())
