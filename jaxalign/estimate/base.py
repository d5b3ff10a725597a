"""The contract of the estimate slot."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import equinox as eqx
from jaxtyping import Array, Bool, Float

from jaxalign.observe import Context, Pair
from jaxalign.vector import Quat

__all__ = ["AbstractEstimate", "Readout"]


class Readout(eqx.Module):
    """An attitude read out of the sums.

    Attributes:
        attitude: q_n0b0, of either sign.
        eigengap: relative gap between the two largest eigenvalues; below 1e-12 the attitude is not unique.
    """

    attitude: Quat
    eigengap: Float[Array, ""]

    @property
    def defined(self) -> Bool[Array, ""]:
        """Whether the attitude is unique: the gap is above rounding."""
        return self.eigengap > 1e-12


class AbstractEstimate(eqx.Module):
    """Slot: accumulate weighted pairs, read out an attitude (which costs far more than accumulating)."""

    @abstractmethod
    def init(self, coupled: bool) -> Any:
        """State before the first epoch.

        Args:
            coupled: whether pairs come with a ``moment`` (a Python bool: it sets the structure of the state).
        """

    @abstractmethod
    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Accumulate one pair; the weight is zero where the pair is not valid."""

    @abstractmethod
    def readout(self, state: Any, context: Context) -> Readout:
        """The attitude of all that was accumulated."""
