"""What a user is told when a value cannot be used.

A message names the variable, its value with the unit, what is wrong with it and the cure:
`<variable> = <value with unit> <what is wrong, the limit>: <cure>`.
"""

from __future__ import annotations

from types import TracebackType
from typing import Any

__all__ = ["TEXT", "ConfigError", "Faults", "InputError", "given", "told", "with_unit"]

# What the runtimes of an FMU say, with and without Python: this table is all there is of it. In
# braces stand names of texts, or of numbers with the digits that are shown. {given} is a name, its
# value and its unit, {range} what may be given, in brackets.
TEXT = {
    # of numbers of a configuration, of inputs and of parameters
    "not_finite": "{given} is not a finite number{range}: {cure}",
    "too_small": "{given} is out of range{range}: {cure}",
    "too_large": "{given} is out of range{range}: {cure}",
    "bad_sum": "feed.mass_fraction sums to {value:.6g}, not to 1 within {limit:.6g}: give the mass "
    "fractions of all size classes, or divide each by the sum",
    "too_steep": "{given} ({degrees:.4g} deg, slope {slope:.4g}) is too steep for the friction at "
    "the base ({limit:.4g}), a rigid body would run away: make the deck flatter or use "
    'displacement.model = "bed" or "prescribed"',
    "steep_bed": "{given} ({degrees:.4g} deg, slope {slope:.4g}) is above {limit:.4g}, the "
    "friction of a bed on a base of friction {number:.4g}, up to which the displacement model bed "
    "was checked: take its velocity as a guess, or make the panel flatter",
    "no_velocity": "{name} = {number:.6g} gives a bed velocity of {value:.6g} m/s, which is not "
    "finite: mend the displacement model",
    "no_time": "dt = {value:.6g} s is not a finite positive time: give a step in seconds",
    "long_time": "dt = {value:.6g} s is more than {limit:.6g} s: take shorter steps",
    "no_choice": "{name} = {value:.6g} is none of the choices of this screen: {cure}",
    "two_limits": "{name} = {value:.6g} m differs from the lower limit of the next class "
    "({limit:.6g} m): set both to the same",
    "not_ascending": "{given} is not larger than the limit below it ({limit:.6g} {unit}): list the "
    "limits finest first, and what belongs to them in the same order",
    "no_layer": "{given} leaves the bed without layers: give a depth, or relative_contact_depth in "
    "apertures",
    "short_deck": "{given} is larger than the deck is long ({limit:.6g} {unit}): give the clear "
    "opening of the medium",
    "unequal_decks": "{name}: this deck is {value:.6g} m long, deck[1] is {limit:.6g} m: decks of "
    "one box are equally long, change the lengths of the panels",
    "coarser_below": "{given} is larger than any opening of the deck above ({limit:.6g} {unit}), "
    "here nothing would be screened: list the coarsest deck first, or swap the two",
    "short_slot": "{given} is less than the aperture ({limit:.6g} {unit}): give the long side of "
    "the slots, the aperture is their short one",
    "no_slot": '{given} is given for openings that are no slots: write opening = "slot" or '
    '"slot_across", or leave it out',
    "no_feed": "{given} has no steady separation: give a positive feed",
    "no_conveying": "{given}, {other} do not convey, so there is no steady state: raise them, turn "
    'the throw angle down-slope, or use displacement.model = "prescribed"',
    "body_stays": "{given}, {other} do not convey a rigid body down deck[1].panel[1] "
    "({degrees:.4g} deg, it rides at {value:.3g} m/s), so there is no steady state: use "
    'displacement.model = "bed", grains ride down at {limit:.3g} m/s; or raise them, turn the '
    'throw angle down-slope, or use displacement.model = "prescribed"',
    "no_bed_velocity": "{given} does not convey, so there is no steady state: give the velocity of "
    "the bed",
    "still_panel": "{given} does not convey, and a deck conveys on all of its panels or on none, "
    "so there is no steady state: give a factor above 0",
    "two_velocities": "{given} is given beside passage.velocity_table: give one of them",
    "off_table": "{given} lies outside of passage.velocity_table, which ends at {limit:.6g} "
    "{unit}: add rows to the table or give passage.velocity",
    "little_room": "solver.packages = {value:.6g} is too little room for the {limit:.6g} cells of "
    "a deck: give at least {other_limit:.6g}, or 0 for the engine's choice",
    # of calls of the interface
    "no_variable": "value reference {value:.10g} is no variable of this FMU",
    "other_type": "{name} is of type {kind}: use the functions of that",
    "not_settable": "{name} is not an input or a parameter: it cannot be set",
    "fixed": "{name} is a fixed parameter of a model that runs: set it before initialisation ends, "
    "or reset the instance",
    "no_step": "a step before initialisation has ended or after the end: initialise the instance "
    "(after the end: reset it) and step then",
    "started": "initialisation has ended before: reset the instance to start anew",
    "no_state": "state = {value:.15g} bytes are no state of a {name}: give what one wrote",
    "other_build": "state = {value:.15g} bytes are of another build of the FMU: give a state of "
    "this one",
    "broken_state": "state = {value:.15g} bytes, cut or changed on the way: give them as they were "
    "written",
    "too_long": "{name} got no arrays to read from or write to: give them with as many values",
    "not_offered": "{name} is not offered: see the capabilities in modelDescription.xml",
    "no_tolerance": "{given} is outside of the limits of {other}, which stays {number:.6g}: give "
    "one within {limit:.6g} and {other_limit:.6g}",
    "no_room": "there is no memory for the {value:.15g} bytes of a screen: end other programs",
    "failed": "the engine failed, code {value:.6g}: report it with the inputs of this step",
    # why an alarm is set; the name of the alarm and a colon go before it in a log
    "deep_bed": "the bed of deck {number:.6g} is {value:.4g} m deep at the discharge, more than "
    "{other_limit:.4g} apertures ({limit:.4g} m): feed less, or make the deck wider or its bed "
    "faster",
    "full_layers": "the bed of deck {number:.6g}, {value:.4g} m deep at the feed end, outgrew its "
    "layers, which hold {limit:.4g} m, or its packages: give more bed.layers or solver.packages, "
    "or feed less",
    "not_conveyed": "the vibration does not convey the bed down deck {number:.6g}, which piles up: "
    "turn the throw angle or the sense of rotation, or incline the deck more",
    "beyond_bed": "deck {number:.6g} is inclined by {degrees:.4g} deg (slope {slope:.4g}), more "
    "than the friction of a bed ({limit:.4g}) up to which the displacement model bed was checked: "
    "take its velocity as a guess",
    "high_throw": "the throw number of deck {number:.6g} is {value:.4g}, above {limit:.4g}, up to "
    "which the displacement model bed was checked: take its velocity as a guess",
    "unchecked_motion": "the displacement model was not checked for the motion of deck "
    "{number:.6g} (throw number {value:.4g}): take its velocity as a guess",
    "nothing_fed": "nothing finer than its aperture of {limit:.4g} m came to deck {number:.6g} in "
    "the last step: its efficiency is that of an earlier one",
    "no_crossing": "the partition of deck {number:.6g} does not cross a quarter, a half and three "
    "quarters: its cut size ({value:.4g} m) or ecart probable stands on an end of its sizes",
    "implausible_depth": "the bed of deck {number:.6g} is {value:.4g} m deep, more than "
    "{limit:.4g} m: check the feed rate, the width and the bed velocity",
    "implausible_velocity": "the bed of deck {number:.6g} rides at {value:.4g} m/s, faster than "
    "{limit:.4g} m/s: check the inclination, the motion and the friction",
    "hidden_opening": "bars of {limit:.4g} m hide the openings of {value:.4g} m on deck "
    "{number:.6g} from falling grains on its slope: make the panel flatter, or give the thickness "
    "of thinner bars",
    "implausible_motion": "K = {value:.4g} (amplitude x angular frequency^2 over gravity) is above "
    "{limit:.4g}: check the frequency, and that the amplitude is half the stroke",
    "state_size": "state = {value:.15g} bytes is not a state of this screen ({limit:.15g} bytes): "
    "give one that the same configuration wrote",
}


