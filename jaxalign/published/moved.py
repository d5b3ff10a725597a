"""Options that have moved to this room: what to write in their place, for old method files and commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxalign.errors import UserError
from jaxalign.parametrization import parameters

__all__ = ["check_moved"]

_OPTIONS = {
    "observe.coriolis": "the Coriolis term is in closed form; by recursion, as published: oba_as_published",
    "observe.transport_rate": "n turns over the Earth with the vehicle; neglected, as published: oba_as_published",
    "reconstruct.as_published": "the printed filter is the method rkf_oba_as_published",
}
_VALUES = {
    ("quaternion_kf", "estimate.measurement_noise"): ("full",),
    ("rls_quaternion_kf", "estimate.measurement_noise"): ("full",),
    ("dual_vector", "vectors"): ("halves", "ends", "rls"),
}


def check_moved(name: str, method: Any, values: Mapping[str, Any]) -> None:
    """Refuse options that a method no longer has.

    Args:
        name: of the recipe.
        method: made by it.
        values: path -> value to set.

    Raises:
        UserError: says what to write instead.
    """
    for path, value in values.items():
        if path in _OPTIONS and path not in parameters(method):
            raise UserError(f"{path} is no option of {name} any more, leave it out: {_OPTIONS[path]}")
        if isinstance(value, str) and value in _VALUES.get((name, path), ()):
            raise UserError(f"{path} = {value!r} is no option of {name} any more: take {name}_as_published")
