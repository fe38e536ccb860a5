"""A bare C host drives both runtimes through what was reported of FMUs and of tools.

What the python runtime does not survive, as pythonfmu's library does not, is what its page tells
(test_python_limits.py has the characters of paths, one by one).
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import build_fmu
from tests.fmu.bare_host import BareHost, Ended
from vibroscreen.config import ScreenConfig
from vibroscreen.screen import Screen

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="a host for Linux")

CRASHES = (-signal.SIGSEGV, -signal.SIGABRT)
OK, DISCARD, ERROR, FATAL = "0", "2", "3", "4"
REFUSED = {"native": ERROR, "python": DISCARD}
NO_TIME = "is not a finite positive time: give a step in seconds"


@pytest.fixture(scope="module", params=build_fmu.RUNTIMES)
def host(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> BareHost:
    return BareHost(request.param, tmp_path_factory.mktemp("bare"))


def stepped(*steps: tuple[float, float]) -> str:
    """The undersize after steps under a feed, s and kg/s, as the host prints it."""
    screen = Screen(ScreenConfig.default())
    for duration, feed in steps:
        screen.record("input").feed_mass_flow_rate = feed
        screen.advance(duration)
    return f"{screen.record('output').undersize_rate:.17g}"


START = ScreenConfig.default().feed.mass_flow_rate
WELL = Ended(0, [OK, stepped((10.0, START))])


def survives(host: BareHost, ended: Ended, wanted: Ended = WELL) -> None:
    """The native runtime does as it should, and pythonfmu's library ends the host."""
    if host.runtime == "native":
        assert ended == wanted
    else:
        assert ended.code in CRASHES


# --- where it is ---------------------------------------------------------------------------------
@pytest.mark.parametrize("form", ["file:{}", "file://localhost{}"])
def test_resource_locations_of_the_standard(host: BareHost, form: str) -> None:
    assert host.play() == WELL
    survives(host, host.play(location=form.format(host.fmu / "resources")))


@pytest.mark.parametrize("location", ["NULL", ""])
def test_no_resource_location(host: BareHost, location: str) -> None:
    survives(host, host.play(location=location))


@pytest.mark.parametrize(
    "name",
    [
        *("a (1)", "a&b", "a,b", "a=b", "a@b", "a[1]", "a'b", "a%b", "Program Files (x86)", "R&D"),
        "Sieb für Körner",
    ],
)
def test_folders_of_hosts(host: BareHost, name: str, tmp_path: Path) -> None:
    survives(host, host.play(fmu=host.copied(tmp_path / name)))


def test_a_processor_without_avx(host: BareHost) -> None:
    """The plain build, with the same bits."""
    if not shutil.which("qemu-x86_64"):
        pytest.skip("qemu-user is not installed: nothing here is a processor without AVX")
    assert host.play(under=("qemu-x86_64", "-cpu", "Nehalem")) == WELL


# --- what is refused -----------------------------------------------------------------------------
def test_refused_steps(host: BareHost) -> None:
    """The host is told why, in a category, and goes on: nothing has changed."""
    code, said = host.play("refused_steps")
    told = [f"dt = {value} s {NO_TIME}" for value in ("0", "-1", "nan", "inf", "1e-310")]
    told.append("dt = 1e+10 s is more than 1e+09 s: take shorter steps")
    told.append("feed.mass_flow_rate = -1 kg/s is out of range (0 to 5000 kg/s): ")
    assert (code, said[0], said[-3:]) == (0, OK, [OK, "11", stepped((10.0, START), (1.0, 80.0))])
    lines, statuses = said[1:-3:2], said[2:-3:2]
    assert statuses == [REFUSED[host.runtime]] * len(told)
    for line, text in zip(lines, told, strict=True):
        assert line.startswith(f"3 logStatusError {text}")


def test_a_refused_set(host: BareHost) -> None:
    """pythonfmu's library logs it once more without a category, which this host is ended by."""
    text = "3 logStatusError undersize.mass_flow_rate is not an input or a parameter: "
    code, said = host.play("refused_set")
    assert said[0].startswith(text)
    if host.runtime == "native":
        assert (code, said[1:]) == (0, [ERROR, OK])
    else:
        assert (code, said[1:]) == (-signal.SIGABRT, [f"{FATAL} NULL"])


def test_no_logger(host: BareHost) -> None:
    survives(host, host.play("no_logger"), Ended(0, [ERROR, OK]))


def test_callbacks_that_are_overwritten(host: BareHost) -> None:
    told = f"3 logStatusError dt = -1 s {NO_TIME}"
    survives(host, host.play("overwritten_callbacks"), Ended(0, [told, ERROR, OK]))


def test_a_guid_that_is_a_format(host: BareHost) -> None:
    """pythonfmu's library does not look at it."""
    code, said = host.play("other_guid")
    assert (code, said[-1]) == (0, {"native": "none", "python": "an instance"}[host.runtime])
    if host.runtime == "native":
        assert said[0].startswith("3 logStatusError guid = %s%n%s has no resources/screen.bin")


def test_a_decimal_comma(host: BareHost, tmp_path: Path) -> None:
    if not shutil.which("localedef"):
        pytest.skip("localedef is not installed: no locale with a decimal comma")
    source = tmp_path / "comma"
    source.write_text('LC_NUMERIC\ndecimal_point ","\nthousands_sep "."\nEND LC_NUMERIC\n')
    made = ["localedef", "-c", "-i", str(source), str(tmp_path / "xx_XX")]
    subprocess.run(made, capture_output=True, check=False)
    ended = host.play("decimal_comma", LOCPATH=str(tmp_path), LC_NUMERIC="xx_XX")
    told = f"3 logStatusError dt = -1.5 s {NO_TIME}"
    assert ended == Ended(0, [",", told, REFUSED[host.runtime], OK])


def test_a_state_from_before(host: BareHost) -> None:
    """The run goes on from there; the time of pythonfmu's library does so at the next step."""
    after = {"native": "1", "python": "21"}[host.runtime]
    assert host.play("rollback") == Ended(0, [f"0 {after}", "0 21 1"])


# --- many ----------------------------------------------------------------------------------------
# What two thirds of them may leave behind, kB: pythonfmu's library keeps some texts of each.
MANY = {
    "instances_in_turn": {"native": (3000, 500), "python": (150, 700)},
    "resets": {"native": (3000, 500), "python": (150, 700)},
    "refusals": {"native": (50_000, 500), "python": (50_000, 500)},
}


@pytest.mark.parametrize("situation", MANY)
def test_memory_stays_flat(host: BareHost, situation: str) -> None:
    times, most = MANY[situation][host.runtime]
    code, said = host.play(situation, times=times)
    refused = times if situation == "refusals" else 0
    assert (code, said[0]) == (0, str(refused))
    assert int(said[1].removesuffix(" kB")) < most
    assert said[2:] == [OK] * (situation == "refusals")


def test_instances_that_are_alive_together(host: BareHost) -> None:
    """Each has its own feed."""
    times = {"native": 200, "python": 100}[host.runtime]
    assert host.play("instances_alive", times=times) == Ended(0, ["0 1"])


def test_threads(host: BareHost) -> None:
    """Four that make, step and free; an instance that is handed to another."""
    assert host.play("threads", times=20) == Ended(0, WELL.said[1:] * 4)
    assert host.play("handed_on") == WELL


def test_a_fork(host: BareHost) -> None:
    """A child of a host that has an instance makes one of its own; the parent goes on."""
    assert host.play("forked") == Ended(0, ["0 0"])
