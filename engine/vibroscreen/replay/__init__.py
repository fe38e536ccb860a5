"""From a historian's export to a screen that goes through it."""

from vibroscreen.replay.plant import GAPS, PlantData, Source, read_plant
from vibroscreen.replay.quality import Finding, Limits
from vibroscreen.replay.run import Engine, replay
from vibroscreen.replay.summary import Compared, Summary
from vibroscreen.replay.track import Track, track
from vibroscreen.replay.write import table_file

__all__ = [
    "GAPS",
    "Compared",
    "Engine",
    "Finding",
    "Limits",
    "PlantData",
    "Source",
    "Summary",
    "Track",
    "read_plant",
    "replay",
    "table_file",
    "track",
]
