"""Vibrating screen: the cell model of Ivanov and Vaisberg, fast and checked (engine/MODEL.md)."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vibroscreen.config import ScreenConfig
    from vibroscreen.errors import ConfigError, InputError
    from vibroscreen.motion import Harmonic, Motion, conveying_regime, transport_velocity
    from vibroscreen.probability import gaudin_probability, packing_gap, pelevin_probability
    from vibroscreen.registry import register
    from vibroscreen.results import DeckResult, StepResult
    from vibroscreen.screen import Screen
    from vibroscreen.steady import Profile, SteadyResult
    from vibroscreen.stream import Feed, Stream
    from vibroscreen.sweep import SteadyTable, solve_steady_many

__version__ = "0.4.0"

__all__ = [
    "ConfigError",
    "DeckResult",
    "Feed",
    "Harmonic",
    "InputError",
    "Motion",
    "Profile",
    "Screen",
    "ScreenConfig",
    "SteadyResult",
    "SteadyTable",
    "StepResult",
    "Stream",
    "conveying_regime",
    "gaudin_probability",
    "packing_gap",
    "pelevin_probability",
    "register",
    "solve_steady_many",
    "transport_velocity",
]

# Where public names are: the engine is loaded when one is asked for, so that help is told at once.
_HOME = {
    "config": "ScreenConfig",
    "errors": "ConfigError InputError",
    "motion": "Harmonic Motion conveying_regime transport_velocity",
    "probability": "gaudin_probability packing_gap pelevin_probability",
    "registry": "register",
    "results": "DeckResult StepResult",
    "screen": "Screen",
    "steady": "Profile SteadyResult",
    "stream": "Feed Stream",
    "sweep": "SteadyTable solve_steady_many",
}
_MODULE = {name: module for module, names in _HOME.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """A public name, or a module that has some, when it is first asked for."""
    if name in _HOME:
        return import_module(f"{__name__}.{name}")
    if name not in _MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(f"{__name__}.{_MODULE[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
