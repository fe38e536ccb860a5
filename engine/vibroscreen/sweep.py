"""Many steady states at once: for sweeps, optimisation, and maps of a design space."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vibroscreen.config import ScreenConfig
from vibroscreen.errors import InputError
from vibroscreen.fields import nearest
from vibroscreen.figures import ALARMS, DECK, BoxFigures, figures_of
from vibroscreen.figures import Figure as Output
from vibroscreen.kernels import state
from vibroscreen.kernels.entry import SOLVE_MANY, run
from vibroscreen.layout import Layout
from vibroscreen.results import DeckResult, box_of, reasons
from vibroscreen.screen import (
    check_supported,
    fill,
    nodes_of,
    put_nodes,
    refusal_of,
    settings_of,
    slice_layout,
)
from vibroscreen.sections import BESIDE

if TYPE_CHECKING:  # the host of an FMU need not have it
    import pandas as pd
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

# Designs that a thread takes at a time.
CHUNK = 64
ANY = 1e-3  # in the place of a number that a column brings
FEED_FRACTION = "feed.mass_fraction"
# Alarms in the order of the bits of `SteadyTable.alarms`.
ALARM_NAMES = tuple(alarm.name for alarm in ALARMS)


@dataclass(frozen=True, eq=False, kw_only=True)
class SteadyTable(BoxFigures[Array]):
    """Steady states of many designs, a row each.

    recovery[design, class]: part of each class that reaches the undersize, 0 for one that is not
    fed; undersize, oversize [design, class] and intermediate [design, deck below the top, class]
    in kg/s; intermediate_p80, intermediate_p50 [design, deck below the top] in m; residence_time in
    s of the top deck. `decks` has the results of every deck, a row of numbers each, such as
    `decks[0].efficiency`. All other numbers [design] in the units of `StepResult`, nan for what
    there is nothing of.
    alarms[design]: a bit an alarm, 1 for the first of `ALARM_NAMES`, 2, 4 and so on for the next. A
    design that was refused has zeros and its reason in `refused`.
    """

    values: Mapping[str, Array]
    recovery: Array
    undersize: Array
    oversize: Array
    intermediate: Array
    intermediate_p80: Array
    intermediate_p50: Array
    residence_time: Array
    decks: tuple[DeckResult[Array], ...]
    alarms: NDArray[np.int64]
    _alarm: Array = field(repr=False)
    refused: Mapping[int, str] = field(default_factory=dict)

    def alarm_reasons(self, design: int) -> dict[str, str]:
        """Alarms of a design that are set, by name, with what is wrong."""
        return reasons(self._alarm[design])

    def frame(self) -> pd.DataFrame:
        """Table by design: what was varied, product rates [kg/s] and figures.

        Figures of the box, then `deck[1].efficiency` and so on, and a column an alarm.
        """
        import pandas as pd

        columns = {name: value for name, value in self.values.items() if value.ndim == 1}
        columns["undersize_kg_s"] = self.undersize.sum(axis=1)
        for k in range(self.intermediate.shape[1]):
            columns[f"intermediate_{k + 1}_kg_s"] = self.intermediate[:, k].sum(axis=1)
        columns["oversize_kg_s"] = self.oversize.sum(axis=1)
        for figure in figures_of(BoxFigures):
            if figure.scalar not in ("efficiency", "balance_error"):  # said once, or round-off
                columns[_titled(figure)] = getattr(self, figure.scalar)
        for k in range(self.intermediate.shape[1]):
            columns[f"intermediate_{k + 1}_p80_m"] = self.intermediate_p80[:, k]
            columns[f"intermediate_{k + 1}_p50_m"] = self.intermediate_p50[:, k]
        for deck in self.decks:
            for figure in DECK:
                columns[f"deck[{deck.deck}].{_titled(figure)}"] = getattr(deck, figure.scalar)
        for place, name in enumerate(ALARM_NAMES):
            columns[name] = (self.alarms >> place & 1).astype(bool)
        index = pd.RangeIndex(len(self.recovery), name="design")
        return pd.DataFrame(columns, index=index)

    def _repr_html_(self) -> str:
        """The table for a notebook, and why designs were refused."""
        table = self.frame().to_html(max_rows=20, float_format="{:.5g}".format)
        told = "".join(f"<li>design {k}: {escape(why)}</li>" for k, why in self.refused.items())
        return f"{table}\n<ul>{told}</ul>" if told else table

    def plot(self, name: str | None = None) -> Figure:
        """Efficiency of every deck over the designs, or over what was varied under `name`.

        A picture of matplotlib; raises ImportError without it.
        """
        from vibroscreen.report.pictures import draw_table

        return draw_table(self, name)


def _titled(figure: Output) -> str:
    """Name of a column: with its unit, as TOML keys have it."""
    unit = {"1": "", "m/s": "_m_s", "kg/s": "_kg_s"}.get(figure.unit, f"_{figure.unit.lower()}")
    return f"{figure.scalar}{unit}"


def solve_steady_many(
    designs: ScreenConfig | Sequence[ScreenConfig],
    values: Mapping[str, ArrayLike] | None = None,
    *,
    threads: int | None = None,
    refused: str = "raise",
    progress: Callable[[int, int], None] | None = None,
) -> SteadyTable:
    """Steady states of many designs on all cores, each as `Screen.solve_steady` gives it.

    designs: configurations of the same classes, models, and numbers of decks and panels; or one
    configuration, and `values` by name of the FMU's variables, one number a design (or one for
    all): such as {"deck[1].panel[1].aperture": apertures, "motion.frequency": frequencies}, in SI
    units; "feed.mass_fraction" takes a row of fractions a design. threads: all cores unless given.
    refused: "raise", or "mark" to go on and give the reasons in `SteadyTable.refused`. progress is
    called with the number of designs done and of all. Raises InputError with the number of the
    design for what a steady solution refuses, ConfigError for what a configuration refuses.
    """
    if refused not in ("raise", "mark"):
        raise InputError(f'refused = {refused!r} is unknown: give "raise" or "mark"', "refused")
    if isinstance(designs, ScreenConfig):
        given = _columns(designs, values or {})
        base = _begun(designs, given.keys())
        settings, harmonics = _settings_of_values(base, given)
    else:
        if values:
            raise InputError("values go with one configuration: give one of the two", "values")
        base, given = _common(designs), {}
        settings, harmonics = _settings_of_configs(designs)
    result = _solve(_Ready(base), settings, harmonics, threads, progress)
    return _table(base, given, settings, result, refused)


class Sweep:
    """Configurations of one structure, made ready once and solved many times under other numbers.

    Raises InputError where they are not of one structure, ConfigError for what the engine cannot
    run.
    """

    def __init__(self, designs: Sequence[ScreenConfig]) -> None:
        self.base = _common(designs)
        self._tables = any(config.passage.velocity_table is not None for config in designs)
        self._designs = tuple(designs)
        self._begin = functools.lru_cache(maxsize=4)(self._begun)
        self._known = places(self.base)

    def solve(
        self,
        values: Mapping[str, ArrayLike],
        *,
        threads: int | None = None,
        refused: str = "raise",
    ) -> SteadyTable:
        """Steady states under `values` by name, a number each for the designs in turn.

        So n designs take n numbers, or a multiple: row r belongs to design r modulo n. Errors as
        of `solve_steady_many`.
        """
        columns = _columns(self.base, values)
        ready, own, rows = self._begin(tuple(columns))
        base = ready.config
        count = len(next(iter(columns.values()))) if columns else len(own)
        repeat, rest = divmod(count, len(own))
        if rest:
            raise InputError(
                f"values have {count} rows for {len(own)} designs: give a multiple",
                "values",
            )
        settings = np.tile(own, (repeat, 1))
        _put_columns(base, columns, settings, self._known)
        if self._tables and any(name.endswith(".aperture") for name in columns):
            raise InputError(
                "apertures change under passage.velocity_table: give passage.velocity", "values"
            )
        solved = _solve(ready, settings, np.tile(rows, (repeat, 1)), threads, None)
        return _table(base, columns, settings, solved, refused)

    def _begun(self, names: tuple[str, ...]) -> tuple[_Ready, Array, Array]:
        """First configuration, settings and harmonics, before numbers of these names are put in."""
        designs = [_begun(design, names) for design in self._designs]
        return _Ready(designs[0]), *_settings_of_configs(designs)


# --- what is asked for ---------------------------------------------------------------------------
def _begun(config: ScreenConfig, names: Collection[str]) -> ScreenConfig:
    """A configuration that gives the numbers of these names, so that nothing else stands for them.

    What it gives is written over by the columns.
    """
    beside = {*BESIDE, *BESIDE.values()}
    given = [name for name in names if name in beside or name.rpartition(".")[2] in beside]
    return config.with_values({name: config.value_of(name) or ANY for name in given})


def _columns(config: ScreenConfig, values: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Values by name as columns of one length."""
    columns: dict[str, Array] = {}
    for name, value in values.items():
        column = np.asarray(value, dtype=float)
        rows = 2 if name == FEED_FRACTION else 1
        if column.ndim not in (rows, rows - 1) or column.size == 0:
            what = "a row of fractions a design" if rows == 2 else "one number a design"
            raise InputError(f"{name} has the shape {column.shape}: give {what}", name)
        if not np.isfinite(column).all():
            place = int(np.argwhere(~np.isfinite(np.atleast_1d(column)))[0, 0])
            raise InputError(f"{name} is not finite in design {place}: give finite numbers", name)
        columns[name] = column
    counts = {
        name: len(column)
        for name, column in columns.items()
        if column.ndim == (2 if name == FEED_FRACTION else 1)
    }
    if len(set(counts.values())) > 1:
        said = ", ".join(f"{name}: {count}" for name, count in counts.items())
        raise InputError(f"values have different lengths ({said}): give one row a design", "values")
    count = next(iter(counts.values()), 1)
    classes = config.size_classes.count
    for name, column in columns.items():
        if name == FEED_FRACTION:
            if column.shape[-1] != classes:
                raise InputError(
                    f"{name} has {column.shape[-1]} fractions a design, the screen has {classes} "
                    "size classes: give one fraction a class",
                    name,
                )
            columns[name] = np.broadcast_to(column, (count, classes))
        else:
            columns[name] = np.broadcast_to(column, (count,))
    return columns


