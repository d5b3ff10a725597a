"""The contract of the estimate slot."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxalign.observe import AbstractObserve, Context, Pair
from jaxalign.vector import Quat

__all__ = ["AbstractEstimate", "Readout"]


class Readout(eqx.Module):
    """An attitude read out of what was accumulated.

    Attributes:
        attitude: q_n0b0, of either sign.
        defined: whether the attitude is unique.
        eigengap: relative gap between the two largest eigenvalues; 0 where the method has none.
        status: bits of :class:`jaxalign.Status` that the estimator itself raises.
    """

    attitude: Quat
    defined: Bool[Array, ""]
    eigengap: Float[Array, ""]
    status: Int[Array, ""]

    @classmethod
    def nothing(cls) -> Readout:
        """Before the first epoch."""
        zero = jnp.zeros((), jnp.float64)
        return cls(Quat.identity(), jnp.zeros((), bool), zero, jnp.zeros((), jnp.int32))

    @classmethod
    def of_gap(cls, attitude: Quat, eigengap: Any, status: Any = 0) -> Readout:
        """The dominant eigenvector of a 4x4 problem: unique where the relative gap is above rounding, 1e-12."""
        return cls(attitude, eigengap > 1e-12, eigengap, jnp.asarray(status, jnp.int32))


class AbstractEstimate(eqx.Module):
    """Slot: accumulate weighted pairs, read out an attitude (which costs far more than accumulating)."""

    def check(self, observe: AbstractObserve) -> None:
        """Refuse an observation that makes no sense here (UserError); called once, when a method is put together."""
        return None

    @abstractmethod
    def init(self, coupled: bool) -> Any:
        """State before the first epoch.

        Args:
            coupled: whether pairs come with a ``displacement`` (a Python bool: it sets the structure of the state).
        """

    @abstractmethod
    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Accumulate one pair; the weight is zero where the pair is not valid."""

    @abstractmethod
    def readout(self, state: Any, context: Context) -> Readout:
        """The attitude of all that was accumulated."""
