"""Slot: epochs to pairs of vectors, one class per kind of aid."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.observe.base import AbstractObserve, Context, Pair
    from jaxalign.observe.body_velocity import BodyVelocityVectors
    from jaxalign.observe.choice import OBSERVERS, observer
    from jaxalign.observe.gravity import GravityVectors
    from jaxalign.observe.nav_velocity import NavVelocityVectors

__all__ = [
    "OBSERVERS",
    "AbstractObserve",
    "BodyVelocityVectors",
    "Context",
    "GravityVectors",
    "NavVelocityVectors",
    "Pair",
    "observer",
]

_HOMES = {
    "base": "AbstractObserve Context Pair",
    "body_velocity": "BodyVelocityVectors",
    "choice": "OBSERVERS observer",
    "nav_velocity": "NavVelocityVectors",
    "gravity": "GravityVectors",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
