"""Names of the sub-models: built in, and a user's own.

A built-in model is called directly, by its number. A user's own is one function of the documented
signature (engine/MODEL.md, "Your own sub-model"); kernels call it through its address.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from vibroscreen.compiler.language import PLAIN_MODELS
from vibroscreen.compiler.library import Plain
from vibroscreen.kernels import library

# The number of a model is its place here, from 1 (an FMI enumeration).
BUILT_IN = {
    "displacement": ("prescribed", "rigid_body", "bed"),
    "passage": ("gaudin", "pelevin", "bounce"),
    "segregation": ("well_mixed", "proportional", "exchange", "classified"),
}
# Sub-models of one's own by the address of their code, kept for the life of the process.
_own: dict[int, Any] = {}


@dataclass(frozen=True)
class SubModel:
    """A registered sub-model: its number, whether it needs layers, and where its code lies."""

    number: int
    layered: bool = False
    address: int = 0


_models: dict[str, dict[str, SubModel]] = {
    family: {
        name: SubModel(number, layered=name == "exchange")
        for number, name in enumerate(built_in, start=1)
    }
    for family, built_in in BUILT_IN.items()
}


def register(
    family: str, name: str, function: Callable[..., None], *, layered: bool = False
) -> None:
    """Make a user's own sub-model known by name.

    `family` is "displacement", "passage" or "segregation"; `function` is an njit function or the
    plain function that it would compile. `layered` says that a segregation model works on layers;
    without it the bed is one vector a package. Raises ValueError for an unknown family or a name
    that a built-in model has.
    """
    if family not in BUILT_IN:
        raise ValueError(f"family = {family!r} is unknown: give one of {', '.join(BUILT_IN)}")
    if name in BUILT_IN[family]:
        raise ValueError(f"name = {name!r} is a built-in {family} model: choose another name")
    known = _models[family]
    number = known[name].number if name in known else len(known) + 1
    address = _address_of(function, family)
    known[name] = SubModel(number, layered, address)


def names(family: str) -> tuple[str, ...]:
    """Names of the known models of a family, in the order of their numbers."""
    return tuple(_models[family])


def model(family: str, name: str) -> SubModel:
    """The sub-model of that name."""
    return _models[family][name]


def _address_of(function: Callable[..., None], family: str) -> int:
    """Address of a sub-model's code; a number that stands for it where kernels run as Python."""
    plain = getattr(function, "py_func", function)
    if isinstance(library.engine(), Plain):
        PLAIN_MODELS[id(plain)] = plain
        return id(plain)
    from vibroscreen.compiler import whole  # numba, for who brings a sub-model

    library.KERNELS.load()
    made = whole.compiled_model(function, family)
    _own[made.address] = made
    return int(made.address)


def compiled_at(address: int) -> Any:
    """The compiled sub-model whose code lies at an address of `model`."""
    return _own[address]
