"""What fills the page of a screen, which a browser opens by itself.

The page is `page.html.j2` (what there is to see), `page.js` (what it does) and what they need: the
engine, a screen as it lies in its memory, what is said of every number, and empty pictures of
Bokeh, whose script comes with its package. Nothing is fetched when a page is opened.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import vibroscreen
from vibroscreen import figures, keys
from vibroscreen.compiler.library import WEB
from vibroscreen.config import ScreenConfig
from vibroscreen.errors import TEXT, ConfigError
from vibroscreen.fields import FAR, Number, entries, from_si, write_table
from vibroscreen.figures import Figure
from vibroscreen.kernels import entry, library, state
from vibroscreen.report.page import visible
from vibroscreen.screen import check_supported, fill, roomy_layout, settings_of
from vibroscreen.steady import PROFILE_POINTS
from vibroscreen.units import KN, KW, MM, PERCENT, T_H
from vibroscreen.variables import Variable

__all__ = ["page_of", "write_page"]

FOLDER = Path(__file__).parent
NEEDS = "a page needs {}, which is not installed: pip install 'vibroscreen[explore]'"
# What people see of a unit: factor to SI, name. Shares by name.
SEEN = {"m": (MM, "mm"), "kg/s": (T_H, "t/h"), "W": (KW, "kW"), "N": (KN, "kN"), "1": (1.0, "")}
SHARES = ("efficiency", "misplaced_undersize", "misplaced_oversize")
# Figures of the box that no deck says.
OF_BOX = ("hold_up", "drive_power", "exciter_force", "acceleration_number")
# Numbers of a panel that stay as they are: its place, and a factor that is measured.
STILL = ("length", "velocity_factor")
# Colours that people with any sight tell apart (Okabe and Ito), a deck or a product each.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9")
FED, KEPT = "#222222", "#8a8a8a"
HEIGHT = 260  # of a picture, px
TICKS = [k * 10.0**power for power in range(-3, 4) for k in (1, 2, 5)]  # mm, of sizes
MAP_ROWS = 40  # of the map of the bed, over its height
# Fields that the page reads or writes, in both buffers.
FIELDS = (
    *("parameter", "width", "panel", "input", "fraction", "output", "undersize_fraction"),
    *("oversize_fraction", "intermediate", "intermediate_fraction", "deck_result", "alarm"),
    *(
        "size",
        "step_mass",
        "feed_fraction",
        "scene",
        "lead",
        "lead_passed",
        "column_time",
        "refusal",
    ),
)
COMMANDS: tuple[str, ...] = (
    "INITIALISE",
    "ADVANCE",
    "START_SLICE",
    "START_BELOW",
    "FOLLOW",
    "SOLVE",
    "READ",
)
COMMANDS += ("READ_BED",)


def write_page(config: ScreenConfig, path: str | Path) -> Path:
    """Write the page of a screen. Raises as `page_of`, and OSError."""
    path = Path(path)
    path.write_text(page_of(config), encoding="utf-8")
    return path


def page_of(config: ScreenConfig) -> str:
    """The page of a screen (HTML).

    Raises ConfigError for a screen that the engine cannot run or that needs Python, ImportError
    without Bokeh.
    """
    try:
        from bokeh.resources import Resources
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ImportError as error:
        raise ImportError(NEEDS.format((error.name or "bokeh").partition(".")[0])) from None
    check_supported(config)
    screen = _screen(config)
    engine = library.library(WEB)
    if engine is None:
        raise ConfigError(
            "the page needs the engine as WebAssembly, which a wheel of vibroscreen brings and "
            "ziglang makes: pip install ziglang"
        )
    screen["engine"] = _packed(engine.read_bytes())
    pictures = _pictures(config)
    environment = Environment(
        loader=FileSystemLoader(FOLDER), autoescape=True, undefined=StrictUndefined
    )
    return environment.get_template("page.html.j2").render(
        name=visible(config.name),
        version=vibroscreen.__version__,
        groups=_groups(screen["controls"]),
        edges=[from_si(edge, MM) for edge in config.size_classes.edges],
        decks=len(config.decks),
        keys=_keys(config),
        screen=_json(screen),
        pictures=_json(pictures),
        bokeh=Resources(mode="inline", components=["bokeh"]).js_raw,
        script=FOLDER.joinpath("page.js").read_text(encoding="utf-8"),
    )


def _json(value: Any) -> str:
    """JSON that no tag of a page can end."""
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


def _packed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, mtime=0)).decode()


# --- the screen, for the engine ------------------------------------------------------------------
def _screen(config: ScreenConfig) -> dict[str, Any]:
    """All that the script knows of a screen."""
    tree = write_table(config)
    if tree["motion"]["kind"] == "circular":  # as an ellipse, whose angle can be turned
        motion = config.motion
        shape = {"throw_angle": motion.throw_angle, "ellipticity": motion.ellipticity}
        del tree["motion"]["sense"]
        tree["motion"] |= {"kind": "elliptical"} | {
            entries(type(motion))[name].key: entries(type(motion))[name].write(value)
            for name, value in shape.items()
        }
    numbers = settings_of(config)
    with keys.reading(ScreenConfig, tree):
        settings = [number and _setting(number) for number in numbers]
    return {
        "tree": tree,
        "settings": settings,
        "controls": [
            _control(config, tree, place, number)
            for place, number in enumerate(numbers)
            if number and _is_control(config, tree, number)
        ],
        "lengths": [[panel.length for panel in deck.panels] for deck in config.decks],
        "edges": list(config.size_classes.edges),
        "fractions": list(config.feed.mass_fraction),
        "table": list(zip(*(config.passage.velocity_table or ()), strict=True)),
        "steady": _buffer(config, packages=False),
        "running": _buffer(config, packages=True),
        "commands": {name: getattr(entry, name) for name in COMMANDS},
        "records": {name: list(state.KINDS[name]) for name in FIELDS if name in state.KINDS},
        "refused": list(state.REFUSED),
        "reasons": list(state.REASONS),
        "alarms": [alarm.name for alarm in figures.ALARMS],
        "texts": {key: TEXT[key] for key in (*state.REFUSED, *state.REASONS)},
        "far": FAR,
        "points": PROFILE_POINTS,
        "unit": {"rate": T_H},
        "lines": {name: [of for of, _ in lines] for name, lines in _keys(config).items()},
        "rows": [_row(figure) for figure in sorted(figures.DECK, key=_is_of_bed)],
        "box": [_row(figure) for figure in figures.BOX if figure.scalar in OF_BOX],
    }


def _buffer(config: ScreenConfig, *, packages: bool) -> dict[str, Any]:
    """A buffer with a screen in it: what is not zero comes first, and is packed."""
    layout = roomy_layout(config, packages=packages)
    for family in ("displacement", "passage", "segregation"):
        if layout.dimension[f"{family}_address"]:
            section = getattr(config, family)
            model = section.law if family == "passage" else section.model
            raise ConfigError(
                f"{family} = {model!r} is a sub-model of one's own, which needs Python: a page "
                "holds those that are built in, choose one of them"
            )
    buffer = layout.buffer()
    fill(layout, buffer, config)
    section, seen = layout.section, layout.span["last_seen"]
    spans = {
        "settings": slice(section["parameters"].start, section["inputs"].stop),
        "outputs": section["outputs"],
        "state": section["state"],
        "seen": seen,
    }
    return {
        "size": layout.size,
        "at": {name: layout.offset[name] for name in FIELDS},
        "dimension": list(state.DIMENSION),
        "head": _packed(buffer[: section["constants"].stop].tobytes()),
        **{name: [span.start, span.stop] for name, span in spans.items()},
    }


# --- numbers that can be changed -----------------------------------------------------------------
def _setting(number: Variable) -> dict[str, Any]:
    """What messages say of a number, as those about a file do."""
    entry = number.entry
    name = f"{number.section}.{entry.called(number.field)}" if number.section else entry.key
    if "[" in number.field or not isinstance(entry, Number):
        name = number.name
    if not isinstance(entry, Number):
        return {"name": name, "factor": 1.0, "unit": "1", "range": "", "cure": "", "others": []}
    factor, unit = entry.spoken
    scale = factor / entry.written.factor
    least, most = entry.limits
    return {
        "name": name,
        "factor": factor,
        "unit": unit,
        "range": entry.range,
        "cure": entry.plain_cure,
        "least": least if math.isfinite(least) else -1e308,
        "most": most if math.isfinite(most) else 1e308,
        "others": [
            {"factor": other.factor * scale, "question": entry.question(other)}
            for other in entry.other_units
        ],
    }


def _keys_of(number: Variable) -> list[str | int]:
    """Where a number stands in the tree of a TOML file."""
    found: list[str | int] = []
    kind: Any = ScreenConfig
    for step in number.path:
        if isinstance(step, int):
            found.append(step)
            continue
        entry = entries(kind)[step]
        found.append(entry.key)
        kind = getattr(entry, "kind", None)
    return found


def _value(tree: Mapping[str, Any], where: Sequence[str | int]) -> Any:
    """What stands there in the tree of a TOML file; None where a key is left out."""
    value: Any = tree
    for step in where:
        value = value.get(step) if isinstance(value, Mapping) else value[step]
    return value


def _is_control(config: ScreenConfig, tree: Mapping[str, Any], number: Variable) -> bool:
    """Whether people may change a number on the page: the duty, the vibration, the panels."""
    if not isinstance(number.entry, Number) or number.whole:
        return False
    if number.section == "motion":
        return number.entry.key in tree["motion"]
    if number.name == "displacement.velocity":
        return config.displacement.model == "prescribed"
    if number.path[0] == "decks":
        if "panels" not in number.path or number.field in STILL:
            return False
        # A key that is left out is worked out; a length of slots is 0 where there are none.
        value = _value(tree, _keys_of(number))
        return value is not None and (value > 0.0 or number.field != "slot_length")
    return number.name == "feed.mass_flow_rate"


def _control(
    config: ScreenConfig, tree: Mapping[str, Any], place: int, number: Variable
) -> dict[str, Any]:
    """A slider and a field: what they are called and how far the slider goes."""
    entry = number.entry
    assert isinstance(entry, Number)
    where = _keys_of(number)
    value = _value(tree, where)
    low, high, step_of = _reach(entry, float(value))
    words = keys.split(entry.key)[0] if entry.written.text != "1" else entry.key
    return {
        "place": place,
        "where": where,
        "group": _group(config, number),
        "label": words.replace("_", " "),
        "unit": "" if entry.unit == "1" else entry.written.text,
        "tells": entry.tells,
        "value": value,
        "low": low,
        "high": high,
        "step": step_of,
        "live": entry.variability != "fixed",
    }


def _group(config: ScreenConfig, number: Variable) -> str:
    """Under which heading a number stands."""
    if number.path[0] != "decks":
        return "Feed" if number.section == "feed" else "Vibration"
    deck, panel = int(number.path[1]), int(number.path[3])
    one = len(config.decks[deck].panels) == 1
    length = config.decks[deck].panels[panel].length
    where = f"Deck {deck + 1}" if one else f"Deck {deck + 1}, panel {panel + 1}"
    return f"{where}, {length:g} m"


def _reach(entry: Number, value: float) -> tuple[float, float, float]:
    """How far a slider goes about a value, and its step, in the unit of the key."""
    least, most = (from_si(limit, entry.factor) for limit in entry.limits)
    if math.isfinite(least + most) and most - least <= 2.0:
        low, high = least, most
    elif least < 0.0:
        far = (most - least) / 6.0 if math.isfinite(most) else 2.0 * abs(value)
        low, high = value - far, value + far
    else:
        low, high = least, 2.0 * value or min(most, 1.0)
    low, high = max(low, least), min(high, most)
    decade = 10.0 ** math.floor(math.log10((high - low) / 100.0))
    step = next(k * decade for k in (1.0, 2.0, 5.0, 10.0) if (high - low) / (k * decade) <= 300.0)
    digits = max(0, -math.floor(math.log10(step)))
    low, high = math.ceil(low / step - 1e-9) * step, math.floor(high / step + 1e-9) * step
    return round(low, digits), round(high, digits), round(step, digits)


def _groups(controls: list[dict[str, Any]]) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """Controls by heading, each with its number."""
    found: dict[str, list[tuple[int, dict[str, Any]]]] = {"Feed": [], "Vibration": []}
    for number, control in enumerate(controls):
        found.setdefault(control["group"], []).append((number, control))
    return found


# --- what people see -----------------------------------------------------------------------------
def _row(figure: Figure) -> dict[str, Any]:
    """A figure of a table: where it is found, and how it is shown."""
    factor, unit = SEEN.get(figure.unit, (1.0, figure.unit))
    if figure.scalar in SHARES:
        factor, unit = PERCENT, "%"
    tells = figure.tells.replace(" of deck {}", "").replace(" on deck {}", "")
    return {
        "scalar": figure.scalar,
        "label": figure.scalar.replace("_", " "),
        "unit": unit,
        "factor": factor,
        "tells": tells.replace("deck {}", "the deck"),
    }


def _is_of_bed(figure: Figure) -> bool:
    """Whether a figure of a deck says how the bed lies and moves, not how it is separated."""
    return not figure.name.startswith("performance")


def _products(config: ScreenConfig) -> list[str]:
    """What leaves the box, from the finest on."""
    decks = len(config.decks)
    between = [f"over deck {deck}" for deck in range(decks, 1, -1)]
    return ["undersize", *between, "oversize"]


def _keys(config: ScreenConfig) -> dict[str, list[tuple[str, str]]]:
    """Colours of the lines of each picture, by what they are of."""
    of_decks = [f"deck {k}" for k in range(1, len(config.decks) + 1)]
    decks = list(zip(of_decks, COLOURS, strict=False))
    products = [("feed", FED), *zip(_products(config), COLOURS, strict=False)]
    return {
        "partition": decks,
        "gradation": products,
        "recovery": decks,
        "bed": decks,
        "time": products,
        "map": [],
    }


def _pictures(config: ScreenConfig) -> dict[str, Any]:
    """Empty pictures of Bokeh by name, as JSON; the script fills their sources."""
    from bokeh.embed import json_item
    from bokeh.models import BasicTickFormatter, FixedTicker

    edges = [edge / MM for edge in config.size_classes.edges if edge > 0.0]
    sizes = {"x_range": (0.5 * edges[0], edges[-1]), "x_axis_type": "log"}
    length = config.decks[0].length
    along = {"x_range": (0.0, length)}
    share = {"y_range": (0.0, 100.0)}
    pictures = {
        "partition": _picture("size, mm", "to the oversize, %", **sizes, **share),
        "gradation": _picture("size, mm", "passing, %", **sizes, **share),
        "recovery": _picture("place along the deck, m", "undersize passed, %", **along, **share),
        "bed": _picture("place along the deck, m", "depth, mm", **along, name="bed"),
        "time": _picture("time, s", "t/h", x_range=(0.0, 10.0), name="time"),
    }
    for name, series in _keys(config).items():
        for title, colour in series:
            _add_line(pictures[name], f"{name}: {title}, kept", line_color=colour, line_dash="4 4")
            _add_line(pictures[name], f"{name}: {title}", line_color=colour, line_width=2)
    for name in ("partition", "gradation"):
        pictures[name].xaxis.ticker = FixedTicker(ticks=TICKS)
        pictures[name].xaxis.formatter = BasicTickFormatter()
    pictures["map"] = _map(length)
    return {name: json_item(picture) for name, picture in pictures.items()}


def _picture(x: str, y: str, **about: Any) -> Any:
    """An empty picture with its axes named; unless told, the script says how high it is."""
    from bokeh.plotting import figure

    about = {"y_range": (0.0, 1.0), **about}
    made = figure(
        height=HEIGHT,
        sizing_mode="stretch_width",
        toolbar_location=None,
        tools="",
        x_axis_label=x,
        y_axis_label=y,
        **about,
    )
    # Each of these costs time whenever a slider moves.
    made.axis.minor_tick_line_color = None
    made.outline_line_color = None
    made.axis.axis_label_text_font_style = "normal"
    return made


def _add_line(picture: Any, name: str, **look: Any) -> None:
    from bokeh.models import ColumnDataSource

    picture.line("x", "y", source=ColumnDataSource({"x": [], "y": []}, name=name), **look)


def _map(length: float) -> Any:
    """The bed along a deck, coloured by the share of a size in it."""
    import numpy as np
    from bokeh.models import ColorBar, ColumnDataSource, LinearColorMapper
    from bokeh.palettes import Cividis256

    along = {"x_range": (0.0, length), "name": "map"}
    picture = _picture("place along the deck, m", "height, mm", **along)
    shares = np.zeros((MAP_ROWS, PROFILE_POINTS), dtype=np.float32)
    source = ColumnDataSource({"image": [shares], "dh": [1.0]}, name="map: bed")
    colours = LinearColorMapper(Cividis256, low=0.0, high=100.0, nan_color="rgba(0,0,0,0)")
    picture.image("image", x=0.0, y=0.0, dw=length, dh="dh", source=source, color_mapper=colours)
    picture.add_layout(ColorBar(color_mapper=colours, width=12, title="%"), "right")
    return picture
