"""A screen as an object: owns the flat buffer, checks once, calls kernels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import islice
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen import registry
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import ConfigError, InputError, given, told
from vibroscreen.fields import in_engine
from vibroscreen.kernels import state
from vibroscreen.kernels.bed.classes import most_nodes
from vibroscreen.kernels.entry import (
    ADVANCE,
    CHECK,
    INITIALISE,
    PLACE_NODES,
    READ,
    READ_BED,
    run,
)
from vibroscreen.kernels.physics.motion import WORK_SIZE
from vibroscreen.kernels.plan import LEAST_CELLS, cells_for, share_cells
from vibroscreen.kernels.scene import END_OF_MOTION, FIRST_OF_MOTION, PRESCRIBED
from vibroscreen.kernels.steady import FEED_RATE
from vibroscreen.layout import Layout
from vibroscreen.motion import Motion
from vibroscreen.results import Rows, StepResult, box_of, by_class, closed, reasons
from vibroscreen.sections import RECONSTRUCTIONS, Deck
from vibroscreen.size_classes import Nodes
from vibroscreen.steady import Slice, SteadyResult, sieve
from vibroscreen.stream import Feed, Stream
from vibroscreen.units import DEG
from vibroscreen.variables import PANELS, PARAMETERS, Variable, setting

if TYPE_CHECKING:  # the host of an FMU need not have it
    import pandas as pd

Array = NDArray[np.float64]

MOST_DECKS = 4
SHORTEST_STEP = 1e-300  # s; what moves in less is too little for the numbers of a computer
LONGEST_STEP = 1e9  # s; what moves in more is too slow for them, and would be looked for forever
# Knots along a deck that has one below; where they run out every second one goes.
KNOTS = 512
ENDLESS = (-math.inf, math.inf)
UNREAD, DURATION = state.MEMORY.index("unread"), state.MEMORY.index("duration")
# Fields of which the result of a step is made.
RESULTS = (
    *("output", "undersize_fraction", "oversize_fraction", "intermediate", "intermediate_fraction"),
    *("alarm", "deck_result", "last_seen", "step_mass", "feed_fraction", "scene"),
)


class Screen:
    """A vibrating screen that is fed, vibrates and gives undersize and oversize.

    Raises ConfigError for a configuration that the engine cannot run.
    """

    def __init__(self, config: ScreenConfig) -> None:
        check_supported(config)
        self.config = config
        self.nodes = nodes_of(config)
        self.layout = _layout(config, self.nodes.count, packages=True)
        self.buffer = self.layout.buffer()
        fill(self.layout, self.buffer, config, self.nodes)
        self._column = _layout(config, self.nodes.count, packages=False)
        self._column_buffer = self._column.buffer()
        fill(self._column, self._column_buffer, config, self.nodes)
        self._look_up()
        self.initialise()

    def _look_up(self) -> None:
        """Find once what every call reads and writes of the buffers."""
        self._run = run.on(self.buffer)
        self._memory, self._classes = self.view("memory"), self.config.size_classes.count
        self._results = {name: self.view(name) for name in RESULTS}
        self._inputs = Inputs(self.layout, self.buffer)
        self._column_inputs = Inputs(self._column, self._column_buffer)
        self._given, self._column_given = (
            buffer[layout.section["parameters"].start : layout.section["inputs"].stop]
            for layout, buffer in ((self.layout, self.buffer), (self._column, self._column_buffer))
        )
        self._steady = Slice(self.config, self.nodes, self._column, self._column_buffer, _accept)

    def __getstate__(self) -> dict[str, Any]:
        """A copy has buffers of its own, so it looks up its own parts of them."""
        whole = ("config", "nodes", "layout", "buffer", "_column", "_column_buffer")
        return {name: self.__dict__[name] for name in whole}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over what another screen is."""
        self.__dict__.update(state)
        self._look_up()

    # --- the buffer, for those who move numbers themselves ------------------------------------
    def view(self, name: str) -> Array:
        """Field `name` of the buffer (kernels/state.py); writing to it writes the screen."""
        return self.layout.view(self.buffer, name)

    def record(self, name: str) -> Any:
        """Record `name` of the buffer (kernels/state.py), or an array of them."""
        return self.layout.record(self.buffer, name)

    def initialise(self) -> None:
        """Start anew with the inputs and parameters in the buffer: empty decks, or full ones.

        Raises InputError as `advance` does.
        """
        kept = self.buffer.copy()
        self.buffer[self.layout.section["outputs"]] = 0.0
        self.buffer[self.layout.section["state"]] = 0.0
        try:
            _accept(self._run(INITIALISE, 0.0, 0.0), self.buffer, self.layout)
        except InputError:
            self.buffer[:] = kept
            raise

    def check(self) -> None:
        """Check parameters and inputs in the buffer. Raises InputError as `advance` does."""
        _accept(self._run(CHECK, 0.0, 0.0), self.buffer, self.layout)

    def advance(self, duration: float) -> None:
        """Advance by `duration` s with the inputs in the buffer.

        Raises InputError with the name, value and limit of the first input that is out of range;
        the state is as before then.
        """
        if type(duration) is not float and not isinstance(duration, Real):
            raise InputError(f"dt = {duration!r} is not a number: give a step in seconds", "dt")
        seconds = float(duration)
        if not SHORTEST_STEP <= seconds < math.inf:
            raise InputError(told("no_time", value=seconds), "dt")
        if seconds > LONGEST_STEP:
            raise InputError(told("long_time", value=seconds, limit=LONGEST_STEP), "dt")
        _accept(self._run(ADVANCE, seconds, 0.0), self.buffer, self.layout)

    @property
    def state(self) -> bytes:
        """All that the screen remembers, parameters, inputs and outputs included."""
        return self.buffer[self.layout.persistent].tobytes()

    @state.setter
    def state(self, blob: bytes) -> None:
        part = self.layout.persistent
        size = 8 * (part.stop - part.start)
        if len(blob) != size:
            raise InputError(told("state_size", value=len(blob), limit=size), "state")
        self.buffer[part] = np.frombuffer(blob)

    def read(self) -> bool:
        """Bring outputs up to date that are found only when they are read; whether there were any.

        Sizes of cuts and products, and the alarm of performance.
        """
        if self._memory[UNREAD] <= 0.0:
            return False
        self._run(READ, 0.0, 0.0)
        return True

    def alarm_reasons(self) -> dict[str, str]:
        """Why alarms are set, by name, as far as outputs were read."""
        return reasons(self.view("alarm"))

    # --- for people ---------------------------------------------------------------------------
    def step(self, dt: float, feed: Feed | None = None, motion: Motion | None = None) -> StepResult:
        """Advance by `dt` s under a feed and a motion (the last ones unless given).

        Raises InputError for a value out of range; the state is as before then.
        """
        touched = self._inputs.views
        kept = [values.copy() for values in touched]
        try:
            self._inputs.put(feed, motion)
            self.advance(dt)
        except Exception:
            for values, before in zip(touched, kept, strict=True):
                values[...] = before
            raise
        return self.result()

    def result(self) -> StepResult:
        """What the last step gave."""
        self.read()
        seen = self._results
        output = dict(zip(state.OUTPUT, seen["output"].tolist(), strict=True))
        between = zip(seen["intermediate"], seen["intermediate_fraction"], strict=True)
        return StepResult(
            undersize=Stream(output["undersize_rate"], seen["undersize_fraction"].copy()),
            oversize=Stream(output["oversize_rate"], seen["oversize_fraction"].copy()),
            intermediate=tuple(Stream(float(row[0]), part.copy()) for row, part in between),
            alarm_reasons=reasons(seen["alarm"]),
            size_classes=self.config.size_classes,
            _rows=Rows(
                self.nodes,
                self._classes,
                seen["deck_result"].copy(),
                float(seen["last_seen"][-1 - self._classes]),
                seen["step_mass"].copy(),
                float(self._memory[DURATION]),
                seen["feed_fraction"].copy(),
                closed(seen["scene"]).copy(),
            ),
            **box_of(output),
        )

    def bed_at(self, place: float, deck: int = 1) -> Array:
        """What lies now at a place [m] from the feed end: areal mass [layer, class], kg/m2.

        Layer 0 is on the screen; decks count from 1. Raises InputError for what is not there.
        """
        if deck not in range(1, len(self.config.decks) + 1):
            raise InputError(f"deck = {deck!r} is not there: give 1 to {len(self.config.decks)}")
        length = self.config.decks[deck - 1].length
        if not 0.0 <= place <= length:
            raise InputError(f"place = {place!r} m is not on the deck: give 0 to {length:g} m")
        self._run(READ_BED, float(place), deck - 1.0)
        return by_class(self.nodes, self.view("column_time"), self.config.size_classes.count)

    def balance(self) -> pd.DataFrame:
        """Masses by class since the start, kg: initial, fed, undersize, oversize, held, error."""
        import pandas as pd

        ledger = self.view("ledger")
        whole = {"initial": self.view("initial_mass").copy()}
        names = {"fed": state.FED, "undersize": state.UNDER, "oversize": state.OVER}
        for k in range(1, len(self.config.decks)):
            names[f"intermediate_{k}"] = state.OVER + k
        for name, row in names.items():
            whole[name] = ledger[row].sum(axis=0)
        whole["held"] = self.view("held").copy()
        gone, rest = ledger[state.FED].copy()
        for out, out_rest in ledger[state.UNDER :]:
            gone -= out
            rest -= out_rest
        whole["error"] = (gone - whole["held"] + whole["initial"]) + rest
        return pd.DataFrame(whole, index=pd.RangeIndex(1, len(gone) + 1, name="size_class"))

    def switch(self, **skips: bool) -> None:
        """Turn skips on or off by name (`SWITCH` in kernels/state.py); all are on at first.

        Raises InputError for an unknown name.
        """
        for name, on in skips.items():
            if name not in state.SWITCH:
                raise InputError(
                    f"{name} is no skip: give one of {', '.join(state.SWITCH)}", "switch"
                )
            for layout, buffer in ((self.layout, self.buffer), (self._column, self._column_buffer)):
                layout.view(buffer, "switch")[state.SWITCH.index(name)] = float(on)

    def counters(self) -> dict[str, int]:
        """What was computed and what was skipped since the start."""
        return {k: int(v) for k, v in zip(state.COUNTER, self.view("counter"), strict=True)}

    def solve_steady(self, feed: Feed | None = None, motion: Motion | None = None) -> SteadyResult:
        """Steady state under a feed and a motion (those of the configuration unless given).

        The screen itself stays as it is. Raises InputError for a value out of range, for a feed
        of zero and for a deck that does not convey.
        """
        feed = feed if feed is not None else self.config.feed
        self._slice()
        self._column_inputs.put(feed, motion or self.config.motion)
        return self._steady.solve(feed)

    def sieve_batch(
        self,
        areal_mass: float,
        mass_fraction: Sequence[float],
        motion: Motion | None = None,
        times: Sequence[float] = (),
    ) -> Array:
        """Recovery to the undersize of a batch on a plate that does not convey, by time and class.

        areal_mass in kg/m2; mass_fraction by class, finest first; times in s, ascending; aperture
        and open area are those of the first panel. Returns recovery[time, class], 0 for a class
        that the batch does not hold. Raises InputError.
        """
        if not (math.isfinite(areal_mass) and areal_mass > 0.0):
            raise InputError(
                f"areal_mass = {areal_mass!r} kg/m2 is not a finite positive mass: "
                "give the batch over the area of the plate",
                "areal_mass",
            )
        instants = np.asarray(times, dtype=float)
        if instants.ndim != 1 or not np.isfinite(instants).all():
            raise InputError("times: give finite times in s in one row", "times")
        if (np.diff(instants, prepend=0.0) < 0.0).any():
            raise InputError("times: give ascending times from 0 s on", "times")
        layout, buffer = self._slice()
        batch = Feed(1.0, tuple(mass_fraction))
        self._column_inputs.put(batch, motion or self.config.motion)
        parameter = layout.record(buffer, "parameter")
        model = parameter.displacement_model
        parameter.displacement_model = PRESCRIBED
        layout.record(buffer, "input").displacement_velocity = 0.0  # the plate does not convey
        try:
            return sieve(self.config, self.nodes, layout, buffer, areal_mass, instants, _accept)
        finally:
            parameter.displacement_model = model

    def _slice(self) -> tuple[Layout, Array]:
        """A buffer with room for one slice only, with parameters and inputs as they are now."""
        self._column_given[:] = self._given
        return self._column, self._column_buffer


