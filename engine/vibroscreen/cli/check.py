"""`vibroscreen check`: what is wrong with the file of a screen, then what is unusual."""

from __future__ import annotations

from vibroscreen.cli.options import Json, ScreenFile, Set, Strict, end, load
from vibroscreen.cli.solved import calibration, described, rests_on
from vibroscreen.cli.terminal import say, say_json, table
from vibroscreen.practice import AMBER, GREEN, RED, findings, worst
from vibroscreen.screen import Screen

EXAMPLES = """vibroscreen check screen.toml
vibroscreen check screen.toml --set feed.rate_t_h=350
vibroscreen check screen.toml --strict && vibroscreen build screen.toml"""

# What is said of a level, and its colour.
WORDS = {GREEN: ("good", "green"), AMBER: ("look", "yellow"), RED: ("bad", "red")}
SUMMARY = {
    GREEN: "All is as plants find good.",
    AMBER: "Nothing is bad; look at what is unusual.",
    RED: "Something is bad: see what to change.",
}


def command(
    screen: ScreenFile, changes: Set = None, as_json: Json = False, strict: Strict = False
) -> None:
    """Tell what is wrong or unusual about a screen and its duty."""
    config = load(screen, changes)
    steady = Screen(config).solve_steady()
    found = findings(steady)
    if as_json:
        say_json(
            {
                "name": config.name,
                "level": worst(found),
                "findings": [vars(finding) for finding in found],
                "calibration": calibration(config),
                "alarms": list(steady.alarms),
            }
        )
    else:
        say(f"No errors. {config.name}: {described(config)}", "bold")
        say()
        rows = [(*WORDS[one.level][:1], one.subject, one.reason) for one in found]
        colours = [WORDS[one.level][1] for one in found]
        table("", ("", "", ""), rows, left=3, colours=colours)
        if config.beyond_calibration():
            say()
            say(f"The numbers of the model: {rests_on(config)}", "dim")
        say()
        say(SUMMARY[worst(found)], WORDS[worst(found)][1])
    end(steady.alarms, strict=strict)