def given(name: str, value: float, unit: str = "") -> str:
    """A variable with its value and unit."""
    return f"{name} = {with_unit(value, unit)}"


def with_unit(value: float, unit: str) -> str:
    """A number with its unit, "" or "1" for none."""
    return f"{value:.6g} {unit}" if unit not in ("", "1") else f"{value:.6g}"


def told(text: str, **values: Any) -> str:
    """The text of that key with its values."""
    return TEXT[text].format(**values)


class ConfigError(ValueError):
    """A configuration that describes no screen: an unknown key, a wrong type, a value out of range.

    Every message starts with the key or the variable as the user writes it. `errors` holds all that
    is wrong, a message each; the text is a line of each.
    """

    def __init__(self, *errors: str) -> None:
        super().__init__("\n".join(errors))
        self.errors = errors


class InputError(ValueError):
    """A value given at run time that cannot be used, such as a negative feed rate.

    The message starts with the variable; `variable` holds its exact name, such as
    `feed.mass_fraction[3]`, and is read from the message unless it is given.
    """

    def __init__(self, message: str, variable: str | None = None) -> None:
        super().__init__(message)
        self.variable: str = variable or message.partition(" ")[0]

    @property
    def errors(self) -> tuple[str, ...]:
        """The message, as of a ConfigError."""
        return (str(self),)


class Faults(list[str]):
    """What is wrong with a configuration, to be told at once: `with faults:` around every part."""

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if not isinstance(error, ConfigError | InputError):
            return False
        self.extend(error.errors)
        return True

    def tell(self) -> None:
        """Raise ConfigError of all, if there are any."""
        if self:
            raise ConfigError(*self) from None
