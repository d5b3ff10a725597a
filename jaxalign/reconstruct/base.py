"""The contract of the slot, and the choice to leave the vectors as they were measured."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import equinox as eqx

from jaxalign.observe import Context, Pair

__all__ = ["AbstractReconstruct", "Measured"]


class AbstractReconstruct(eqx.Module):
    """Slot: a pair in, a pair out."""

    @abstractmethod
    def init(self) -> Any:
        """State before the first epoch."""

    @abstractmethod
    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Pair]:
        """Consume one pair; where ``pair.valid`` is False the state must not change."""


class Measured(AbstractReconstruct):
    """The pair as measured."""

    def init(self) -> Any:
        """No state."""
        return None

    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Pair]:
        """Pass the pair through."""
        return state, pair
