"""Pictures for people: of a screen, of what it gives, of many designs, of a calibration.

A function draws into axes what it is given, or makes a picture of them. No text in them is read as
a formula: names of runs and designs come from files.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vibroscreen.kernels.outputs import deep_in_apertures
from vibroscreen.units import DEG, MM, PERCENT, T_H

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from vibroscreen.calibrate import Calibration
    from vibroscreen.config import ScreenConfig
    from vibroscreen.report.specification import Specification
    from vibroscreen.results import Told
    from vibroscreen.sections import Deck
    from vibroscreen.steady import SteadyResult
    from vibroscreen.sweep import SteadyTable

__all__ = [
    "draw_bed",
    "draw_calibration",
    "draw_gradation",
    "draw_map",
    "draw_partition",
    "draw_recovery",
    "draw_result",
    "draw_sketch",
    "draw_table",
    "picture",
]

Array = NDArray[np.float64]

# Colours that people tell apart who see fewer of them (Okabe and Ito), and dashes for paper.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9")
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (3, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)))
FEED, STEEL, BAND = "#222222", "#555555", "#e6e6e6"
STYLE: dict[Any, Any] = {
    "text.parse_math": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "vibroscreen",
    "font.sans-serif": ["DejaVu Sans", "Arial"],
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e0e0e0",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 1.3,
    "lines.markersize": 3.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
}
# A picture in a column of a page, or as wide as a telephone, in.
WIDTH, HEIGHT = 3.7, 2.6
# Finest size of a partition curve, over the aperture: below it all is alike.
SHOWN_BELOW = 0.03
# Stroke of the vibration in the sketch, over the length of the deck; distance of decks over it.
SHOWN_STROKE, SHOWN_GAP = 0.09, 0.13


@contextmanager
def styled() -> Iterator[None]:
    """The house's style. Raises ImportError without matplotlib."""
    try:
        import matplotlib as mpl
    except ImportError:
        raise ImportError(
            "pictures need matplotlib, which is not installed: pip install 'vibroscreen[report]'"
        ) from None
    with mpl.rc_context(STYLE):
        yield


def picture(
    draw: Callable[..., None], *what: Any, width: float = WIDTH, height: float = HEIGHT, **more: Any
) -> Figure:
    """A picture of `width` by `height` in of what a function draws into axes."""
    with styled():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(width, height), layout="constrained")
        draw(figure.subplots(), *what, **more)
        return figure


def _grid(rows: int, columns: int, width: float, height: float) -> tuple[Figure, list[Axes]]:
    """A picture of several axes, each of `width` by `height` in."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    return figure, list(figure.subplots(rows, columns, squeeze=False).flat)


def _looks(count: int) -> list[dict[str, Any]]:
    """Colour and dashes of so many lines."""
    return [
        {"color": COLOURS[k % len(COLOURS)], "linestyle": DASHES[k % len(DASHES)]}
        for k in range(count)
    ]


def deck_name(number: int, deck: Deck) -> str:
    """What a deck is called in a picture: number, and its apertures in mm."""
    sizes = dict.fromkeys(f"{panel.aperture / MM:.4g}" for panel in deck.panels)
    return f"deck {number}, {' / '.join(sizes)} mm"


def product_name(name: str) -> str:
    """A product as people name it: `intermediate[1]` is intermediate 1."""
    return name.replace("[", " ").replace("]", "")


# --- results -------------------------------------------------------------------------------------
def draw_gradation(axes: Axes, result: Told, specification: Sequence[Specification] = ()) -> None:
    """Passing over size of the feed and of all products, with the bands of a specification."""
    edges = np.array(result.size_classes.edges) / MM
    shown = edges > 0.0
    streams = result.streams
    looks = [{"color": FEED, "linestyle": "-"}, *_looks(len(streams) - 1)]
    by_name = dict(zip(streams, looks, strict=True))
    for band in specification:
        look = by_name[band.product]
        axes.fill_between(
            band.size / MM,
            band.least / PERCENT,
            band.most / PERCENT,
            color=look["color"],
            alpha=0.18,
            linewidth=0.0,
            label=f"specified: {product_name(band.product)}",
        )
        axes.vlines(
            band.size / MM,
            band.least / PERCENT,
            band.most / PERCENT,
            color=look["color"],
            alpha=0.35,
            linewidth=4.0,
        )
    for (name, stream), look in zip(streams.items(), looks, strict=True):
        if stream.mass_flow_rate > 0.0:
            passing = stream.passing[shown] / PERCENT
            axes.plot(edges[shown], passing, marker="o", label=product_name(name), **look)
    _sizes_along(axes)
    axes.set(ylabel="passing [%]", ylim=(-2.0, 102.0))
    if len(streams) + len(specification) <= 4:
        axes.legend()
    else:  # it would lie on the curves
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=4.5, ncols=2)


def draw_partition(axes: Axes, result: Told) -> None:
    """Part of each size that leaves over each deck, of what comes to that deck."""
    for deck, look in zip(result.decks, _looks(len(result.decks)), strict=True):
        if deck.feed_rate <= 0.0:
            continue
        curve = deck.partition
        name = f"deck {deck.deck}, {deck.aperture / MM:.4g} mm"
        axes.plot(curve.size / MM, curve.to_oversize / PERCENT, label=name, **look)
        axes.axvline(deck.aperture / MM, color=look["color"], linewidth=0.6, linestyle=":")
        if curve.crossed:
            axes.plot(curve.cut_size / MM, 50.0, "D", color=look["color"], markersize=4.5)
    _sizes_along(axes)
    finest = min(deck.aperture for deck in result.decks) / MM
    axes.set_xlim(left=max(axes.get_xlim()[0], SHOWN_BELOW * finest))
    axes.set(ylabel="to the oversize of the deck [%]", ylim=(-2.0, 102.0))
    axes.legend()


def _sizes_along(axes: Axes) -> None:
    """Sizes in mm along the axes, in plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axes.set(xscale="log", xlabel="size [mm]")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def draw_recovery(axes: Axes, steady: SteadyResult) -> None:
    """Undersize of each deck that passed it up to a place, of what comes to that deck."""
    for deck, profile, look in _by_deck(steady):
        name = deck_name(deck, steady.config.decks[deck - 1])
        axes.plot(profile.position, profile.recovery / PERCENT, label=name, **look)
    axes.set(ylabel="undersize recovered [%]", ylim=(-2.0, 102.0))
    _places_along(axes, steady)
    axes.legend()


