"""What a user is told when a value cannot be used.

A message names the variable, its value with the unit, what is wrong with it and the cure:
`<variable> = <value with unit> <what is wrong, the limit>: <cure>`.
"""

from __future__ import annotations

__all__ = ["ConfigError", "InputError"]


class ConfigError(ValueError):
    """A configuration that describes no screen: an unknown key, a wrong type, a value out of range.

    The message starts with the key or the variable as the user writes it.
    """


class InputError(ValueError):
    """A value given at run time that cannot be used, such as a negative feed rate.

    The message starts with the variable; `variable` holds its exact name, such as
    `feed.mass_fraction[3]`, and is read from the message unless it is given.
    """

    def __init__(self, message: str, variable: str | None = None) -> None:
        super().__init__(message)
        self.variable: str = variable or message.partition(" ")[0]
