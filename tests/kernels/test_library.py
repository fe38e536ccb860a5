"""The engine as library, in memory and as plain Python; when it is compiled anew."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.places import ROOT, SCREENS
from vibroscreen.compiler import whole
from vibroscreen.compiler.language import Record, Row, kernel
from vibroscreen.compiler.library import says
from vibroscreen.kernels import library

TINY = """
import json
from vibroscreen import Feed, Motion, Screen, ScreenConfig
config = ScreenConfig.loads('''
[size_classes]
edges_mm = [0, 8, 16, 40]
subdivision = 1
[segregation]
model = "MODEL"
[solver]
tolerance = 1e-2
[displacement]
model = "prescribed"
velocity_m_s = 0.5
''')
screen = Screen(config)
feed = config.feed
out = []
for dt, rate, amplitude in ((3.0, 60.0, 0.005), (2.0, 80.0, 0.0), (2.0, 80.0, 0.004)):
    result = screen.step(dt, Feed(rate, feed.mass_fraction), Motion.linear(amplitude, 15.5, 0.8))
    out += [result.hold_up, *result.undersize.class_rates, *result.oversize.class_rates]
print(json.dumps(out))
"""


def _tiny(model: str, *, plain: bool) -> list[float]:
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'engine'}{os.pathsep}{ROOT}"}
    environment["NUMBA_DISABLE_JIT"] = "1" if plain else "0"
    done = subprocess.run(
        [sys.executable, "-c", TINY.replace("MODEL", model)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize("model", ["exchange", "proportional"])
def test_plain_python_gives_what_compiled_kernels_give(model: str) -> None:
    """A transient with a pile and a stop, once compiled and once as plain Python."""
    compiled, plain = _tiny(model, plain=False), _tiny(model, plain=True)
    assert max(compiled) > 1.0
    assert plain == pytest.approx(compiled, rel=1e-9, abs=1e-9)


NO_COMPILER = """
import sys
from vibroscreen import Screen, ScreenConfig
screen = Screen(ScreenConfig.default())
screen.solve_steady().recovery, screen.step(1.0)
print([name for name in sys.modules if name.partition(".")[0] in ("numba", "llvmlite", "scipy")])
"""

WALK = """
import dataclasses, hashlib, random, sys
from math import fsum
import numpy as np
from tests.fixed import FIXED
from vibroscreen import Feed, Motion, Screen, ScreenConfig
of = dataclasses.replace

def level(config):
    return config.replace(decks=tuple(
        of(deck, panels=tuple(of(panel, inclination=0.0) for panel in deck.panels))
        for deck in config.decks
    ))

*screens, plate = [ScreenConfig.load(path) for path in sys.argv[1:]]
configs = []
for config in screens:  # with the numbers of version 0.4.0
    changes = dict(FIXED)
    if config.displacement.model == "prescribed":  # the banana screen
        changes["displacement"] = config.displacement
        changes["bed"] = of(changes["bed"], contact_depth=0.015)
    configs.append(config.replace(**changes))
for config in [*map(level, configs), plate, *configs]:
    screen = Screen(config)
    rng = random.Random(7)
    found, streams = hashlib.sha256(), hashlib.sha256()
    for _ in range(300):
        share = [rng.random() for _ in range(screen.config.size_classes.count)]
        whole = fsum(share)
        share = tuple(part / whole for part in share)
        feed = Feed(rng.uniform(20, 140), share) if rng.random() < 0.5 else None
        motion = None
        if rng.random() < 0.3:
            amplitude, frequency = rng.uniform(0.003, 0.006), rng.uniform(12, 17)
            motion = Motion.linear(amplitude, frequency, 0.785)
        step = screen.step(rng.uniform(0.2, 3), feed, motion)
        for stream in (step.undersize, step.oversize, *step.intermediate):
            for hashed in (found, streams):
                hashed.update(np.float64(stream.mass_flow_rate).tobytes())
                hashed.update(np.ascontiguousarray(stream.mass_fraction).tobytes())
        figures = step.hold_up, step.cut_size, step.drive_power, step.undersize_recovery
        found.update(np.array(figures).tobytes())
    steady = screen.solve_steady()
    found.update(steady.recovery.tobytes())
    found.update(np.float64(steady.cut_size).tobytes())
    print(found.hexdigest()[:16], streams.hexdigest()[:16])
