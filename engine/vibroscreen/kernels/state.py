"""Where everything lies in the one flat float64 buffer of a screen; nobody else knows offsets.

    [ header | parameters | inputs | outputs | constants | state | work ]

../layout.py computes the offsets in Python and hands out numpy views by name. Kernels read the same
offsets from the header and see the same fields as views. What lies from `inputs` up to `work` is
the whole state of an instance: copying it copies the screen.
"""

from __future__ import annotations

from collections.abc import Iterable

from vibroscreen.compiler.fields import Symbol, fields_of
from vibroscreen.compiler.language import Places, Record, kernel, record, view1
from vibroscreen.figures import ALARMS as ALARM_FIGURES
from vibroscreen.figures import BETWEEN, BOX
from vibroscreen.figures import DECK as OF_DECK
from vibroscreen.variables import INPUTS, PANELS, PARAMETERS, Variable


# --- scalars of a vector field, in order -------------------------------------------------------
def _record(row: Iterable[Variable]) -> Record:
    row = tuple(row)
    return Record(*(v.scalar for v in row), whole=" ".join(v.scalar for v in row if v.whole))


# What a user says, from the fields of the configuration.
PARAMETER, PANEL, INPUT = _record(PARAMETERS), _record(PANELS), _record(INPUTS)

# What a screen gives (figures.py): of the box, of every stream between two decks, of every deck.
OUTPUT, INTERMEDIATE, DECK_RESULT = (
    Record(*(figure.scalar for figure in row)) for row in (BOX, BETWEEN, OF_DECK)
)
# Alarms by name, and why one is set, by texts of errors.py; 0 where it is not.
ALARMS = Places(0, *(alarm.scalar.removeprefix("alarm_") for alarm in ALARM_FIGURES))
ALARM_COUNT, FIRST_ALARM = len(ALARMS), OUTPUT.index(ALARM_FIGURES[0].scalar)
REASONS = Places(
    1,
    "deep_bed full_layers not_conveyed beyond_bed high_throw unchecked_motion nothing_fed",
    "no_crossing implausible_depth implausible_velocity implausible_motion hidden_opening",
)
# deck: counted from 1, 0 for the box.
ALARM = Record("reason deck value limit other")

# Numbers of passage and segregation, which sub-models read under the name of their field; under the
# whole name where both have one.
_LAWS = [v for v in PARAMETERS if v.section in ("passage", "segregation") and not v.whole]
_FIELDS = [v.field for v in _LAWS]
_NAMES = {v.scalar if _FIELDS.count(v.field) > 1 else v.field: v for v in _LAWS}
# What a panel offers to the sub-models. Up to FIXED_SCENE it holds while a column is integrated;
# the rest is the state of the column at hand.
SCENE = Record(
    "density contact_load layer_load aperture open_area across along seen closed",
    *(name for name, v in _NAMES.items() if v.section == "segregation"),
    *(name for name, v in _NAMES.items() if v.section == "passage"),
    "throw_height frequency amplitude throw_angle ellipticity inclination throw_number",
    "transport_velocity dissipation transport_status horizon layer_full bed_load cover",
)
# Where they lie in a scene, and among the parameters.
OF_LAWS = tuple((SCENE.index(name), PARAMETER.index(v.scalar)) for name, v in _NAMES.items())
FIXED_SCENE = SCENE.index("layer_full")

# Book-keeping of one deck. unfed: 1 where nothing finer than its aperture came in the last step;
# first_load: of a slice of a lower deck, what lies on the first cell, kg/m2.
DECK = Record(
    "packages cells cohort_on cohort_front cohort_fed covered leaders lead_panel knots knot",
    "pile_open pile_rear lead_layers partial_layers step order pace wide rows first_pace",
    "share capacity_alarm unfed first_load",
    whole="packages cells leaders lead_panel knots knot lead_layers partial_layers order rows",
)

# What an instance remembers besides; duration: of the step whose masses step_mass holds, s.
MEMORY = Record("settled unread duration")

# A step of the column at hand: how long the whole lasts and what is left of it, and a step that is
# taken whatever its error, s; growth of the top layer now and a step ago, kg/(m2 s), 0 if unknown;
# what it gains or loses until a kink, kg/m2, and the time until then, s, below 0 if there is none;
# the fastest rate, 1/s; length of the step, s, and the part of it that lies before a kink; its
# scheme; the most layers so far; whether K1 holds the rates at NOW.
STEP = Record(
    "duration left shortest growth before distance kink fastest length landed scheme most",
    "fresh",
    whole="scheme most fresh",
)

# What is done with the column at hand: how many sizes take part, and terms of what lands on it;
# the deck + 1 whose knots are recorded, and from where; how many parts of the trajectory have their
# means taken, which is at hand, and the moment from which, s.
WORK = Record(
    "active source_terms recorded recorded_from parts part parts_from",
    whole="active source_terms recorded parts part",
)

