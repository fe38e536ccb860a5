"""Numbers that neither go with the aperture nor follow the vibration: for tests of equations.

They are written out so that such a test does not depend on what practice makes the defaults.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from vibroscreen import ScreenConfig
from vibroscreen.sections import Bed, Displacement, Passage, Segregation
from vibroscreen.units import MM

FIXED: dict[str, Any] = {
    "displacement": Displacement("rigid_body"),
    "passage": Passage(velocity=0.1),
    "segregation": Segregation(velocity=0.1, dilation=1.0 * MM),
    "bed": Bed(contact_depth=20.0 * MM, layers=16),
}


def fixed_segregation(model: str) -> Segregation:
    """A model of the segregation with these numbers."""
    return dataclasses.replace(FIXED["segregation"], model=model)


def fixed_screen() -> ScreenConfig:
    """The default screen with these numbers."""
    return ScreenConfig.default().replace(**FIXED)
