"""The contract of the slot, and the choice to leave the vectors as they were measured."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx

from jaxalign.observe import AbstractObserve, Context, Pair

__all__ = ["AbstractReconstruct", "Identity"]


class AbstractReconstruct(eqx.Module):
    """Slot: a pair in, a pair out."""

    keeps_displacement: ClassVar[bool] = True
    """Whether the pair that comes out still has its ``displacement``; else beta stands as the last attitude made it."""
    fits: ClassVar[bool] = True
    """Whether the pair that comes out was fitted: its residual then hides outliers and biases."""

    def check(self, observe: AbstractObserve) -> None:
        """Refuse an observation that makes no sense here (UserError); called once, when a method is put together."""
        return None

    @abstractmethod
    def init(self) -> Any:
        """State before the first epoch."""

    @abstractmethod
    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Pair]:
        """Consume one pair; where ``pair.valid`` is False the state must not change."""


class Identity(AbstractReconstruct):
    """The pair as measured."""

    fits: ClassVar[bool] = False

    def init(self) -> Any:
        """No state."""
        return None

    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Pair]:
        """Pass the pair through."""
        return state, pair