# What was done and what was skipped.
COUNTER = Record(
    "steps steady_steps displacement_solutions packages_integrated packages_skipped",
    "column_steps column_steps_rejected column_steps_forced pair_steps chain_steps landings",
    "rates sub_steps coarse_sizes_skipped empty_sizes_skipped used_up_sizes_skipped merges",
    "cohorts_followed partitions",
)

# What may be left out, each with its counter; 1 = on (the default), 0 = off.
SWITCH = Record(
    "coarse_sizes empty_sizes used_up_sizes explicit idle_packages shared_trajectory",
    "closed_cohorts steady_scene displacement",
)

# Streams by class: rows of `class_mass`; OVER is the top deck's, the other decks' follow.
# Cumulative masses are pairs (sum, compensation): rows 2 k and 2 k + 1 of `ledger`.
FED, UNDER, OVER = 0, 1, 2

# Why a screen is refused, by texts of errors.py; 0 where it is not.
ACCEPTED = 0
REFUSED = Places(
    1,
    "not_finite too_small too_large bad_sum two_limits not_ascending no_choice no_layer",
    "short_deck unequal_decks coarser_below off_table too_steep no_velocity no_conveying no_feed",
    "no_bed_velocity still_panel body_stays short_slot no_slot",
)
REFUSAL = Record("code index value limit")

# What one of many steady solutions gives first: whether it was refused. Behind it come outputs,
# results of decks, streams between them, alarms and the class rates of all streams.
FIGURE = Record("code index value limit residence_time")

MAX_ORDER = 8
MAX_HARMONICS = 4
DISPLACEMENT_RESULT = 7

# --- fields: name and shape in terms of the dimensions ------------------------------------------
_SECTIONS: dict[str, dict[str, tuple[Symbol, ...]]] = {
    "parameters": {
        "parameter": (PARAMETER,),
        "lower upper": ("classes",),
        "width": ("decks",),
        "panel": ("decks", "panels", PANEL),
    },
    "inputs": {"input": (INPUT,), "fraction": ("classes",)},
    "outputs": {
        "output": (OUTPUT,),
        "undersize_fraction oversize_fraction": ("classes",),
        "intermediate": ("lower_decks", INTERMEDIATE),
        "intermediate_fraction": ("lower_decks", "classes"),
        "deck_result": ("decks", DECK_RESULT),
    },
    "constants": {
        "switch": (SWITCH,),
        # least and most of every parameter and input, in their order
        "limit": ("setting", 2),
        # 1: the composition inside a layer is linear, not even (`bed.reconstruction`)
        "reconstruction": (1,),
        # 1: u, and w, follow from the vibration (`passage.closure`, `segregation.closure`)
        "closure": (2,),
        "harmonic": (MAX_HARMONICS, 5),
        "edge": ("edges",),
        "size node_class node_position node_weight": ("nodes",),
        "panel_count": ("decks",),
        "panel_cells": ("decks", "panels"),
        # passage velocity on a panel over that of the top deck's first one, by a table
        "passage_factor": ("decks", "panels"),
    },
    "state": {
        "counter": (COUNTER,),
        # sums and their compensation
        "ledger": ("streams", 2, "classes"),
        "initial_mass held": ("classes",),
        "steady_rate": ("streams", "classes"),
        "memory": (MEMORY,),
        "alarm": (ALARM_COUNT, ALARM),
        # of the last step: undersize of every deck, then oversize of every deck, kg
        "step_mass": (2, "decks", "nodes"),
        "last_seen": ("seen",),
        "feed_fraction": ("nodes",),
        "scene": ("decks", "panels", SCENE),
        "deck": ("decks", DECK),
        "queue cell free length layers_used on_panel": ("decks", "packages"),
        "pace": ("decks", "packages", 4),
        # slot + 1 of the leading slice of the closed cohort that a package is a part of; 0: of none
        "leader": ("decks", "packages"),
        # of a leading slice: velocity at which its cohort came in, m/s
        "entry_velocity": ("decks", "packages"),
        # of a part of a cohort and of a leading slice: what has passed since it came in, kg/m2
        "passed": ("decks", "packages", "nodes"),
        "load": ("decks", "packages", "layers", "nodes"),
        "reference": ("decks", "packages", "nodes"),
        "lead": ("decks", "layers", "nodes"),
        "lead_feed lead_passed": ("decks", "nodes"),
        "partial": ("decks", "layers", "nodes"),
        "partial_passed": ("decks", "nodes"),
        # along a steady deck with one below: place, what has passed up to there [kg/s] and falls
        # there [kg/(m s)] on both sides of the place; and what a lower cohort still owes
        "knot_place": ("decks", "knots"),
        "knot_passed knot_before knot_after": ("decks", "knots", "nodes"),
        "carry": ("decks", "nodes"),
    },
    "work": {
        "refusal": (REFUSAL,),
        "seen_now": ("seen",),
        "slope": ("edges",),
        "scene_now": ("decks", "panels", SCENE),
        "motion_harmonic": (1 + MAX_HARMONICS, 5),
        "displacement_result": (DISPLACEMENT_RESULT,),
        "drive_setting": (5,),
        "displacement_work": ("displacement_work",),
        "class_mass": ("streams", "classes"),
        "recovery": ("classes",),
        "work": (WORK,),
        "step": (STEP,),
        "hold_up_work": ("decks",),
        # what fell from the packages of a deck: from where to where, and how much; from its cohort
        "fall_start fall_stop": ("decks", "falls"),
        "fall": ("decks", "falls", "nodes"),
        "fall_cohort": ("decks", "nodes"),
        "fall_count": ("decks", 4),
        # what passed and passes of the slice that is recorded
        "recorded": (2, "nodes"),
        # what lands on the packages of a deck, and where they are
        "landing_start landing_stop": ("falls",),
        "landing": ("falls", "nodes"),
        # parts of a trajectory whose means are wanted: when each ends, s; the slot that gets its
        # loads; time integral of what passed, kg s/m2; what the slot held before, kg/m2
        "part_end part_slot": ("packages",),
        "part_passed part_before": ("packages", "nodes"),
        "column_flux": (2, "nodes"),
        "column_time": ("layers", "nodes"),
        # coefficients in time of what lands, of all nodes and of those that take part
        "source": (3, "nodes"),
        "source_now": (3, "sizes"),
        # sizes and 1/reference of the nodes that take part
        "compact": (2, "sizes"),
        # where each size of a column is in a block, -1: nowhere, and its share of what is there
        "place share": ("nodes",),
        # columns in time: what passed, loads, composition of the top layer (rates.py)
        # and after them two rows an order of extrapolation: column and its time integral
        "stage": (10 + 2 * MAX_ORDER, "block"),
        # many steady solutions: what is set, harmonics, and what came out, a row a design
        "design": ("designs", "setting"),
        "design_harmonic": ("designs", MAX_HARMONICS * 5),
        "design_result": ("designs", "result"),
        "strength": (2,),
        # sizes at which classes are broken: apertures, and sizes from which on nothing passes
        "kinks": (2, "all_panels"),
        "scratch percolation": ("layers", "sizes"),
        "node_work": (4, "sizes"),
        "spare": (4, "nodes"),
        "upward": ("layers",),
    },
}
SECTIONS = {
    title: {name: symbols for names, symbols in fields.items() for name in names.split()}
    for title, fields in _SECTIONS.items()
}
# Fields that end in a matrix; the others end in a vector or a record.
_MATRICES = "harmonic motion_harmonic source source_now load lead partial column_time scratch"
MATRICES = (*_MATRICES.split(), "percolation")
# Sizes of what there is, and addresses of a user's own models.
_WHOLE = (
    "classes nodes decks panels layers packages cells layered bed_layers knots falls designs",
    "displacement_work displacement_address passage_address segregation_address",
)
DIMENSION = Record(*_WHOLE, whole=" ".join(_WHOLE))
_SHAPES = {name: symbols for fields in SECTIONS.values() for name, symbols in fields.items()}
KINDS = {name: kind for name, (*_, kind) in _SHAPES.items() if isinstance(kind, Record)}
FIELD = tuple(_SHAPES)
HEADER_SIZE = len(DIMENSION) + len(FIELD)
# Places in the header that hold the offsets of the fields.
AT = Places(len(DIMENSION), *FIELD)