def draw_bed(axes: Axes, steady: SteadyResult) -> None:
    """Depth of the bed along each deck, and the depth at the discharge that raises the alarm."""
    apertures = float(deep_in_apertures(steady.config.material.bulk_density))
    for deck, profile, look in _by_deck(steady):
        here = steady.config.decks[deck - 1]
        axes.plot(profile.position, profile.depth / MM, label=deck_name(deck, here), **look)
        deep = apertures * here.panels[-1].aperture / MM
        axes.plot([here.length], [deep], "_", color=look["color"], markersize=9.0, clip_on=False)
    axes.set(ylabel="depth of the bed [mm]", ylim=(0.0, None))
    _places_along(axes, steady)
    axes.legend(title=f"dash at the end: {apertures:.3g} apertures", title_fontsize=7.0)


def _places_along(axes: Axes, steady: SteadyResult) -> None:
    """Places along the decks, from end to end."""
    length = steady.config.decks[0].length
    axes.set(xlabel="place along the deck [m]", xlim=(-0.01 * length, 1.01 * length))


def _by_deck(steady: SteadyResult) -> Iterable[tuple[int, Any, dict[str, Any]]]:
    """Number, profile and look of every deck that gets something."""
    looks = _looks(len(steady.decks))
    for deck, profile, look in zip(steady.decks, steady.profiles, looks, strict=True):
        if deck.feed_rate > 0.0:
            yield deck.deck, profile, look


def draw_map(axes: Axes, steady: SteadyResult, deck: int, classes: slice | int) -> None:
    """Content of a class, or of several together, by place and height in the bed of a deck.

    deck from 1 on, classes from 0 on.
    """
    profile, sizes = steady.profiles[deck - 1], steady.size_classes
    chosen = np.atleast_1d(np.arange(sizes.count)[classes])
    lower, upper = sizes.lower[chosen[0]] / MM, sizes.upper[chosen[-1]] / MM
    content = np.ma.masked_invalid(profile.content(chosen) / PERCENT)
    height = _between(profile.height) / MM
    place = np.broadcast_to(_between(profile.position)[:, None], height.shape)
    axes.grid(visible=False)
    most = float(content.max()) or 1.0  # of nothing there is no scale
    mesh = axes.pcolormesh(place, height, content, vmin=0.0, vmax=most, rasterized=True)
    axes.plot(profile.position, profile.height / MM, color="white", linewidth=0.4)
    axes.plot(profile.position, profile.depth / MM, color=FEED, linewidth=0.8)
    axes.set(
        xlabel="place along the deck [m]",
        ylabel="height in the bed [mm]",
        ylim=(0.0, None),
        xlim=(0.0, float(profile.position[-1])),
        title=f"deck {deck}: {lower:.4g} to {upper:.4g} mm",
    )
    bar = axes.figure.colorbar(mesh, ax=axes, label="content [%]", pad=0.02)
    bar.outline.set_visible(False)


