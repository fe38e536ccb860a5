"""The pictures of an FMU, drawn: `python -m vibroscreen_fmu.drawing` writes them into pictures/.

Drawing takes longer than building an FMU, so the files lie beside the sources.
"""

from __future__ import annotations

import io
from collections.abc import Callable

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from PIL import Image

from vibroscreen_fmu.icons import PICTURES

__all__ = ["COARSE", "FINE", "STEEL", "drawn", "png"]

STEEL, PLATE, COARSE, FINE, RIM = "#2b3a42", "#dfe5e9", "#b07d48", "#d9b382", "#5d4226"
ARROW = "#c0392b"
COLOURS = 64


def png(draw: Callable[[Axes], None], pixels: int = 256) -> bytes:
    """A square picture of what `draw` draws between 0 and 10, on nothing."""
    figure = Figure(figsize=(pixels / 100, pixels / 100), dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0, 10), ylim=(0, 10))
    axes.set_axis_off()
    draw(axes)
    sketch, target = io.BytesIO(), io.BytesIO()
    # Without the library's name the picture is the same for every version that draws the same.
    figure.savefig(sketch, format="png", transparent=True, metadata={"Software": None})
    few = Image.open(sketch).convert("RGBA").quantize(COLOURS)
    few.save(target, format="png", optimize=True)
    return target.getvalue()


def _draw_screen(axes: Axes) -> None:
    slope = -0.2

    def deck(x: float) -> float:
        return 5.6 + slope * (x - 0.6)

    box = [(0.6, 2.2), (0.6, -1.5), (9.4, -1.5), (9.4, 2.2)]
    axes.add_patch(Polygon([(x, deck(x) + dy) for x, dy in box], fc=PLATE, ec=STEEL, lw=2))
    for left in (0.7 + 0.62 * k for k in range(14)):
        ends = (left, left + 0.38)
        axes.plot(ends, [deck(x) for x in ends], color=STEEL, lw=4, solid_capstyle="butt")
    for x in (1.6, 8.4):  # springs
        top = deck(x) - 1.5
        zigzag = [(x + 0.3 * (-1) ** k, top - (k + 0.5) * (top - 0.7) / 6) for k in range(6)]
        points = [(x, top), *zigzag, (x, 0.7)]
        axes.plot(*zip(*points, strict=True), color=STEEL, lw=2)
        axes.plot((x - 0.6, x + 0.6), (0.6, 0.6), color=STEEL, lw=3)
    for x, height, radius in (
        (1.3, 0.55, 0.4),
        (1.9, 1.3, 0.46),
        (2.4, 0.55, 0.36),
        (3.5, 0.6, 0.46),
        (4.6, 0.52, 0.36),
        (5.7, 0.6, 0.46),
        (7.1, 0.55, 0.42),
        (8.6, 0.6, 0.48),
    ):
        axes.add_patch(Circle((x, deck(x) + height), radius, fc=COARSE, ec=RIM))
    for x, fall in ((1.4, 0.6), (2.1, 1.1), (2.9, 0.6), (3.7, 1.1), (4.9, 0.7), (6.2, 1.0)):
        axes.add_patch(Circle((x, deck(x) - fall), 0.17, fc=FINE, ec=RIM))
    arrow = {"arrowstyle": "<|-|>", "color": ARROW, "lw": 3, "mutation_scale": 16}
    axes.annotate("", xy=(7.4, 9.7), xytext=(5.4, 7.7), arrowprops=arrow)


def _draw_stream(axes: Axes) -> None:
    arrow = {"arrowstyle": "-|>", "color": RIM, "lw": 6, "mutation_scale": 30}
    axes.annotate("", xy=(9.6, 5.0), xytext=(0.4, 5.0), arrowprops=arrow)


def drawn() -> dict[str, bytes]:
    """All pictures by file name: a screen with its grains and its motion, and a stream."""
    return {"model.png": png(_draw_screen), "stream.png": png(_draw_stream, 32)}


if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    for name, content in drawn().items():
        PICTURES.joinpath(name).write_bytes(content)
