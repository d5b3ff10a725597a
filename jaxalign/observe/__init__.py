"""Slot: epochs to pairs of vectors, one class per kind of aid."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.observe.base import AbstractObserve, Context, Pair
    from jaxalign.observe.body import BodyVelocity
    from jaxalign.observe.nav import NavVelocity
    from jaxalign.observe.static import Static

__all__ = ["AbstractObserve", "BodyVelocity", "Context", "NavVelocity", "Pair", "Static"]

_HOMES = {
    "base": "AbstractObserve Context Pair",
    "body": "BodyVelocity",
    "nav": "NavVelocity",
    "static": "Static",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
