"""What a competent person would write first: the yardstick of the engine's speed.

Same sub-model kernels (segregation, passage) as the engine, same equations; only the numerics
differ:
  ColumnMarch: one slice of the bed marched from the feed to the discharge in uniform steps, by
      explicit Euler or, as the next thing one would try, by Heun's method (second order);
  FixedCells: the paper's cells [column, layer, node], fixed in space and marched in time from an
      empty deck to the steady state: displacement (upwind), then passage and segregation, in turn.
Both work on equal slices of the size classes, or on nodes that are given (the engine's own, so that
only the integration in time counts).

With a CFL number of 1 upwind advection is exact: a step of FixedCells moves every column on by one
and takes one Euler step in it. Its steady state is that of a ColumnMarch of as many steps as it
has columns. With a CFL number of 1/2 a column is the mean of itself and its neighbour when it takes
its Euler step, so in a steady state the rates are those of the midpoint: second order along the
deck, by luck of taking displacement and rates in turn. The benchmark tries both.

Kernels here are compiled by numba in every process.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from vibroscreen import Feed, Motion, Screen
from vibroscreen.compiler.language import Row, kernel, record
from vibroscreen.compiler.whole import compiled
from vibroscreen.kernels import state
from vibroscreen.kernels.entry import START_SLICE, run
from vibroscreen.kernels.physics.layer import layer_mass
from vibroscreen.kernels.physics.passage import passage_probability
from vibroscreen.kernels.physics.segregation import segregate
from vibroscreen.layout import Layout
from vibroscreen.screen import Inputs

Array = NDArray[np.float64]

# Rows of `node`: sizes [m], contact weights [m2/kg], contact fractions, passage factors, what
# leaves the layer at hand downwards in a step [kg/m2], what has passed [kg/m2].
SIZE, CONTACT, FRACTION, FACTOR, DOWNWARD, PASSED = range(6)
# Numbers in `choice`: which sub-models.
LAW, LAW_ADDRESS, MODEL, MODEL_ADDRESS = range(4)


# --- kernels -----------------------------------------------------------------------------------
@kernel
def pass_grains(choice, scene, node, load, layers, down, h):
    """What passes in h s into node[DOWNWARD] and node[PASSED]; its sum, kg/m2.

    Fills the percolation `down`[layer, node], 1/s, too.
    """
    contact, fraction, factor = node[CONTACT], node[FRACTION], node[FACTOR]
    downward, passed = node[DOWNWARD], node[PASSED]
    model, address = int(choice[MODEL]), int(choice[MODEL_ADDRESS])
    segregate(model, address, node[SIZE], load, layers, scene, contact, down)
    for i in range(contact.size):
        fraction[i] = contact[i] * load[0, i]
    scene.cover = min(1.0, layer_mass(load, 0) / scene.contact_load)
    law, address = int(choice[LAW]), int(choice[LAW_ADDRESS])
    passage_probability(law, address, node[SIZE], fraction, scene, factor)
    strength = h * scene.density * scene.passage_velocity * scene.cover
    for i in range(contact.size):
        downward[i] = min(load[0, i], strength * max(0.0, factor[i]) * fraction[i])
        passed[i] += downward[i]
    return layer_mass(node, DOWNWARD)


@kernel
def exchanged_mass(load, down, row):
    """What percolates out of a layer, kg/(m2 s)."""
    nodes = load.shape[1]
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    whole = nodes - nodes % 4
    for i in range(0, whole, 4):
        a += down[row, i] * load[row, i]
        b += down[row, i + 1] * load[row, i + 1]
        c += down[row, i + 2] * load[row, i + 2]
        d += down[row, i + 3] * load[row, i + 3]
    for i in range(whole, nodes):
        a += down[row, i] * load[row, i]
    return (a + b) + (c + d)


@kernel
def euler_step(choice, scene, node, load, layers, down, h):
    """One explicit step of a column; returns the number of layers after it.

    Passage out of row 0; across every boundary percolation down, the same mass back up and what
    refills the layers below, all with the loads at the start of the step: one sweep from the
    screen up. A top layer that would not last two steps joins the one below.
    """
    downward = node[DOWNWARD]
    lost = pass_grains(choice, scene, node, load, layers, down, h)
    top = layers - 1
    mass = layer_mass(load, 0)
    joins = False
    for j in range(top):
        upward = h * exchanged_mass(load, down, j + 1) / mass
        mass = layer_mass(load, j + 1)
        joins = j + 1 == top and mass < 2.0 * lost
        settling = 0.0 if joins else lost / mass
        for i in range(downward.size):
            crossing = (h * down[j + 1, i] + settling) * load[j + 1, i] - upward * load[j, i]
            load[j, i] += crossing - downward[i]
            downward[i] = crossing
    for i in range(downward.size):
        load[top, i] -= downward[i]
    if joins:
        for i in range(downward.size):
            load[top - 1, i] += load[top, i]
            load[top, i] = 0.0
        return layers - 1
    return layers


@compiled
def march(choice, numbers, node, load, layers, down, duration, steps):
    """A column through `duration` s in equal steps; returns the number of layers."""
    scene = record(numbers, 0, state.SCENE)
    h = duration / steps
    for _ in range(steps):
        layers = euler_step(choice, scene, node, load, layers, down, h)
    return layers


@compiled
def march_heun(choice, numbers, node, loads, layers, down, duration, steps):
    """As `march` for loads[0], by Heun's method: the mean of the start and of two Euler steps on.

    loads[1] is scratch. node[PASSED] ends as the sum over both Euler steps: twice what passed.
    """
    scene = record(numbers, 0, state.SCENE)
    h = duration / steps
    load, start = loads[0], loads[1]
    for _ in range(steps):
        for j in range(layers):
            for i in range(load.shape[1]):
                start[j, i] = load[j, i]
        left = euler_step(choice, scene, node, load, layers, down, h)
        euler_step(choice, scene, node, load, left, down, h)
        for j in range(layers):
            for i in range(load.shape[1]):
                load[j, i] = 0.5 * (start[j, i] + load[j, i])
        # A top row that both steps did without falls down once it is thin.
        while layers > left and layer_mass(load, layers - 1) < 1e-3 * scene.layer_full:
            layers -= 1
            for i in range(load.shape[1]):
                load[layers - 1, i] += load[layers, i]
                load[layers, i] = 0.0
    return layers


@compiled
def settle(scene, load, rows):
    """Cut a column anew at the full loads of its layers; returns the number of layers."""
    nodes = load.shape[1]
    for j in range(rows - 1):
        full = scene.contact_load if j == 0 else scene.layer_full
        mass = layer_mass(load, j)
        if mass > full * (1.0 + 1e-12):
            part = 1.0 - full / mass
            for i in range(nodes):
                load[j + 1, i] += part * load[j, i]
                load[j, i] *= 1.0 - part
        above = j + 1
        while mass < full * (1.0 - 1e-12) and above < rows:
            more = layer_mass(load, above)
            part = 1.0 if more <= full - mass else (full - mass) / more
            for i in range(nodes):
                load[j, i] += part * load[above, i]
                load[above, i] *= 1.0 - part
            mass += part * more
            above += 1
    layers = rows
    while layers > 1 and layer_mass(load, layers - 1) <= 1e-9 * scene.layer_load:
        for i in range(nodes):
            load[layers - 2, i] += load[layers - 1, i]
            load[layers - 1, i] = 0.0
        layers -= 1
    return layers


@kernel
def advect(cell, layers, column, source, source_layers, courant):
    """Displacement of one column: upwind, from the column (or feed) before it."""
    load = cell[column]
    rows = source_layers
    if courant == 1.0:
        for j in range(source_layers):
            for i in range(load.shape[1]):
                load[j, i] = source[j, i]
        for j in range(source_layers, layers[column]):
            for i in range(load.shape[1]):
                load[j, i] = 0.0
    else:
        rows = max(rows, layers[column])
        for j in range(rows):
            for i in range(load.shape[1]):
                load[j, i] += courant * (source[j, i] - load[j, i])
    return rows


@compiled
def march_cells(choice, numbers, node, cell, layers, feed, down, clock):
    """Columns of cells through clock[0] steps of clock[1] s at the CFL number clock[2].

    cell[column, layer, node] in kg/m2; feed[layer, node] what enters, in clock[4] layers. The
    first clock[3] columns are in use, more as the bed moves on. node[PASSED] is the sum over steps
    and columns; node[DOWNWARD] ends as scratch.
    """
    scene = record(numbers, 0, state.SCENE)
    h, courant = clock[1], clock[2]
    for _ in range(int(clock[0])):
        used = min(cell.shape[0], int(clock[3]) + 1)
        clock[3] = used
        for k in range(used - 1, -1, -1):
            source = cell[k - 1] if k > 0 else feed
            enters = layers[k - 1] if k > 0 else int(clock[4])
            rows = advect(cell, layers, k, source, enters, courant)
            if courant < 1.0 and cell.shape[1] > 1:
                rows = settle(scene, cell[k], rows)
            layers[k] = euler_step(choice, scene, node, cell[k], rows, down, h)


# --- the scene, as the engine sees it ----------------------------------------------------------
def slice_of(screen: Screen) -> tuple[Layout, Array]:
    """Layout and buffer of the one slice that `solve_steady` follows (an internal of Screen)."""
    return screen._slice()


@dataclass(frozen=True, eq=False)
class Problem:
    """One slice of the bed: numbers of the scene and of the sub-models, load, residence.

    areal_mass: what enters, kg/m2; residence_time in s; rows: layers that a column may have.
    """

    numbers: Array
    choice: Array
    rows: int
    areal_mass: float
    residence_time: float
    edges: Array
    fraction: Array
    width: float
    length: float

    @property
    def scene(self) -> Row:
        """The scene, by name."""
        return Row(self.numbers, 0, state.SCENE)

    @property
    def velocity(self) -> float:
        """Velocity of the bed, m/s."""
        return float(self.scene.transport_velocity)


def problem_of(screen: Screen, feed: Feed | None = None, motion: Motion | None = None) -> Problem:
    """What the engine integrates under that feed and motion (the configuration's unless given)."""
    config = screen.config
    feed, motion = feed or config.feed, motion or config.motion
    layout, buffer = slice_of(screen)
    Inputs(layout, buffer).put(feed, motion)
    if run(buffer, START_SLICE, 0.0, 0.0) != state.ACCEPTED:
        raise ValueError("the engine refuses these inputs")
    numbers = layout.view(buffer, "scene")[0, 0].copy()
    scene = Row(numbers, 0, state.SCENE)
    scene.layer_full = scene.layer_load
    parameter = layout.record(buffer, "parameter")
    dimension = layout.dimension
    choice = np.zeros(4)
    choice[LAW] = parameter.passage_law
    choice[LAW_ADDRESS] = dimension["passage_address"]
    choice[MODEL] = parameter.segregation_model
    choice[MODEL_ADDRESS] = dimension["segregation_address"]
    deck = config.decks[0]
    velocity = scene.transport_velocity
    areal = feed.mass_flow_rate / (deck.width * velocity) if velocity > 0.0 else 0.0
    fraction = np.asarray(feed.mass_fraction) / np.sum(feed.mass_fraction)
    return Problem(
        numbers,
        choice,
        dimension["layers"] if dimension["layered"] else 1,
        areal,
        deck.length / velocity if velocity > 0.0 else 0.0,
        np.asarray(config.size_classes.edges),
        fraction,
        deck.width,
        deck.length,
    )


@dataclass(frozen=True, eq=False)
class SubClasses:
    """Sizes [m], the class of each, and the part of the feed at it."""

    size: Array
    class_index: NDArray[np.intp]
    fraction: Array


def uniform_slices(problem: Problem, count: int) -> SubClasses:
    """Each class cut into `count` equal slices at their mid-size.

    Masses are differences of the engine's cumulative curve (PCHIP through the class limits).
    """
    edges = problem.edges
    curve = PchipInterpolator(edges, np.concatenate(([0.0], np.cumsum(problem.fraction))))
    cut = np.linspace(edges[:-1], edges[1:], count + 1, axis=1)
    mass = np.maximum(0.0, np.diff(curve(cut), axis=1))
    classes = np.repeat(np.arange(problem.fraction.size), count)
    return SubClasses((0.5 * (cut[:, 1:] + cut[:, :-1])).ravel(), classes, mass.ravel())


def engine_nodes(screen: Screen, feed: Feed | None = None) -> SubClasses:
    """The engine's own nodes and what it puts on them."""
    problem_of(screen, feed)
    layout, buffer = slice_of(screen)
    fraction = layout.view(buffer, "feed_fraction").copy()
    return SubClasses(screen.nodes.size, screen.nodes.class_index, fraction)


def stacked(problem: Problem, load: Array) -> tuple[Array, int]:
    """A mixed bed of load[node] kg/m2 cut into full layers: (load[layer, node], layers)."""
    mass = load.sum()
    column = np.zeros((problem.rows, load.size))
    if problem.rows == 1:
        column[0] = load
        return column, 1
    contact, full = problem.scene.contact_load, problem.scene.layer_load
    above = max(0.0, mass - contact)
    layers = 1 + ceil(above / full - 1e-9)
    if layers > problem.rows:
        raise ValueError(f"{layers} layers are more than {problem.rows}: give more bed.layers")
    for j in range(layers):
        held = min(mass, contact) if j == 0 else min(full, above - (j - 1) * full)
        column[j] = held / mass * load
    return column, layers


def class_recovery(sub: SubClasses, passed: Array, fed: Array, count: int) -> Array:
    """Recovery by class, 0 where nothing is fed."""
    out = np.bincount(sub.class_index, passed, count)
    total = np.bincount(sub.class_index, fed, count)
    return np.divide(out, total, out=np.zeros(count), where=total > 0.0)


class ColumnMarch:
    """One slice marched from the feed to the discharge in uniform steps.

    order 1: explicit Euler; order 2: Heun.
    """

    def __init__(self, problem: Problem, sub: SubClasses, order: int = 1) -> None:
        self.problem, self.sub, self.order = problem, sub, order
        self.fed = problem.areal_mass * sub.fraction
        self.start, self.start_layers = stacked(problem, self.fed)
        self.loads = np.stack((self.start, self.start))
        self.load, self.down = self.loads[0], np.zeros_like(self.start)
        self.node = np.zeros((6, sub.size.size))
        self.node[SIZE] = sub.size
        self.scene = problem.numbers.copy()

    def advance(self, duration: float, steps: int) -> None:
        """From the feed end through `duration` s."""
        self.load[:] = self.start
        self.node[PASSED] = 0.0
        before, after = (self.problem.choice, self.scene, self.node), (self.start_layers, self.down)
        if self.order == 1:
            march(*before, self.load, *after, duration, steps)
        else:
            march_heun(*before, self.loads, *after, duration, steps)
            self.node[PASSED] *= 0.5

    def run(self, steps: int) -> None:
        """From the feed to the discharge."""
        self.advance(self.problem.residence_time, steps)

    @property
    def recovery(self) -> Array:
        """Recovery by class of the last run."""
        passed = self.node[PASSED]
        return class_recovery(self.sub, passed, self.fed, self.problem.fraction.size)


class FixedCells:
    """The paper's cells, fixed in space, marched in time from an empty deck.

    `columns` cells along the deck; courant: CFL number, at most 1.
    """

    def __init__(
        self, problem: Problem, sub: SubClasses, columns: int, courant: float = 1.0
    ) -> None:
        self.problem, self.sub, self.courant = problem, sub, courant
        self.cell = np.zeros((columns, problem.rows, sub.size.size))
        self.layers = np.ones(columns, dtype=np.int64)
        self.down = np.zeros((problem.rows, sub.size.size))
        self.node = np.zeros((6, sub.size.size))
        self.node[SIZE] = sub.size
        self.used = 0
        self.impose(problem, sub)

    def impose(self, problem: Problem, sub: SubClasses) -> None:
        """Another feed or motion from now on."""
        self.problem, self.sub = problem, sub
        self.scene = problem.numbers.copy()
        self.fed = problem.areal_mass * sub.fraction
        self.feed, self.feed_layers = stacked(problem, self.fed)
        self.step = self.courant * problem.length / self.columns / problem.velocity

    @property
    def columns(self) -> int:
        """Columns along the deck."""
        return self.cell.shape[0]

    def clear(self) -> None:
        """An empty deck."""
        self.cell[:] = 0.0
        self.layers[:] = 1
        self.used = 0

    def advance(self, steps: int, part: float = 1.0) -> None:
        """Take `steps` steps, each a `part` of the longest."""
        clock = np.array(
            [steps, part * self.step, part * self.courant, self.used, self.feed_layers], dtype=float
        )
        march_cells(
            self.problem.choice,
            self.scene,
            self.node,
            self.cell,
            self.layers,
            self.feed,
            self.down,
            clock,
        )
        self.used = int(clock[3])

    def let_pass(self, duration: float) -> Array:
        """Undersize [kg] by node over `duration` s; a last step is shortened to fit."""
        self.node[PASSED] = 0.0
        whole = int(duration / self.step * (1.0 + 1e-12))
        self.advance(whole)
        part = duration / self.step - whole
        if part > 1e-9:
            self.advance(1, part)
        return self.node[PASSED] * self.problem.width * self.problem.length / self.columns

    def run(self, level: float) -> None:
        """From empty until the recovery changes less than a tenth of `level`.

        Looked at over one step after the residence time, and then every sixteenth of it.
        """
        self.clear()
        self.advance(ceil(self.columns / self.courant) - 1)
        interval = max(1, round(self.columns / self.courant / 16))
        last = None
        for _ in range(64):
            self.node[PASSED] = 0.0
            self.advance(1)
            now = self.recovery
            if last is not None and abs(now - last).max() < 0.1 * level:
                return
            last = now
            self.advance(interval - 1)

    @property
    def recovery(self) -> Array:
        """Undersize of the last step over the feed in it, by class."""
        passed = self.node[PASSED] / self.courant
        return class_recovery(self.sub, passed, self.fed, self.problem.fraction.size)
