"""`vibroscreen solve`: the steady state of a screen."""

from __future__ import annotations

from vibroscreen.cli.options import Plot, ScreenFile
from vibroscreen.cli.terminal import say, table, tell
from vibroscreen.config import ScreenConfig
from vibroscreen.screen import Screen
from vibroscreen.steady import SteadyResult
from vibroscreen.units import KN, KW, MM, T_H

EXAMPLES = "vibroscreen solve screen.toml"


def command(screen: ScreenFile, plot: Plot = None) -> None:
    """Print the steady state of a screen under its duty."""
    steady = Screen(ScreenConfig.load(screen)).solve_steady()
    _print_products(steady)
    for deck in steady.decks:
        say(
            f"deck {deck.deck}, {deck.aperture / MM:g} mm: efficiency {deck.efficiency:.4f}, "
            f"misplaced undersize {deck.misplaced_undersize:.4f}, cut size "
            f"{deck.cut_size / MM:.4g} mm, ecart probable {deck.ecart_probable / MM:.3g} mm, "
            f"bed {deck.depth_feed / MM:.3g} to {deck.depth_discharge / MM:.3g} mm"
        )
    say(
        f"box: hold-up {steady.hold_up:.4g} kg, drive {steady.drive_power / KW:.3g} kW, "
        f"exciter {steady.exciter_force / KN:.4g} kN, K {steady.acceleration_number:.3g}, "
        f"P80 of the undersize {steady.undersize_p80 / MM:.4g} mm"
    )
    for name, reason in steady.alarm_reasons.items():
        say(f"{name}: {reason}", "yellow")
    if plot is not None:
        steady.plot().savefig(plot)
        tell(f"written: {plot}")


def _print_products(steady: SteadyResult) -> None:
    """A row a class: limits, rates of all streams, recovery."""
    classes = steady.config.size_classes
    streams = {
        "feed": steady.feed.class_rates,
        "undersize": steady.undersize.class_rates,
        **{
            f"intermediate {k}": stream.class_rates
            for k, stream in enumerate(steady.intermediate, start=1)
        },
        "oversize": steady.oversize.class_rates,
    }
    rows = [
        (
            f"{low / MM:g} to {high / MM:g}",
            *(f"{rates[k] / T_H:.1f}" for rates in streams.values()),
            f"{steady.recovery[k]:.4f}",
        )
        for k, (low, high) in enumerate(zip(classes.lower, classes.upper, strict=True))
    ]
    table("Steady state, t/h", ("class, mm", *streams, "recovery"), rows)
