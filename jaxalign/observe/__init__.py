"""Slot: epochs to pairs of vectors, one class per kind of aid."""

from jaxalign.observe.base import AbstractObserve, Context, Pair
from jaxalign.observe.body import BodyVelocity
from jaxalign.observe.nav import NavVelocity
from jaxalign.observe.static import Static

__all__ = ["AbstractObserve", "BodyVelocity", "Context", "NavVelocity", "Pair", "Static"]