def _between(values: Array) -> Array:
    """Values half-way between neighbouring places, along the first axis, and those at the ends."""
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([values[:1], middle, values[-1:]])


def draw_result(result: Told) -> Figure:
    """Gradations and partition; of a steady state also recovery and bed along the decks."""
    along = hasattr(result, "profiles")
    with styled():
        figure, axes = _grid(1 + along, 2, WIDTH, HEIGHT)
        draw_gradation(axes[0], result)
        draw_partition(axes[1], result)
        if along:
            draw_recovery(axes[2], result)  # type: ignore[arg-type]
            draw_bed(axes[3], result)  # type: ignore[arg-type]
    return figure


# --- the screen ----------------------------------------------------------------------------------
def draw_sketch(axes: Axes, config: ScreenConfig, result: Told | None = None) -> None:
    """The decks from the side: lengths and slopes to scale; their distance is not known.

    The stroke is drawn far too long, in its direction. With a result the streams have their rates.
    """
    decks, length = config.decks, config.decks[0].length
    gap = SHOWN_GAP * length
    arrow = {"arrowstyle": "-|>", "color": STEEL, "linewidth": 1.4, "shrinkA": 0.0, "shrinkB": 0.0}
    feed, under, over = "feed", "undersize", ["oversize", "", "", ""]
    if result is not None:
        rates = [f"{stream.mass_flow_rate / T_H:.4g} t/h" for stream in result.streams.values()]
        feed, under, *between, coarse = rates
        over = [coarse, *between]
    axes.set_aspect("equal")
    axes.axis("off")
    low = 0.0
    for deck, top, rate in zip(decks, -gap * np.arange(len(decks)), over, strict=False):
        lengths, slopes = np.array([(p.length, p.inclination) for p in deck.panels]).T
        x = np.append(0.0, (lengths * np.cos(slopes)).cumsum())
        z = top - np.append(0.0, (lengths * np.sin(slopes)).cumsum())
        axes.plot(x, z, "|-", color=STEEL, linewidth=0.6, markersize=7.0)
        axes.plot(x, z, color=FEED, linewidth=2.6, linestyle=(0, (1.6, 0.7)))
        first = 0
        for aperture, alike in groupby(deck.panels, key=lambda panel: panel.aperture):
            last = first + len(list(alike))
            middle = (first + last) // 2
            slope = slopes[middle]
            axes.annotate(
                f"{aperture / MM:.4g} mm",
                (x[middle : middle + 2].mean(), z[middle : middle + 2].mean()),
                (6.0 * np.sin(slope), 6.0 * np.cos(slope)),
                textcoords="offset points",
                ha="center",
                va="center",
                rotation=-slope / DEG,
            )
            first = last
        _arrow(axes, (x[-1], z[-1]), (0.08 * length, -0.03 * length), arrow)
        axes.text(x[-1] + 0.09 * length, z[-1] - 0.03 * length, rate, va="center")
        low, half = min(low, z[-1]), 0.5 * x[-1]
    _arrow(axes, (0.03 * length, 0.13 * length), (0.0, -0.11 * length), arrow)
    axes.text(0.05 * length, 0.1 * length, feed, va="center")
    _arrow(axes, (half, low - 0.02 * length), (0.0, -0.09 * length), arrow)
    axes.text(half + 0.02 * length, low - 0.08 * length, under, va="center")
    _draw_orbit(axes, config, (0.7 * length, 0.16 * length), SHOWN_STROKE * length)
    _draw_scale(axes, length, low - 0.17 * length)
    axes.margins(0.02)


def sketch_height(config: ScreenConfig) -> float:
    """Height of a sketch of the usual width, in."""
    decks = config.decks
    fall = max(math.fsum(p.length * math.sin(p.inclination) for p in d.panels) for d in decks)
    return WIDTH * (0.42 + SHOWN_GAP * (len(decks) - 1) + fall / decks[0].length) / 1.35


def _arrow(
    axes: Axes, start: tuple[float, float], way: tuple[float, float], look: dict[str, Any]
) -> None:
    end = (start[0] + way[0], start[1] + way[1])
    axes.annotate("", end, start, arrowprops=look)
    axes.plot(*zip(start, end, strict=True), alpha=0.0)  # so that the axes reach there


