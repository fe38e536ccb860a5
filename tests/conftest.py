"""What all tests share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import settings

# No folder of examples beside the sources.
settings.register_profile("vibroscreen", database=None)
settings.load_profile("vibroscreen")


@pytest.fixture(scope="module", autouse=True)
def _own_sub_models_stay_in_their_module() -> Iterator[None]:
    """Sub-models that the tests of a module register are forgotten after it."""
    from vibroscreen.kernels import registry

    kept = {family: dict(models) for family, models in registry._models.items()}
    yield
    for family, models in kept.items():
        registry._models[family].clear()
        registry._models[family].update(models)
