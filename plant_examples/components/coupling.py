"""FMUs wired to a circuit, stepped with fmpy."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path

from fmpy.ssp.simulation import simulate_ssp

from components.instance import STARTED, running
from vibroscreen_fmu.circuit.ssp import Circuit

__all__ = ["Coupled", "at_end_of_ssp", "step_along"]


def at_end_of_ssp(
    path: Path, asked: Iterable[tuple[str, str]], duration: float, step: float
) -> list[float]:
    """Let fmpy run an SSP for a duration in steps [s]; variables of elements at the end."""
    result = simulate_ssp(str(path), stop_time=duration, step_size=step)
    return [float(result[f"{element}.{variable}"][-1]) for element, variable in asked]


class Coupled:
    """FMUs that run, each fed by the last outputs of those before it."""

    def __init__(self, circuit: Circuit, stack: ExitStack) -> None:
        """Start every element; the stack ends them."""
        self._units = {n: stack.enter_context(running(fmu, n)) for n, fmu in circuit.fmus.items()}
        # Of each element: outputs, the element that they lead to, its inputs.
        self._links: dict[str, list[tuple[list[int], str, list[int]]]] = defaultdict(list)
        for source, target in dict.fromkeys((s, t) for s, _, t, _ in circuit.wires):
            between = [(o, i) for s, o, t, i in circuit.wires if (s, t) == (source, target)]
            outputs = [self._units[source][1][name] for name, _ in between]
            inputs = [self._units[target][1][name] for _, name in between]
            self._links[source].append((outputs, target, inputs))
        self._time = STARTED
        for element in self._units:  # nothing has left any of them yet
            self._hand_on(element)

    def get(self, element: str, *names: str) -> list[float]:
        """Variables of an element."""
        slave, reference = self._units[element]
        return list(slave.getReal([reference[name] for name in names]))

    def set(self, element: str, values: Mapping[str, float]) -> None:
        """Set inputs or tunable parameters of an element."""
        slave, reference = self._units[element]
        slave.setReal([reference[name] for name in values], list(values.values()))

    def step(self, step: float) -> None:
        """Every element steps in turn and hands on what leaves."""
        for element, (slave, _) in self._units.items():
            slave.doStep(self._time, step)
            self._hand_on(element)
        self._time += step

    def _hand_on(self, element: str) -> None:
        """Give what leaves an element to those that it leads to."""
        slave, _ = self._units[element]
        for outputs, target, inputs in self._links[element]:
            self._units[target][0].setReal(inputs, slave.getReal(outputs))


def step_along(circuit: Circuit, asked: tuple[str, str], steps: int, step: float) -> float:
    """A variable of an element after some steps [s] from the start."""
    with ExitStack() as stack:
        coupled = Coupled(circuit, stack)
        for _ in range(steps):
            coupled.step(step)
        (value,) = coupled.get(*asked)
    return value