def places(config: ScreenConfig) -> dict[str, int]:
    """Where the numbers that a sweep may change lie among parameters and inputs, by name."""
    return {
        number.name: k
        for k, number in enumerate(settings_of(config))
        if number and not number.whole and number.name != "solver.tolerance"
    }


def _settings_of_values(config: ScreenConfig, columns: Mapping[str, Array]) -> tuple[Array, Array]:
    """Settings [design, number] and harmonics of one configuration under columns of values."""
    layout = slice_layout(config)
    known = places(config)
    setting, harmonic = _setting(config, layout)
    count = len(next(iter(columns.values()))) if columns else 1
    settings = np.tile(setting, (count, 1))
    _put_columns(config, columns, settings, known)
    _follow_table(config, columns, settings, known)
    return settings, np.tile(harmonic, (count, 1))


def _put_columns(
    config: ScreenConfig,
    columns: Mapping[str, Array],
    settings: Array,
    known: Mapping[str, int],
) -> None:
    """Write columns of values into settings [design, number], where a sweep may change them."""
    for name, column in columns.items():
        if name == FEED_FRACTION:
            start = known[f"{FEED_FRACTION}[1]"]
            settings[:, start : start + column.shape[1]] = column
            continue
        if name not in known:
            raise InputError(
                f"{name} is not a number that a sweep can change: the nearest is "
                f"{nearest(name, known)}",
                name,
            )
        settings[:, known[name]] = column


