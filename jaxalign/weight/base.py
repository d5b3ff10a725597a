"""The contract of the slot, and the weight of one."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxalign.observe import AbstractObserve, Context, Pair

__all__ = ["AbstractWeight", "Unit"]


class AbstractWeight(eqx.Module):
    """Slot: a pair to a weight in [0, 1].

    A class that does not look at ``context.attitude`` sets ``looks_at_attitude = False``: then the eigenproblem need
    not be solved at every epoch where the attitude is wanted at every tenth only.
    """

    looks_at_attitude: ClassVar[bool] = True

    def check(self, observe: AbstractObserve) -> None:
        """Refuse an observation that makes no sense here (UserError); called once, when a method is put together."""
        return None

    @abstractmethod
    def init(self) -> Any:
        """State before the first epoch."""

    @abstractmethod
    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Any]:
        """Weigh one pair; where ``pair.valid`` is False the state must not change (the weight is then ignored)."""


class Unit(AbstractWeight):
    """Every pair counts alike."""

    looks_at_attitude: ClassVar[bool] = False

    def init(self) -> Any:
        """No state."""
        return None

    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Any]:
        """Weigh a pair: always by one."""
        return state, jnp.ones((), jnp.float64)
