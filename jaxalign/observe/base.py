"""What an observation is: the pair of vectors, the context of a step, and the contract of the slot."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxalign.aids import AbstractAid
from jaxalign.earth import Site
from jaxalign.epochs import Epoch
from jaxalign.vector import Quat, Vec3

__all__ = ["AbstractObserve", "Context", "Pair"]


class Context(eqx.Module):
    """All that a slot may look back at.

    Attributes:
        index: epoch k, from 0; negative for the empty epochs that pad a sparse read-out in front.
        time: s since epoch 0.
        dt: length of the interval up to this epoch, s.
        attitude: q_n0b0 of the last read-out (the identity until ``defined``).
        defined: whether that attitude is unique (relative eigengap above rounding).
        sd: standard deviation of the aid's white noise per axis, m/s (standing: of the force over one interval).
        fresh: whether that attitude is at most one epoch old (static): a read-out that iterates on it may stop early.
    """

    index: Int[Array, ""]
    time: Float[Array, ""]
    dt: Float[Array, ""]
    attitude: Quat
    defined: Bool[Array, ""]
    sd: Float[Array, ""]
    fresh: bool = eqx.field(static=True, default=False)


class Pair(eqx.Module):
    """Two views of one vector: ``C_n0b0 beta = alpha``, both in m/s.

    Attributes:
        alpha: in n0.
        beta: in b0, complete: with the Coriolis term of the last attitude read out.
        valid: whether to use it; where False the vectors are finite but stale.
        noise_free: of the two, the one without the aid's noise, whose spread says when the heading becomes observable:
            integrated from the start whatever the window, or the step of the interval (``AbstractObserve.steps``).
        beta_without_coriolis: beta without the term that depends on the attitude sought.
        displacement: P with ``beta = beta_without_coriolis + (C_b0n0 w_ie) x P``, m; None where beta does not depend
            on the attitude. Estimators use it to correct the whole past at once.
        w_ie: Earth rate in n0, rad/s.
    """

    alpha: Vec3
    beta: Vec3
    valid: Bool[Array, ""]
    noise_free: Vec3
    beta_without_coriolis: Vec3
    displacement: Vec3 | None
    w_ie: Vec3

    def residual(self, attitude: Quat) -> Vec3:
        """``alpha - C_n0b0 beta`` (m/s, in n0) for an attitude q_n0b0."""
        return self.alpha - attitude.rotate(self.beta)


class AbstractObserve(eqx.Module):
    """Slot: epochs to vector pairs. The state must carry ``q_b0b`` and ``q_n0n`` (b and n since the start)."""

    steps: ClassVar[bool] = False
    """Whether ``Pair.noise_free`` is the step of the interval, the aid's noise that of a step (a standing vehicle)."""
    interval: eqx.AbstractVar[float | None]
    window: eqx.AbstractVar[float]
    aid: eqx.AbstractVar[AbstractAid]

    def whitened(self, residual: np.ndarray, time: np.ndarray, sd: float, interval: float) -> np.ndarray:
        """Residuals in standard deviations of their noise, see :meth:`jaxalign.method.AbstractMethod.whitened`.

        Two velocities are in each vector.
        """
        return residual / (np.sqrt(2.0) * sd)

    @property
    def coupled(self) -> bool:
        """Whether the pairs carry a ``displacement``: beta depends on the attitude sought."""
        return False

    @abstractmethod
    def init(self, site: Site) -> Any:
        """State before the first epoch.

        Args:
            site: where the vehicle is switched on.
        """

    @abstractmethod
    def step(self, state: Any, context: Context, epoch: Epoch) -> tuple[Any, Pair]:
        """Consume one epoch."""
