"""What an aid should measure, and its slopes by the errors of the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from jaxalign.vector import Vec3

__all__ = ["Linearized"]


class Linearized(NamedTuple):
    """What an aid should measure, and how that depends on the errors of the motion; an entry for each component.

    Attributes:
        predicted: in the unit of the aid.
        tilt: rows of the slope by the tilt (rad, n), or None where it does not matter.
        velocity: rows of the slope by the velocity (m/s, n), or None.
        unknowns: name -> for each component the slopes by the numbers of the unknown.
    """

    predicted: tuple[Any, ...]
    tilt: tuple[Vec3, ...] | None
    velocity: tuple[Vec3, ...] | None
    unknowns: dict[str, tuple[tuple[Any, ...], ...]]
