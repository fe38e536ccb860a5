"""The kernels as plain Python, and a compiled cache that is never older than its sources."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from vibroscreen.kernels import jit
from vibroscreen.kernels.entry import run

ROOT = Path(__file__).resolve().parent.parent

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
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "engine")}
    environment["NUMBA_DISABLE_JIT"] = "1" if plain else "0"
    done = subprocess.run(
        [sys.executable, "-c", TINY.replace("MODEL", model)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


BLAS = """
import sys
from vibroscreen.kernels import jit
print("scipy.linalg" in sys.modules)
import numpy as np
from numba import njit
product = njit(lambda a, b: a @ b)
one = np.array([[2.0, 1.0], [0.0, 3.0]])
print(np.array_equal(product(one, one), one @ one), "scipy.linalg" in sys.modules)
"""


def test_kernels_load_no_linear_algebra_and_take_none_away() -> None:
    """scipy is not imported for kernels; who compiles a matrix product of his own gets it."""
    path = {**os.environ, "PYTHONPATH": str(ROOT / "engine")}
    command = [sys.executable, "-W", "error", "-c", BLAS]
    done = subprocess.run(command, env=path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True", "True"]


@pytest.mark.parametrize("model", ["exchange", "proportional"])
def test_plain_python_gives_what_compiled_kernels_give(model: str) -> None:
    """A transient with a pile and a stop, once compiled and once as plain Python."""
    compiled, plain = _tiny(model, plain=False), _tiny(model, plain=True)
    assert max(compiled) > 1.0
    assert plain == pytest.approx(compiled, rel=1e-9, abs=1e-9)


def test_cache_is_stamped_with_all_kernel_sources(tmp_path: Path, monkeypatch) -> None:
    """A kernel's cache must not outlive a change of a kernel that it calls."""
    assert run._cache._cache_file._source_stamp == jit.SOURCE_STAMP
    assert jit.SOURCE_STAMP[:12] in run._cache._cache_file._index_name
    for name in ("one.py", "two.py"):
        (tmp_path / name).write_text("x = 1\n")
    monkeypatch.setattr(jit, "__file__", str(tmp_path / "one.py"))
    before = jit._source_stamp()
    (tmp_path / "two.py").write_text("x = 2\n")
    assert jit._source_stamp() != before


def test_constant_arguments_do_not_compile_anew() -> None:
    """One specialisation a kernel: numba would make one for every constant argument."""

    @jit.kernel
    def twice(x, k):
        return x * k

    @jit.kernel
    def caller(x):
        return twice(x, 2) + twice(x, 3)

    assert caller(1.0) == 5.0
    assert len(twice.signatures) == 1


def test_a_kernel_says_whether_it_is_ready(tmp_path: Path) -> None:
    """People are told before they wait for the compiler, and not when they need not wait."""

    @jit.kernel
    def half(x):
        return 0.5 * x

    half._cache._cache_file._index_path = str(tmp_path / "index.nbi")
    assert not jit.is_ready(half)
    assert half(3.0) == 1.5
    assert jit.is_ready(half)
