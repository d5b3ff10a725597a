"""Slot: how far to trust a pair."""

from jaxalign.weight.base import AbstractWeight, Unit

__all__ = ["AbstractWeight", "Unit"]