# --- a field by its name -------------------------------------------------------------------------
@kernel
def vector(buffer, at, size, row):
    """Row `row` of a field of rows of `size` numbers."""
    return view1(buffer, int(buffer[at]) + row * size, size)


@kernel
def extent(buffer):
    """Dimensions of the buffer."""
    return record(buffer, 0, DIMENSION)


@kernel
def edges(buffer):
    """Limits of the size classes, one more than these."""
    return extent(buffer).classes + 1


@kernel
def sizes(buffer):
    """Sizes that take part in the column at hand, a multiple of four."""
    return record(buffer, int(buffer[AT.work]), WORK).active


# `state.lead(buffer, deck)` is the field `lead` of a deck, and so on.
_FURTHER = {"edges": edges, "sizes": sizes}
globals().update(fields_of(DIMENSION, AT, _SHAPES, MATRICES, _FURTHER))
parameters, inputs, outputs = (globals()[name] for name in ("parameter", "input", "output"))
switches, counters, book = (globals()[name] for name in ("switch", "counter", "deck"))


@kernel
def panel_place(buffer, deck, number):
    """Where the parameters of a panel begin in the buffer."""
    row = deck * extent(buffer).panels + number
    return int(buffer[AT.panel]) + row * len(PANEL)


@kernel
def result_widths(decks, classes):
    """Numbers in the parts of a row of many steady solutions, in their order.

    FIGURE, outputs, results of decks, what is between them, alarms, streams by class.
    """
    between, streams = (decks - 1) * len(INTERMEDIATE), (OVER + decks) * classes
    alarms = ALARM_COUNT * len(ALARM)
    return len(FIGURE), len(OUTPUT), decks * len(DECK_RESULT), between, alarms, streams


@kernel
def slot(buffer, deck, index):
    """Number of a package slot over all decks."""
    return deck * extent(buffer).packages + int(index)