def nodes_of(config: ScreenConfig) -> Nodes:
    """Sizes that stand for the classes of a configuration."""
    layout = slice_layout(config)
    buffer = layout.buffer()
    fill(layout, buffer, config)
    run(buffer, PLACE_NODES, 0.0, 0.0)
    count = int(buffer[state.DIMENSION.index("nodes")])
    size, node_class, position, weight = (
        layout.view(buffer, name)[:count].copy()
        for name in ("size", "node_class", "node_position", "node_weight")
    )
    return Nodes(size, node_class.astype(np.intp), position, weight)


def _passage_factors(config: ScreenConfig, deck: Deck) -> list[float]:
    """Velocity through the openings of each panel over that of the top deck's first panel."""
    first = passage_velocity(config)
    if config.passage.velocity_table is None or first == 0.0:
        return [1.0] * len(deck.panels)
    return [config.passage.velocity_at(panel.aperture) / first for panel in deck.panels]


def slice_layout(config: ScreenConfig, designs: int = 1) -> Layout:
    """Room for one slice of the bed, whatever nodes it has, and for so many designs at once."""
    return roomy_layout(config, packages=False, designs=designs)


def roomy_layout(config: ScreenConfig, *, packages: bool, designs: int = 1) -> Layout:
    """Room for whatever nodes a screen may have; without packages for one slice of the bed."""
    kinks = 2 * sum(len(deck.panels) for deck in config.decks)
    room = most_nodes(config.size_classes.count, kinks, float(config.size_classes.subdivision))
    return _layout(config, int(room), packages=packages, designs=designs)