def _setting(config: ScreenConfig, layout: Layout) -> tuple[Array, Array]:
    """Parameters and inputs of a configuration in a row, and its harmonics."""
    buffer = layout.buffer()
    fill(layout, buffer, config)
    part = slice(layout.section["parameters"].start, layout.section["inputs"].stop)
    return buffer[part].copy(), layout.view(buffer, "harmonic").ravel().copy()


def _follow_table(
    config: ScreenConfig, columns: Mapping[str, Array], settings: Array, known: Mapping[str, int]
) -> None:
    """Read the passage velocity from its table where the aperture changes."""
    table = config.passage.velocity_table
    changed = [name for name in columns if name.endswith(".aperture")]
    if table is None or not changed or "passage.velocity" in columns:
        return
    name = "deck[1].panel[1].aperture"
    if len(config.apertures) > 1:
        raise InputError(
            f"{changed[0]} changes under passage.velocity_table on a screen of several panels: "
            "give passage.velocity, or configurations in the place of values",
            changed[0],
        )
    apertures, velocities = np.array(table).T
    for value in (columns[name].min(), columns[name].max()):
        config.passage.velocity_at(float(value))
    settings[:, known["passage.velocity"]] = np.interp(columns[name], apertures, velocities)


def _common(configs: Sequence[ScreenConfig]) -> ScreenConfig:
    """The first of some configurations; raises InputError where they are not of one structure."""
    if len(configs) == 0:
        raise InputError("designs is empty: give at least one configuration", "designs")

    def structure(config: ScreenConfig) -> dict[str, object]:
        return {
            "size_classes": config.size_classes,
            "deck": tuple(len(deck.panels) for deck in config.decks),
            "passage.law": config.passage.law,
            "segregation.model": config.segregation.model,
            "displacement.model": config.displacement.model,
            "bed.layers": config.bed.layers,
            "solver": config.solver,
            "passage.velocity_table over panels": _passage_of_panels(config),
            "closure": (config.passage.follows_vibration, config.segregation.follows_vibration),
        }

    first = structure(configs[0])
    for place, config in enumerate(configs):
        for name, value in structure(config).items():
            if value != first[name]:
                raise InputError(
                    f"designs[{place}] has another {name} than designs[0]: solve designs of one "
                    "structure together",
                    "designs",
                )
    return configs[0]


def _passage_of_panels(config: ScreenConfig) -> tuple[float, ...] | None:
    """Passage velocities of the panels, where they are not the same on all."""
    speeds = tuple(config.passage.velocity_at(aperture) for aperture in config.apertures)
    return speeds if len(set(speeds)) > 1 else None