"""
WALKED = [SCREENS / f"{name}.toml" for name in ("quarry", "two_deck", "banana", "dem_plate")]


def _fresh(script: str, *arguments: object, **settings: str) -> str:
    """What a script prints in a process of its own under environment variables."""
    own = {**os.environ, "PYTHONPATH": f"{ROOT / 'engine'}{os.pathsep}{ROOT}", **settings}
    command = [sys.executable, "-W", "error", "-c", script, *map(str, arguments)]
    done = subprocess.run(command, env=own, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def _walked(**settings: str) -> list[list[str]]:
    return [line.split() for line in _fresh(WALK, *WALKED, **settings).splitlines()]


def test_the_library_needs_no_compiler() -> None:
    """A steady solution and a step, without numba."""
    assert _fresh(NO_COMPILER) == "[]\n"


NAMES = """
from collections import Counter
import vibroscreen.kernels.entry, vibroscreen.kernels.plan
from vibroscreen.compiler.language import KERNELS
named = Counter(f"{kernel.__module__}.{kernel.__qualname__}" for kernel in KERNELS)
print(sorted(name for name, count in named.items() if count > 1))
"""


def test_every_kernel_has_a_name_of_its_own() -> None:
    """By it the compiler tells them apart, also those that are made from the shapes of fields."""
    assert _fresh(NAMES) == "[]\n"


BUILD = """
import ctypes
from vibroscreen.kernels import library
build = ctypes.CDLL(str(library.library())).vibroscreen_build
build.restype = ctypes.c_char_p
print(build().decode())
"""


@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="asks Linux what the processor has")
def test_the_build_is_that_of_the_processor() -> None:
    """The system lists what it lets programs use of the processor."""
    text = Path("/proc/cpuinfo").read_text()
    flags = next((line.split() for line in text.splitlines() if line.startswith("flags")), [])
    wanted = {"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"}
    assert _fresh(BUILD).strip() == ("v3" if wanted <= set(flags) else "plain")
    assert _fresh(BUILD, VIBROSCREEN_PROCESSOR="plain").strip() == "plain"


def test_all_ways_to_run_the_engine_give_the_same_bits() -> None:
    """The library for a plain processor and for this one, and the engine compiled in memory."""
    walked = _walked()
    assert _walked(VIBROSCREEN_PROCESSOR="plain") == walked
    assert _walked(VIBROSCREEN_ENGINE="jit") == walked


def test_an_unknown_engine_is_refused() -> None:
    own = {
        **os.environ,
        "PYTHONPATH": f"{ROOT / 'engine'}{os.pathsep}{ROOT}",
        "VIBROSCREEN_ENGINE": "fast",
    }
    done = subprocess.run(
        [sys.executable, "-c", TINY.replace("MODEL", "exchange")],
        env=own,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "VIBROSCREEN_ENGINE = 'fast' is unknown: give library, jit or python" in done.stderr


def test_a_name_that_a_record_has_not_is_no_attribute() -> None:
    """So that `hasattr` and `getattr` with a default work on the numbers of a screen."""
    row = Row(np.array([0.0, 2.0]), 0, Record("length width"))
    assert (row.width, hasattr(row, "width"), hasattr(row, "height")) == (2.0, True, False)
    for act in (lambda: row.height, lambda: setattr(row, "height", 1.0)):
        with pytest.raises(AttributeError, match="height is none of length, width"):
            act()


def test_the_stamp_follows_what_kernels_say() -> None:
    """Not comments, docstrings and layout."""
    one = b'def f(x):\n    """Twice."""\n    return 2.0 * x\n'
    same = b'def f(x):\n    """Twice as much."""\n    # why\n    return (2.0  * x)\n'
    other = one.replace(b"2.0", b"2.5")
    assert says(one) == says(same)
    assert says(one) != says(other)


def test_the_c_layer_has_a_stamp_of_its_own(monkeypatch, tmp_path: Path) -> None:
    """An edit of it compiles no kernel; the library gets another name."""
    before, name = library.stamps(), library.library_name("linux64")
    shutil.copytree(library.NATIVE, tmp_path / "native")
    with (tmp_path / "native" / "fmi2.c").open("a") as source:
        source.write("/* another */\n")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    edited = library.library_with(tmp_path / "native")
    after, other = edited.stamps(), edited.name_of("linux64")
    assert (before[0] == after[0], before[1] == after[1], name == other) == (True, False, False)


def test_constant_arguments_do_not_compile_anew() -> None:
    """One specialisation a kernel: numba would make one for every constant argument."""

    @kernel
    def twice(x, k):
        return x * k

    @whole.compiled
    def caller(x):
        return twice(x, 2) + twice(x, 3)

    assert caller(1.0) == 5.0
    assert len(whole._dispatchers[twice].signatures) == 1


KERNELS = '''
from vibroscreen.compiler.language import kernel
SCALE = 2.0

@kernel
def scaled(x):
    """Some text."""
    return SCALE * x

@kernel
def other(x):
    return x + 1.0

@kernel
def both(x):
    return scaled(x) + other(x)
'''
COMPILE = """
import sys
sys.path.insert(0, sys.argv[1])
import few
from vibroscreen.compiler import kept, whole
made, save = [], kept.Store.save_overload
def note(self, sig, cres):
    made.append(self._name)
    save(self, sig, cres)
kept.Store.save_overload = note
@whole.compiled
def call(x):
    return few.both(x)
print(call(3.0), *sorted(made))
"""


@pytest.mark.parametrize(
    ("old", "new", "printed"),
    [
        ("Some text.", "Another text.\n\n    And more.", "10.0"),
        ("SCALE = 2.0", "SCALE = 3.0", "13.0 few.scaled"),
        ("x + 1.0", "x + 2.0", "11.0 few.other"),
        ("return SCALE * x", "return 7", "11.0 few.both few.scaled"),
    ],
    ids=["text", "constant", "code", "type"],
)
def test_an_edit_compiles_what_it_touches(tmp_path: Path, old: str, new: str, printed: str) -> None:
    """Every kernel at first, none again; a caller only where a kernel gives another type."""
    source = tmp_path / "few.py"
    source.write_text(KERNELS)
    own = {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    assert _fresh(COMPILE, tmp_path, **own).split() == [
        "10.0",
        "few.both",
        "few.other",
        "few.scaled",
    ]
    assert _fresh(COMPILE, tmp_path, **own).split() == ["10.0"]
    source.write_text(KERNELS.replace(old, new))
    assert _fresh(COMPILE, tmp_path, **own).split() == printed.split()


def test_without_a_linker_the_engine_is_compiled_in_memory(monkeypatch, tmp_path: Path) -> None:
    """People without ziglang and a C compiler wait at every start, and get the same numbers."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setenv("CC", "no-such-compiler")
    for target in (str(library.host()), "win64"):
        assert not library.KERNELS.made(tmp_path / "engine.so", target)
    assert not list(tmp_path.iterdir())
