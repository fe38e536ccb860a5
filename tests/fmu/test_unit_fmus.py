"""Units of a circuit behind FMI."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pythonfmu.enums import Fmi2Status

from vibroscreen.circuit import Belt, Bin, ConeCrusher, Conveyor, Mixer
from vibroscreen.circuit.unit import Unit
from vibroscreen.units import MM
from vibroscreen_fmu.circuit.unit_slave import UNIT_FILE, Inlet, UnitModel, UnitSlave

SIEVES = np.array([0, 1, 2, 4, 5.6, 8, 11.2, 16, 22.4, 31.5, 45, 63, 75]) * MM
COMPOSITION = tuple((np.arange(1.0, SIEVES.size) / np.arange(1.0, SIEVES.size).sum()).tolist())


class Caller:
    """A slave as pythonfmu calls it, spoken to by names."""

    def __init__(self, unit: Unit, folder: Path, inlets: int = 1, rate: float = 0.0) -> None:
        fed = tuple(Inlet(rate * (k == 0), COMPOSITION) for k in range(inlets))
        model = UnitModel(unit, tuple(SIEVES.tolist()), fed)
        (folder / UNIT_FILE).write_text(model.to_json())
        self.reference = {port.name: port.reference for port in model.ports()}
        self.slave = UnitSlave(instance_name="unit", resources=str(folder))

    def set(self, name: str, *values: float) -> None:
        first = self.reference[name]
        self.slave.set_real(list(range(first, first + len(values))), list(values))

    def get(self, name: str, count: int = 1) -> list[float]:
        first = self.reference[name]
        return self.slave.get_real(list(range(first, first + count)))

    def rates(self, stream: str) -> np.ndarray:
        rate, *fractions = self.get(f"{stream}.mass_flow_rate", SIEVES.size)
        return rate * np.array(fractions)

    def feed(self, stream: str, rates: np.ndarray) -> None:
        total = rates.sum()
        self.set(f"{stream}.mass_flow_rate", total, *(rates / total))

    def refused(self, step: float) -> str:
        """What a step is refused with; it is logged, in its category, and not raised."""
        said = len(self.slave.log_queue)
        assert self.slave.do_step(0.0, step) is False
        (entry,) = self.slave.log_queue[said:]
        assert (entry.status, entry.category) == (Fmi2Status.error, "logStatusError")
        return str(entry.msg)


def test_the_crusher_slave_is_the_crusher(tmp_path: Path) -> None:
    def crusher(setting: float) -> ConeCrusher:
        return ConeCrusher(name="c", closed_side_setting=setting, capacity=70.0, product="s")

    caller = Caller(crusher(14 * MM), tmp_path)
    caller.slave.exit_initialization_mode()
    assert caller.get("product.mass_flow_rate") == [0.0]
    assert_array_equal(caller.get("product.mass_fraction[1]", SIEVES.size - 1), COMPOSITION)
    for setting, rate in ((14 * MM, 80.0), (20 * MM, 60.0)):
        feed = rate * np.array(COMPOSITION[::-1])
        caller.set("closed_side_setting", setting)  # tunable
        caller.feed("feed", feed)
        assert caller.slave.do_step(0.0, 3.0)
        product = crusher(setting).crush(SIEVES, feed)
        assert_allclose(caller.rates("product"), product, rtol=1e-13, atol=1e-13)
        power = crusher(setting).power(SIEVES, feed, product)[0]
        assert caller.get("drive.power") == [pytest.approx(power, rel=1e-12)]
        choked = caller.slave.get_boolean([caller.reference["alarm.capacity"]])
        assert choked == [rate > 70.0]
    before = caller.slave.memory()
    caller.set("closed_side_setting", -1.0)
    assert caller.refused(3.0).startswith("closed_side_setting = -1 m is out of range")
    caller.set("closed_side_setting", 20 * MM)
    assert caller.slave.memory() == before


def test_inlets_are_mixed_and_errors_name_them(tmp_path: Path) -> None:
    caller = Caller(Mixer(name="m", product="a"), tmp_path, inlets=2, rate=50.0)
    caller.slave.exit_initialization_mode()
    caller.feed("feed[2]", 30.0 * np.array(COMPOSITION[::-1]))
    assert caller.slave.do_step(0.0, 1.0)
    mixed = 50.0 * np.array(COMPOSITION) + 30.0 * np.array(COMPOSITION[::-1])
    assert_allclose(caller.rates("product"), mixed, rtol=1e-13)
    caller.set("feed[2].mass_fraction[3]", 1.5)
    assert caller.refused(1.0).startswith("feed[2].mass_fraction[3] = 1.5 is out of range")
    caller.set("feed[1].mass_flow_rate", -1.0)
    assert caller.refused(1.0).startswith("feed[1].mass_flow_rate = -1 kg/s")
    assert caller.refused(0.0).startswith("dt = 0")


def test_a_full_bin_refuses_the_step_and_stays_as_it_was(tmp_path: Path) -> None:
    caller = Caller(Bin(name="b", discharge_rate=10.0, capacity=100.0, product="a"), tmp_path)
    caller.slave.exit_initialization_mode()
    caller.feed("feed", 60.0 * np.array(COMPOSITION))
    assert caller.slave.do_step(0.0, 1.5)
    assert caller.get("held.mass") == [pytest.approx(75.0)]
    before = caller.slave.memory()
    assert caller.refused(1.0).startswith("b.capacity = 0.1 t is full")
    assert caller.slave.memory() == before
    caller.set("discharge_rate", 200.0)  # tunable: what is held stays
    assert caller.slave.do_step(0.0, 1.0)
    assert caller.get("product.mass_flow_rate") == [pytest.approx(135.0)]


def test_the_conveyor_slave_is_the_conveyor_and_remembers(tmp_path: Path) -> None:
    unit = Conveyor(name="b", delay=5.0, product="a")
    caller = Caller(unit, tmp_path)
    caller.set("delay", 7.0)  # fixed: until initialisation ends
    caller.slave.exit_initialization_mode()
    with pytest.raises(RuntimeError, match="delay is a fixed parameter of a model that runs"):
        caller.set("delay", 8.0)
    belt = Belt(7.0, classes=SIEVES.size - 1)
    rng = np.random.default_rng(1)

    def go_on(steps: int) -> list[np.ndarray]:
        left = []
        for _ in range(steps):
            caller.feed("feed", rng.uniform(0.0, 9.0, SIEVES.size - 1))
            assert caller.slave.do_step(0.0, float(rng.uniform(0.5, 9.0)))
            left.append(caller.rates("product"))
        return left

    for _ in range(20):
        stream, step = rng.uniform(0.0, 9.0, SIEVES.size - 1), float(rng.uniform(0.5, 9.0))
        caller.feed("feed", stream)
        assert caller.slave.do_step(0.0, step)
        expected = belt.step(stream, step)["product"]
        assert_allclose(caller.rates("product"), expected, rtol=1e-9, atol=1e-9)
        assert caller.get("held.mass")[0] == pytest.approx(belt.held.sum(), rel=1e-9)
    memory, state = caller.slave.memory(), rng.bit_generator.state
    expected = go_on(10)
    rng.bit_generator.state = state
    other = tmp_path / "other"
    other.mkdir()
    caller = Caller(unit, other)
    caller.set("delay", 7.0)
    caller.slave.exit_initialization_mode()
    caller.slave.recall(memory)
    assert_array_equal(go_on(10), expected)