def passage_velocity(config: ScreenConfig) -> float:
    """Velocity through the openings, read at the aperture of the top deck's first panel, m/s."""
    return config.passage.velocity_at(config.decks[0].panels[0].aperture)


def check_supported(config: ScreenConfig) -> None:
    """Raise ConfigError for a configuration that the engine cannot run."""
    if len(config.decks) > MOST_DECKS:
        raise ConfigError(
            f"deck: {len(config.decks)} decks are more than a box has: give at most {MOST_DECKS} "
            "[[deck]]"
        )
    for place, deck in enumerate(config.decks, start=1):
        if len(deck.panels) > LEAST_CELLS:
            raise ConfigError(
                f"deck[{place}].panel: {len(deck.panels)} panels are more than a deck can have, "
                f"{LEAST_CELLS}: join the ones that are alike"
            )
    room, cells = config.solver.packages, _cells(config)
    if 0 < room < cells + 4:
        raise ConfigError(told("little_room", value=room, limit=cells, other_limit=cells + 4))


def _cells(config: ScreenConfig) -> int:
    """Cells of a deck: a package is never longer than one."""
    return int(cells_for(config.solver.tolerance, LEAST_CELLS))


def _layout(config: ScreenConfig, nodes: int, *, packages: bool, designs: int = 1) -> Layout:
    """Dimensions of a screen; without packages only one slice has room."""
    cells = _cells(config)
    segregation = registry.model("segregation", config.segregation.model)
    room = config.solver.packages or 4 * cells + 16
    return Layout(
        {
            "classes": config.size_classes.count,
            "nodes": nodes,
            "decks": len(config.decks),
            "panels": max(len(deck.panels) for deck in config.decks),
            "layers": config.bed.layers if segregation.layered else 1,
            "packages": room if packages else 1,
            "cells": cells,
            "layered": int(segregation.layered),
            "bed_layers": config.bed.layers,
            "knots": KNOTS if len(config.decks) > 1 else 1,
            "falls": room if packages and len(config.decks) > 1 else 1,
            "designs": designs,
            "displacement_work": WORK_SIZE,
            "displacement_address": registry.model(
                "displacement", config.displacement.model
            ).address,
            "passage_address": registry.model("passage", config.passage.law).address,
            "segregation_address": segregation.address,
        }
    )


