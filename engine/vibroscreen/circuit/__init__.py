"""Circuits around screens: crushers, splitters, belts and bins, solved with their recycles."""

from __future__ import annotations

from vibroscreen.circuit.crusher import ConeCrusher, Crusher, JawCrusher, passing_size
from vibroscreen.circuit.flowsheet import Flowsheet, FreshFeed, Product
from vibroscreen.circuit.handling import Belt, Bin, Conveyor, Mixer, Splitter
from vibroscreen.circuit.results import CircuitTable, solve_circuit, solve_circuit_many
from vibroscreen.circuit.running import RunningCircuit
from vibroscreen.circuit.screening import ScreenUnit

__all__ = [
    "Belt",
    "Bin",
    "CircuitTable",
    "ConeCrusher",
    "Conveyor",
    "Crusher",
    "Flowsheet",
    "FreshFeed",
    "JawCrusher",
    "Mixer",
    "Product",
    "RunningCircuit",
    "ScreenUnit",
    "Splitter",
    "passing_size",
    "solve_circuit",
    "solve_circuit_many",
]
