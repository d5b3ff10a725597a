"""Slot: how far to trust a pair."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.weight.base import AbstractWeight, Unit
    from jaxalign.weight.huber import Huber
    from jaxalign.weight.mahalanobis import Mahalanobis

__all__ = ["AbstractWeight", "Huber", "Mahalanobis", "Unit"]

_HOMES = {
    "base": "AbstractWeight Unit",
    "huber": "Huber",
    "mahalanobis": "Mahalanobis",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