def _settings_of_configs(configs: Sequence[ScreenConfig]) -> tuple[Array, Array]:
    """Settings and harmonics of configurations of one structure."""
    layout = slice_layout(configs[0])
    rows = [_setting(config, layout) for config in configs]
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


# --- solving -------------------------------------------------------------------------------------
class _Ready:
    """A configuration as the engine has it, with room for a chunk of designs beside it."""

    def __init__(self, config: ScreenConfig) -> None:
        check_supported(config)
        self.config, self.layout = config, slice_layout(config, designs=CHUNK)
        self.buffer = self.layout.buffer()
        fill(self.layout, self.buffer, config)
        put_nodes(self.layout, self.buffer, nodes_of(config))
        part = slice(self.layout.section["parameters"].start, self.layout.section["inputs"].stop)
        self.setting = self.buffer[part].copy()


def _solve(
    ready: _Ready,
    settings: Array,
    harmonics: Array,
    threads: int | None,
    progress: Callable[[int, int], None] | None,
) -> Array:
    """Rows of results, in the order of the settings, whatever the number of threads."""
    count, layout = len(settings), ready.layout
    # Nodes are those of the configuration, unless a design has other apertures.
    rebuild = float(not (settings == ready.setting).all())
    results = np.zeros((count, layout.shape["design_result"][1]))
    starts = list(range(0, count, CHUNK))

    def work(own: Sequence[int]) -> None:
        buffer = layout.buffer()
        buffer[:] = ready.buffer
        for start in own:
            stop = min(start + CHUNK, count)
            layout.view(buffer, "design")[: stop - start] = settings[start:stop]
            layout.view(buffer, "design_harmonic")[: stop - start] = harmonics[start:stop]
            run(buffer, SOLVE_MANY, float(stop - start), rebuild)
            results[start:stop] = layout.view(buffer, "design_result")[: stop - start]
            done.append(stop - start)
            if progress is not None:
                progress(sum(done), count)

    done: list[int] = []
    workers = max(1, min(threads or cores(), len(starts)))
    # Chunks in turn, so that neighbours of unlike cost are spread.
    shares = [starts[k::workers] for k in range(workers)]
    if workers == 1:
        work(starts)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, shares))
    return results


def _table(
    config: ScreenConfig,
    given: Mapping[str, Array],
    settings: Array,
    results: Array,
    refused: str,
) -> SteadyTable:
    """Results by name; raises for, or notes, the designs that were refused."""
    layout = slice_layout(config)
    figures = dict(zip(state.FIGURE, results[:, : len(state.FIGURE)].T, strict=True))
    reasons_of_refusal: dict[int, str] = {}
    for design in np.flatnonzero(figures["code"] != state.ACCEPTED).tolist():
        buffer = layout.buffer()
        fill(layout, buffer, config)
        start = layout.section["parameters"].start
        buffer[start : start + settings.shape[1]] = settings[design]
        said = [figures[name][design] for name in ("code", "index", "value", "limit")]
        error = refusal_of(layout, buffer, *said)
        if refused == "raise":
            raise InputError(f"design {design}: {error}", error.variable)
        reasons_of_refusal[design] = str(error)
    count, classes, decks = len(results), config.size_classes.count, len(config.decks)
    parts = np.split(results, np.cumsum(state.result_widths(decks, classes))[:-1], axis=1)
    _, output, of_decks, between, alarm, rates = parts
    rates = rates.reshape(count, state.OVER + decks, classes)
    products = rates[:, state.UNDER :]
    total = products.sum(axis=1)
    outputs = dict(zip(state.OUTPUT, output.T, strict=True))
    flags = np.array([outputs[name.scalar] for name in ALARMS]).astype(np.int64)
    sizes = between.reshape(count, decks - 1, len(state.INTERMEDIATE))
    return SteadyTable(
        values=given,
        recovery=np.divide(products[:, 0], total, out=np.zeros_like(total), where=total > 0.0),
        undersize=products[:, 0],
        oversize=products[:, 1],
        intermediate=products[:, 2:],
        intermediate_p80=sizes[:, :, state.INTERMEDIATE.index("p80")],
        intermediate_p50=sizes[:, :, state.INTERMEDIATE.index("p50")],
        residence_time=figures["residence_time"],
        decks=tuple(
            DeckResult[Array](deck=d + 1, **dict(zip(state.DECK_RESULT, rows.T, strict=True)))
            for d, rows in enumerate(np.split(of_decks, decks, axis=1))
        ),
        alarms=(flags << np.arange(len(ALARMS))[:, None]).sum(axis=0),
        _alarm=alarm.reshape(count, len(ALARMS), len(state.ALARM)),
        refused=reasons_of_refusal,
        **box_of(outputs),
    )