def _draw_orbit(axes: Axes, config: ScreenConfig, place: tuple[float, float], size: float) -> None:
    """The way of the box in a period, as long as `size`, with frequency and stroke."""
    motion, slope = config.motion, config.decks[0].panels[0].inclination
    angle = np.linspace(0.0, 2.0 * np.pi, 121)
    along, normal = np.zeros_like(angle), np.zeros_like(angle)
    for order, ac, as_, nc, ns in motion.on_panel():
        along += ac * np.cos(order * angle) + as_ * np.sin(order * angle)
        normal += nc * np.cos(order * angle) + ns * np.sin(order * angle)
    reach = float(np.hypot(along, normal).max())
    if reach > 0.0:
        scale = 0.5 * size / reach
        x = scale * (along * np.cos(slope) + normal * np.sin(slope))
        z = scale * (normal * np.cos(slope) - along * np.sin(slope))
        axes.plot(place[0] + x, place[1] + z, color=COLOURS[1], linewidth=1.2)
        k = int(np.argmax(z))  # at the top of the orbit it moves this way
        way = np.array([x[(k + 1) % 120] - x[k - 1], z[(k + 1) % 120] - z[k - 1]])
        if np.hypot(*way) > 1e-3 * size and motion.ellipticity != 0.0:
            axes.annotate(
                "",
                (place[0] + x[k] + 4.0 * way[0], place[1] + z[k] + 4.0 * way[1]),
                (place[0] + x[k], place[1] + z[k]),
                arrowprops={"arrowstyle": "->", "color": COLOURS[1]},
            )
    text = f"{motion.frequency:.4g} Hz, stroke {2.0 * reach / MM:.4g} mm"
    axes.text(place[0] - 0.7 * size, place[1], text, ha="right", va="center", color=COLOURS[1])


def _draw_scale(axes: Axes, length: float, z: float) -> None:
    """A bar of a round length below."""
    power = 10.0 ** np.floor(np.log10(length / 2.0))
    bar = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= length / 2.0)
    axes.plot([0.0, bar], [z, z], "-|", color=FEED, linewidth=1.0, markersize=5.0)
    axes.text(bar * 1.05, z, f"{bar:g} m", va="center")


# --- many designs, calibrations ------------------------------------------------------------------
def draw_table(table: SteadyTable, name: str | None = None) -> Figure:
    """Efficiency of every deck over the designs, or over what was varied under `name`."""
    there = [k for k in range(len(table.recovery)) if k not in table.refused]
    x = there if name is None else table.values[name][there]

    def draw(axes: Axes) -> None:
        for deck, look in zip(table.decks, _looks(len(table.decks)), strict=True):
            values = np.asarray(deck.efficiency)[there] / PERCENT
            axes.plot(x, values, "o", color=look["color"], label=f"deck {deck.deck}")
        axes.set(xlabel=name or "design", ylabel="efficiency of the deck [%]", ylim=(-2.0, 102.0))
        axes.legend()

    return picture(draw, width=5.4, height=3.6)


def draw_calibration(calibration: Calibration, path: str | Path | None = None) -> Figure:
    """Measured recoveries against those of the fit, and of the fits that left their run out.

    With a path the picture is written too; its suffix says the format. Raises ImportError without
    matplotlib.
    """
    found = calibration.fit
    panels = [("modelled", f"fitted, RMSE {found.rmse:.3f}")]
    if found.held_out:
        panels.append(("held_out", f"left out of the fit, RMSE {found.held_out_rmse:.3f}"))
    table = calibration.frame()
    with styled():
        figure, grid = _grid(1, len(panels), 4.4, 4.6)
        for axes, (column, title) in zip(grid, panels, strict=True):
            axes.plot([0.0, 1.0], [0.0, 1.0], color="0.7", linewidth=1.0, zorder=0)
            axes.set(xlim=(-0.05, 1.1), ylim=(-0.05, 1.1))
            axes.set_box_aspect(1.0)
            lines = {
                str(run): axes.plot(part["measured"], part[column], "o", ms=4, alpha=0.8)[0]
                for run, part in table.groupby("run", sort=False)
            }
            axes.set(title=title, xlabel="measured recovery", ylabel="modelled recovery")
        if len(lines) <= 12:
            grid[-1].legend(lines.values(), lines.keys())
    if path is not None:
        figure.savefig(path, dpi=110)
    return figure
