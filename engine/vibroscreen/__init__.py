"""Vibrating screen: the cell model of Ivanov and Vaisberg, fast and checked (engine/MODEL.md)."""

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
