"""Which slot an aid feeds."""

from __future__ import annotations

from typing import Any

from jaxalign.aids import AbstractAid
from jaxalign.observe.base import AbstractObserve
from jaxalign.observe.body_velocity import BodyVelocityVectors
from jaxalign.observe.gravity import GravityVectors
from jaxalign.observe.nav_velocity import NavVelocityVectors

__all__ = ["OBSERVERS", "observer"]

OBSERVERS: dict[type[AbstractAid], type[AbstractObserve]] = {
    type(slot.aid): slot for slot in (BodyVelocityVectors, NavVelocityVectors, GravityVectors)
}
"""The slot that each kind of aid feeds, if any."""


def observer(aid: AbstractAid, **options: Any) -> AbstractObserve:
    """The observation slot that an aid feeds, with its options."""
    return OBSERVERS[type(aid)](aid=aid, **options)
