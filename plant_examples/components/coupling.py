"""FMUs wired to a circuit, stepped with fmpy."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

from fmpy.ssp.simulation import simulate_ssp

from components.instance import running
from vibroscreen_fmu.circuit.ssp import Circuit

__all__ = ["at_end_of_ssp", "step_along"]


def at_end_of_ssp(
    path: Path, asked: Iterable[tuple[str, str]], duration: float, step: float
) -> list[float]:
    """Let fmpy run an SSP for a duration in steps [s]; variables of elements at the end."""
    result = simulate_ssp(str(path), stop_time=duration, step_size=step)
    return [float(result[f"{element}.{variable}"][-1]) for element, variable in asked]


def step_along(circuit: Circuit, asked: tuple[str, str], steps: int, step: float) -> float:
    """Step element by element in the order of the streams; an element's variable at the end."""
    with ExitStack() as stack:
        units = {
            name: stack.enter_context(running(fmu, name)) for name, fmu in circuit.fmus.items()
        }
        links = []
        for source, target in dict.fromkeys(
            (source, target) for source, _, target, _ in circuit.wires
        ):
            between = [(o, i) for s, o, t, i in circuit.wires if (s, t) == (source, target)]
            outputs = [units[source][1][name] for name, _ in between]
            inputs = [units[target][1][name] for _, name in between]
            links.append((units[source][0], outputs, units[target][0], inputs))
        for count in range(steps):
            for slave, outputs, follower, inputs in links:
                slave.doStep(count * step, step)
                follower.setReal(inputs, slave.getReal(outputs))
        slave, reference = units[asked[0]]
        (value,) = slave.getReal([reference[asked[1]]])
    return float(value)
