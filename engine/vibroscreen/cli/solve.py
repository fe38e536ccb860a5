"""`vibroscreen solve`: the steady state of a screen."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterable, Sequence
from itertools import pairwise

from vibroscreen.cli.options import Csv, Json, Plot, ScreenFile, Set, Strict, end, load, one_format
from vibroscreen.cli.solved import (
    described,
    document,
    figure,
    labels_of,
    rests_on,
    rows,
    streams_of,
    two_lines,
)
from vibroscreen.cli.terminal import picture, say, say_json, table
from vibroscreen.config import ScreenConfig
from vibroscreen.screen import Screen
from vibroscreen.sizing_rules import rules_of
from vibroscreen.steady import SteadyResult
from vibroscreen.units import KN, KW, MM, PERCENT, T_H

EXAMPLES = """vibroscreen solve screen.toml
vibroscreen solve screen.toml --set feed.rate_t_h=350 --set motion.frequency_hz=16
vibroscreen solve screen.toml --set 'deck[1].panel[1].aperture_mm=18' --plot screen.png
vibroscreen solve screen.toml --json > screen.json"""


def command(
    screen: ScreenFile,
    changes: Set = None,
    as_json: Json = False,
    as_csv: Csv = False,
    plot: Plot = None,
    strict: Strict = False,
) -> None:
    """Print the steady state of a screen under its duty."""
    one_format(json=as_json, csv=as_csv)
    config = load(screen, changes)
    steady = Screen(config).solve_steady()
    if as_json:
        say_json(document(steady))
    elif as_csv:
        csv.writer(sys.stdout, lineterminator="\n").writerows(rows(steady))
    else:
        _print(config, steady)
    if plot is not None:
        picture(steady.plot(), plot)
    end(steady.alarms, strict=strict)


def _print(config: ScreenConfig, steady: SteadyResult) -> None:
    say(f"{config.name}: {described(config)}", "bold")
    say()
    _print_products(steady)
    _print_decks(steady)
    _print_rules(config, steady)
    say(
        f"Box: drive {figure(steady.drive_power / KW)} kW, exciter "
        f"{figure(steady.exciter_force / KN)} kN, K {figure(steady.acceleration_number, 3)}, "
        f"{figure(steady.hold_up)} kg on the decks"
    )
    for name, reason in steady.alarm_reasons.items():
        say(f"{name}: {reason}", "yellow")
    if not steady.alarms:
        say("No alarms")
    say()
    say(f"Numbers of the model: {rests_on(config)}", "dim")
    for text in config.beyond_calibration():
        say(f"beyond it: {text}", "yellow")


def _print_products(steady: SteadyResult) -> None:
    """Rates and sizes of the products, passing at every limit, rates by class; with totals."""
    streams, classes = streams_of(steady), steady.config.size_classes
    decks, fed = len(steady.decks), steady.feed.mass_flow_rate
    labels = labels_of(decks)
    heads = ["\n" + label if decks == 1 else two_lines(label) for label in labels]
    places = min(max(0, 3 - math.floor(math.log10(fed / T_H))), 6)
    products = [stream for name, stream in streams.items() if name != "feed"]

    def rate(value: float) -> str:
        return f"{value / T_H:.{places}f}"

    total = sum(stream.rate for stream in products)
    lines: list[tuple[str, ...]] = [
        (
            label,
            rate(stream.rate),
            f"{stream.rate / fed / PERCENT:.1f}",
            figure(stream.p80 / MM, 3),
            figure(stream.p50 / MM, 3),
        )
        for label, stream in zip(labels, streams.values(), strict=True)
    ]
    lines.append(("all products", rate(total), f"{total / fed / PERCENT:.1f}", "", ""))
    table("Products", ("", "t/h", "% of feed", "P80 mm", "P50 mm"), lines)
    say()
    edges = [f"{edge / MM:g}" for edge in classes.edges]
    passing = [
        [f"{value / PERCENT:.1f}" if stream.rate > 0.0 else "-" for value in stream.passing]
        for stream in streams.values()
    ]
    lines = list(zip(edges, *passing, strict=True))
    table("Passing, %", ("\nsize mm", *heads), reversed(lines))
    say()
    names = [f"{low} to {high}" for low, high in pairwise(edges)]
    rates = [[rate(part) for part in s.rate * s.fraction] for s in streams.values()]
    recovered = [f"{part / PERCENT:.1f}" for part in steady.recovery]
    lines = list(zip(names, *rates, recovered, strict=True))[::-1]
    under = products[-1].rate / fed / PERCENT
    lines.append(("total", *(rate(s.rate) for s in streams.values()), f"{under:.1f}"))
    table("By class, t/h", ("\nclass mm", *heads, "recovery\n%"), lines)
    say()


DECKS = (
    ("feed_rate", "comes to it, t/h", T_H),
    ("oversize_rate", "leaves over it, t/h", T_H),
    ("undersize_rate", "passes, t/h", T_H),
    ("efficiency", "efficiency: undersize that passes, %", PERCENT),
    ("misplaced_undersize", "undersize in what leaves over it, %", PERCENT),
    ("misplaced_oversize", "oversize in what passes, %", PERCENT),
    ("cut_size", "cut size d50, mm", MM),
    ("ecart_probable", "ecart probable, mm", MM),
    ("depth_feed", "bed at the feed end, mm", MM),
    ("depth_discharge", "bed at the discharge, mm", MM),
    ("depth_over_aperture_discharge", "the same in apertures", 1.0),
    ("transport_velocity", "velocity of the bed, m/s", 1.0),
    ("throw_number", "throw number", 1.0),
    ("hold_up", "lies on it, kg", 1.0),
)


def _by_deck(title: str, decks: int, lines: Iterable[tuple[str, Sequence[str]]]) -> None:
    """A table with a column a deck."""
    heads = [f"deck {k}" for k in range(1, decks + 1)]
    table(title, ("", *heads), [(label, *values) for label, values in lines])
    say()


def _print_decks(steady: SteadyResult) -> None:
    apertures = [f"{deck.aperture / MM:g}" for deck in steady.decks]
    lines = [
        (label, [figure(getattr(deck, name) / unit) for deck in steady.decks])
        for name, label, unit in DECKS
    ]
    _by_deck("Decks", len(apertures), [("aperture, mm", apertures), *lines])


def _print_rules(config: ScreenConfig, steady: SteadyResult) -> None:
    """What VSMA and Karra say, beside the model."""
    rules = rules_of(config)
    lines = [
        ("area, m2", [figure(rule.area) for rule in rules]),
        ("VSMA: area for 95 %, m2", [figure(rule.area_at_95) for rule in rules]),
        ("VSMA: efficiency, %", [vsma_efficiency(rule.vsma_recovery) for rule in rules]),
        ("Karra: efficiency, %", [figure(rule.karra_recovery / PERCENT, 3) for rule in rules]),
        ("this model: efficiency, %", [figure(d.efficiency / PERCENT, 3) for d in steady.decks]),
        ("Karra: cut size d50, mm", [figure(rule.cut_size / MM) for rule in rules]),
        ("this model: cut size d50, mm", [figure(deck.cut_size / MM) for deck in steady.decks]),
    ]
    _by_deck("Sizing rules", len(rules), lines)
    beyond = [f"deck {rule.deck}: {text}" for rule in rules for text in rule.beyond]
    for text in beyond:
        say(text, "dim")
    if beyond:
        say()


def vsma_efficiency(recovery: float) -> str:
    """In per cent; VSMA's table ends at 95 and at 70."""
    if math.isnan(recovery):
        return "< 70"
    return ">= 95" if recovery >= 0.95 else figure(recovery / PERCENT, 3)
