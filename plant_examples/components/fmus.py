"""The units of the closed circuit as FMUs, by the packaging of the screen's."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon

from components.slaves import UNIT_FILE, ConveyorSlave, CrusherSlave, MixerSlave, Unit, UnitSlave
from components.stream import Array
from vibroscreen.units import MM
from vibroscreen_fmu.drawing import COARSE, FINE, STEEL, png
from vibroscreen_fmu.package import Model

__all__ = ["conveyor_model", "crusher_model", "mixer_model"]

STREAMS = (
    "Outputs are means over the last step and change only in a step: no output depends on an input "
    "of the same instant, a loop over the unit is no algebraic loop. Size classes are numbered "
    "from the finest and are those of the screen it was built for."
)


def crusher_model(edges: Array, composition: Array, closed_side_setting: float) -> Model:
    """A cone crusher with a setting in m, for size classes between `edges` m."""
    unit = _unit(edges, composition, closed_side_setting=closed_side_setting)
    return _model(
        "ConeCrusher",
        CrusherSlave,
        unit,
        f"Cone crusher, closed-side setting {closed_side_setting / MM:.6g} mm",
        "Whiten's classification and breakage matrices; power by Bond's third theory. Nothing is "
        "held: what comes in during a step leaves in it.",
        png(_draw_crusher),
    )


def mixer_model(edges: Array, composition: Array, fresh_feed: float, inlets: int = 2) -> Model:
    """A mixer; unless it is connected, its first inlet is fed `fresh_feed` kg/s."""
    unit = _unit(edges, composition, fresh_feed=fresh_feed, inlets=inlets)
    return _model(
        "Mixer",
        MixerSlave,
        unit,
        f"Mixer of {inlets} streams",
        "Streams are added class by class. Nothing is held: what comes in during a step leaves in "
        "it. The start values of the first inlet are a fresh feed.",
        png(_draw_mixer),
    )


def conveyor_model(edges: Array, composition: Array, delay: float) -> Model:
    """A belt on which everything lies for `delay` s."""
    unit = _unit(edges, composition, delay=delay)
    return _model(
        "Conveyor",
        ConveyorSlave,
        unit,
        f"Belt conveyor, {delay:.6g} s",
        "Plug flow: what is loaded leaves in the same order a fixed time later, for any step size.",
        png(_draw_conveyor),
    )


def _unit(edges: Array, composition: Array, **numbers: float) -> Unit:
    return Unit(tuple(edges.tolist()), numbers, tuple(composition.tolist()))


def _model(
    name: str, slave: type[UnitSlave], unit: Unit, description: str, about: str, picture: bytes
) -> Model:
    return Model(
        name=name,
        slave=(slave.__module__, slave.__name__),
        description=description,
        about=(("", (about, STREAMS)),),
        ports=slave.table(unit),
        resources={UNIT_FILE: unit.to_json().encode()},
        picture=picture,
    )


# --- pictures ----------------------------------------------------------------------------------
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