def fill(layout: Layout, buffer: Array, config: ScreenConfig, nodes: Nodes | None = None) -> None:
    """Write a configuration into a buffer: parameters, duty and constants, nodes if given."""

    def put(name: str, value: ArrayLike) -> None:
        layout.view(buffer, name)[...] = value

    put("parameter", [_parameter(config, variable) for variable in PARAMETERS])
    put("limit", [number.limits if number else ENDLESS for number in settings_of(config)])
    # A user's own model has a number beyond those that are built in.
    most = layout.view(buffer, "limit")[: len(PARAMETERS), 1]
    most[:] = np.maximum(most, layout.view(buffer, "parameter"))
    put("lower", config.size_classes.lower)
    put("upper", config.size_classes.upper)
    put("edge", config.size_classes.edges)
    put("width", [deck.width for deck in config.decks])
    for d, deck in enumerate(config.decks):
        count = len(deck.panels)
        rows = [[in_engine(panel, variable.field) for variable in PANELS] for panel in deck.panels]
        layout.view(buffer, "panel")[d, :count] = rows
        layout.view(buffer, "panel_count")[d] = count
        length = np.array([panel.length for panel in deck.panels])
        share_cells(length, _cells(config), layout.view(buffer, "panel_cells")[d])
        layout.view(buffer, "passage_factor")[d, :count] = _passage_factors(config, deck)
    put("switch", 1.0)
    put("reconstruction", RECONSTRUCTIONS.index(config.bed.reconstruction))
    put("closure", [config.passage.follows_vibration, config.segregation.follows_vibration])
    put("harmonic", config.motion.harmonic_rows)
    put("fraction", config.feed.mass_fraction)  # also of a duty of 0 kg/s
    if nodes is not None:
        put_nodes(layout, buffer, nodes)
    layout.record(buffer, "input").displacement_velocity = config.displacement.velocity
    Inputs(layout, buffer).put(config.feed, config.motion)


