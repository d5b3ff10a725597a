"""Slot: how far to trust a pair."""

from jaxalign.weight.base import AbstractWeight, Unit
from jaxalign.weight.huber import Huber
from jaxalign.weight.mahalanobis import Mahalanobis

__all__ = ["AbstractWeight", "Huber", "Mahalanobis", "Unit"]
