"""Pictures of units, as tools show them."""

from __future__ import annotations

from collections.abc import Callable

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon

from vibroscreen.circuit.crusher import Crusher
from vibroscreen.circuit.handling import Conveyor, Splitter
from vibroscreen.circuit.unit import Unit
from vibroscreen_fmu.drawing import COARSE, FINE, STEEL, png

__all__ = ["picture_of"]


def picture_of(kind: type[Unit]) -> bytes:
    """PNG of a unit of that kind."""
    draw: dict[type[Unit], Callable[[Axes], None]] = {
        Crusher: _draw_crusher,
        Conveyor: _draw_conveyor,
        Splitter: _draw_splitter,
    }
    return png(next((found for base, found in draw.items() if issubclass(kind, base)), _draw_mixer))


def _draw_crusher(axes: Axes) -> None:
    for side in (-1, 1):
        bowl = [(5 + side * 4.4, 8.2), (5 + side * 2.9, 8.2), (5 + side * 3.3, 2.2)]
        axes.add_patch(Polygon([*bowl, (5 + side * 4.4, 2.2)], fc=STEEL))
    axes.add_patch(Polygon([(5, 8.4), (2.3, 2.2), (7.7, 2.2)], fc="#7d8a91", ec=STEEL, lw=2))
    for x, y, radius in ((2.9, 7.6, 0.5), (7.2, 7.4, 0.45), (7.2, 9.0, 0.5), (3.6, 9.0, 0.5)):
        axes.add_patch(Circle((x, y), radius, fc=COARSE, ec=STEEL))
    for x, y in ((1.9, 1.4), (2.3, 0.6), (7.9, 1.4), (7.5, 0.6), (8.2, 0.7)):
        axes.add_patch(Circle((x, y), 0.2, fc=FINE, ec=STEEL))


def _draw_mixer(axes: Axes) -> None:
    axes.add_patch(Polygon([(1, 6), (9, 6), (6, 2.5), (4, 2.5)], fc="#dfe5e9", ec=STEEL, lw=2))
    arrow = {"arrowstyle": "-|>", "lw": 5, "mutation_scale": 22}
    for start, colour in (((1.6, 9.6), COARSE), ((8.4, 9.6), FINE)):
        axes.annotate("", xy=(5, 6.2), xytext=start, arrowprops=arrow | {"color": colour})
    axes.annotate("", xy=(5, 0.2), xytext=(5, 2.6), arrowprops=arrow | {"color": STEEL})


def _draw_conveyor(axes: Axes) -> None:
    for x, y in ((1.6, 2.6), (8.4, 6.4)):
        axes.add_patch(Circle((x, y), 0.9, fc="#dfe5e9", ec=STEEL, lw=3))
    for shift in (-1, 1):
        dx, dy = -0.44 * shift, 0.79 * shift
        axes.plot((1.6 + dx, 8.4 + dx), (2.6 + dy, 6.4 + dy), color=STEEL, lw=4)
    for k in range(5):
        x = 1.9 + 1.35 * k
        axes.add_patch(Circle((x - 0.75, 2.77 + 0.559 * (x - 1.9) + 1.36), 0.45, fc=COARSE))


def _draw_splitter(axes: Axes) -> None:
    axes.add_patch(Polygon([(4, 8), (6, 8), (9, 3), (1, 3)], fc="#dfe5e9", ec=STEEL, lw=2))
    arrow = {"arrowstyle": "-|>", "lw": 5, "mutation_scale": 22}
    axes.annotate("", xy=(5, 7.4), xytext=(5, 9.9), arrowprops=arrow | {"color": STEEL})
    for end, colour in (((1.2, 0.3), COARSE), ((8.8, 0.3), FINE)):
        axes.annotate("", xy=end, xytext=(5, 6), arrowprops=arrow | {"color": colour})