def _parameter(config: ScreenConfig, variable: Variable) -> float:
    """A parameter as the engine holds it."""
    if (variable.section, variable.field) == ("passage", "velocity"):
        return passage_velocity(config)
    return in_engine(getattr(config, variable.section), variable.field)


def settings_of(config: ScreenConfig) -> tuple[Variable | None, ...]:
    """The numbers of parameters and inputs in the order of the buffer (`variables.setting`)."""
    return tuple(setting(config.size_classes.count, [len(deck.panels) for deck in config.decks]))


def put_nodes(layout: Layout, buffer: Array, nodes: Nodes) -> None:
    """Write the nodes into a buffer that has room for them, or for more."""
    buffer[state.DIMENSION.index("nodes")] = nodes.count
    for name, values in (
        ("size", nodes.size),
        ("node_class", nodes.class_index),
        ("node_position", nodes.position),
        ("node_weight", nodes.weight),
    ):
        layout.view(buffer, name)[: nodes.count] = values


class Inputs:
    """Where feed and motion are in a buffer; looked up once, for they are written with every call.

    `views`: numbers, mass fractions by class, harmonics.
    """

    def __init__(self, layout: Layout, buffer: Array) -> None:
        self.views = tuple(layout.view(buffer, name) for name in ("input", "fraction", "harmonic"))
        self._numbers, self._fraction, self._harmonic = self.views
        self._motion = self._numbers[FIRST_OF_MOTION:END_OF_MOTION]
        self._classes = self._fraction.size

    def put(self, feed: Feed | None, motion: Motion | None) -> None:
        """Write a feed and a motion; None leaves what is there."""
        if feed is not None:
            if feed.mass_flow_rate > 0.0:
                feed.check_classes(self._classes)
                self._fraction[:] = feed.mass_fraction
            self._numbers[FEED_RATE] = feed.mass_flow_rate
        if motion is not None:
            self._motion[:] = motion.fundamental
            self._harmonic[:] = motion.harmonic_rows


def variable_at(layout: Layout, buffer: Array, index: int) -> Variable:
    """The parameter or input at a place of the buffer."""
    panels = layout.view(buffer, "panel_count").astype(int).tolist()
    numbers = setting(layout.dimension["classes"], panels)
    found = next(islice(numbers, index - layout.section["parameters"].start, None))
    assert found is not None, "a panel that is not there was checked"
    return found


def _accept(code: int, buffer: Array, layout: Layout) -> None:
    """Raise what a kernel refused."""
    if code != state.ACCEPTED:
        raise refusal(layout, buffer)


def refusal(layout: Layout, buffer: Array) -> InputError:
    """The error that says what a kernel refused."""
    code, index, value, limit = layout.view(buffer, "refusal").tolist()
    return refusal_of(layout, buffer, code, index, value, limit)


def refusal_of(
    layout: Layout, buffer: Array, code: float, index: float, value: float, limit: float
) -> InputError:
    """The error of a refusal: its code, the place of the buffer, its value and limit."""
    key = state.REFUSED[int(code) - 1]
    if key == "bad_sum":
        return InputError(told(key, value=value, limit=limit), "feed.mass_fraction")
    variable, number = variable_at(layout, buffer, int(index)), float(buffer[int(index)])
    most = layout.view(buffer, "limit")[int(index) - layout.section["parameters"].start, 1]
    amplitude = layout.record(buffer, "input").motion_amplitude
    slope = value if key == "too_steep" else layout.record(buffer, "panel")[0, 0].inclination
    text = told(
        key,
        name=variable.name,
        given=given(variable.name, number, variable.unit),
        other=given("motion.amplitude", amplitude, "m"),
        unit=variable.unit,
        range=variable.range(most),
        cure=variable.cure(key, value, most),
        value=value,
        limit=limit,
        degrees=slope / DEG,
        slope=math.tan(slope),
        number=number,
    )
    return InputError(text, variable.name)
