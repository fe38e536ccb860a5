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
    from vibroscreen import registry

    kept = {family: dict(models) for family, models in registry._models.items()}
    yield
    for family, models in kept.items():
        registry._models[family].clear()
        registry._models[family].update(models)


# Files that take minutes: they start first, so that no core waits for them at the end.
LONGEST = (
    "test_native.py",
    "test_hostile.py",
    "test_masters.py",
    "test_page.py",
    "test_dem_calibration.py",
    "test_library.py",
    "test_benchmarks.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of the longest files first; the order of all others stays."""
    rank = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(LONGEST)))
