"""A Kalman filter whose state is the quaternion itself, measured by ``H(alpha, beta) q = 0``."""

# No annotations from the future: equinox looks for abstract attributes among them, and finds none in text.
import dataclasses
from abc import abstractmethod
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from jaxalign.arguments import check_choice
from jaxalign.errors import UserError
from jaxalign.estimate.base import AbstractEstimate, Readout
from jaxalign.estimate.triad import triad
from jaxalign.linear import solve_covariance
from jaxalign.observe import Context, Pair
from jaxalign.parametrization import as_float64, tunable
from jaxalign.solution import Status
from jaxalign.vector import Quat, Vec3, where

__all__ = ["AbstractQuaternionFilter", "QuaternionFilter"]


class _State(eqx.Module):
    q: Float[Array, " 4"]
    p: Float[Array, "4 4"]
    noise: Array  # mean of the squared residuals, a number or 4x4
    count: Float[Array, ""]
    started: Bool[Array, ""]
    singular: Bool[Array, ""]
    first: tuple[Vec3, Vec3]  # the first vectors: a start needs two
    sums: tuple[Vec3, Vec3]  # weighted
    weight: Float[Array, ""]  # sum of the weights
    pairs: Float[Array, ""]  # number of pairs, of this measurement
    elapsed: Float[Array, ""]  # s, since the last measurement


class AbstractQuaternionFilter(AbstractEstimate):
    """Four states, each pair of unit vectors a pseudo-measurement: ``0 = (L(alpha) - R(beta)) q``, q = q_n0b0.

    The noise of the vectors stands in H, where it counts as information and shrinks the covariance before the heading
    has shown itself: taken vector by vector at 50 Hz the filter is slow, on a real log (start 30 deg off) useless.
    Averaging the vectors over about a second first cures most of it; the q-method needs no cure. A pair's weight counts
    in the average, the mean weight divides R. A subclass says what R is.

    Attributes:
        averaging: pairs are averaged over this time before they are a measurement, s; 0: each pair is one.
        variance: R at the start, or always.
        prior_variance: variance of the elements of q at the start.
        start: q_n0b0 at the start, (4,); all zeros (default): TRIAD on the first two measurements. A jolt within those
            (10 mg for a second) costs a degree of heading for minutes, a start 30 deg off as much: the filter forgets
            its start slowly.

    Source: Xu 2017 (20)-(28), Schemes 3 and 4; which of three readings (28) means is not certain. Deviations:
    averaging, start, Joseph form; subtracting H P H^T from the residuals (Sage-Husa) is unstable and not offered.
    """

    averaging: eqx.AbstractVar[float]
    variance: eqx.AbstractVar[Float[Array, ""]]
    prior_variance: eqx.AbstractVar[Float[Array, ""]]
    start: eqx.AbstractVar[Float[Array, " 4"]]

    def __check_init__(self):
        if not 0 <= self.averaging < float("inf"):
            raise UserError(f"estimate.averaging = {self.averaging}: must be a number of seconds, 0 for no averaging")
        if self.start.shape != (4,):
            raise UserError(f"estimate.start: must be a quaternion (w, x, y, z), got shape {self.start.shape}")
        if not isinstance(self.start, Tracer) and not np.isfinite(self.start).all():
            raise UserError(f"estimate.start = {np.asarray(self.start)}: must be finite, all zeros for none")

    @abstractmethod
    def first_noise(self) -> Any:
        """The mean of the squared residuals before the first measurement: a number or (4, 4)."""

    @abstractmethod
    def next_noise(self, noise: Any, residual: Any, share: Any, weight: Any) -> tuple[Any, Any]:
        """The mean with one more residual, and R.

        Args:
            noise: the mean so far.
            residual: (4,) of this measurement, before it is used.
            share: of it in the mean.
            weight: of its pairs.

        Returns:
            The mean, and R (4, 4) of a pair with a weight of one.
        """

    def init(self, coupled: bool) -> Any:
        """Before the first measurement."""
        zero, no, v = jnp.zeros((), jnp.float64), jnp.zeros((), bool), Vec3.zero()
        eye = jnp.eye(4)
        given = jnp.sum(self.start**2) > 0
        q = Quat.of(self.start).unit().array
        return _State(
            q, self.prior_variance * eye, self.first_noise(), zero, given, no, (v, v), (v, v), zero, zero, zero
        )

    def update(self, state: Any, context: Context, pair: Pair, weight: Any) -> Any:
        """Average, and measure when the time has come."""
        s = state
        used = (weight > 0) & (pair.alpha.norm2() > 0)
        weight = jnp.where(used, weight, 0.0)
        alpha, beta = s.sums[0] + pair.alpha * weight, s.sums[1] + pair.beta * weight
        total, pairs = s.weight + weight, s.pairs + used
        elapsed = s.elapsed + context.dt
        due = used & (elapsed >= self.averaging * (1 - 1e-6))
        started = s.started
        if_two, defined = triad(alpha, beta, *s.first)
        starts = due & ~started & defined & (s.count > 0)
        mean_weight = jnp.where(due, total, 1.0) / jnp.where(due, pairs, 1.0)
        measured = self._measure(s, alpha.unit(), beta.unit(), mean_weight)
        new = where(due & started, measured, s)
        return _State(
            q=jnp.where(starts, if_two.array, new.q),
            p=new.p,
            noise=new.noise,
            count=s.count + due,
            started=started | starts,
            singular=new.singular,
            first=where(due & (s.count == 0), (alpha, beta), s.first),
            sums=where(due, (Vec3.zero(), Vec3.zero()), (alpha, beta)),
            weight=jnp.where(due, 0.0, total),
            pairs=jnp.where(due, 0.0, pairs),
            elapsed=jnp.where(due, 0.0, elapsed),
        )

    def _measure(self, s: _State, alpha: Vec3, beta: Vec3, weight: Any) -> _State:
        """One Kalman update."""
        h, eye = _matrix(alpha, beta), jnp.eye(4)
        e = h @ s.q
        share = 1.0 / (s.count + 2.0)
        noise, r = self.next_noise(s.noise, e, share, weight)
        r = r / weight
        ph = s.p @ h.T
        transposed, regular = solve_covariance(h @ ph + r, ph.T)
        gain = transposed.T
        rest = eye - gain @ h
        q = Quat.of(s.q - gain @ e).unit().array
        p = rest @ s.p @ rest.T + gain @ r @ gain.T
        good = regular & ~s.singular
        q, p, noise = where(good, (q, p, noise), (s.q, s.p, s.noise))
        return dataclasses.replace(s, q=q, p=p, noise=noise, singular=s.singular | ~regular)

    def readout(self, state: Any, context: Context) -> Readout:
        """The quaternion of the state."""
        defined = state.started & (state.count > 0)
        bit = jnp.where(state.singular, jnp.int32(int(Status.SINGULAR)), 0)
        return Readout(Quat.of(state.q), defined, jnp.zeros((), jnp.float64), bit)


class QuaternionFilter(AbstractQuaternionFilter):
    """The quaternion Kalman filter with one number for R.

    Attributes:
        averaging: pairs are averaged over this time before they are a measurement, s; 0: each pair is one.
        measurement_noise: "cumulative" (default): ``rho I`` with 4 rho the mean squared residual so far, from
            ``variance`` on; "fixed": ``variance I``. The full matrix, as published, is
            :class:`jaxalign.published.FullNoiseQuaternionFilter`.
        variance: R at the start, or always. "fixed" wants half the variance of a vector's direction.
        prior_variance: variance of the elements of q at the start.
        start: q_n0b0 at the start, (4,), see the base class.

    Source: as of the base class.
    """

    averaging: float = eqx.field(static=True, default=1.0)
    measurement_noise: Literal["cumulative", "fixed"] = eqx.field(static=True, default="cumulative")
    variance: Float[Array, ""] = tunable(1e-4, unit="1", bounds=(1e-14, 10.0))
    prior_variance: Float[Array, ""] = tunable(1.0, unit="1", bounds=(1e-12, 1e6))
    start: Float[Array, " 4"] = eqx.field(converter=as_float64, default=(0.0, 0.0, 0.0, 0.0))

    def __check_init__(self):
        check_choice("estimate.measurement_noise", self.measurement_noise, ("cumulative", "fixed"))

    def first_noise(self) -> Any:
        """The variance as given."""
        return self.variance

    def next_noise(self, noise: Any, residual: Any, share: Any, weight: Any) -> tuple[Any, Any]:
        """The mean square of the elements, or what is fixed."""
        if self.measurement_noise == "fixed":
            return noise, self.variance * jnp.eye(4)
        noise = (1.0 - share) * noise + share * weight * jnp.sum(residual * residual) / 4
        return noise, (noise + 1e-12) * jnp.eye(4)


def _matrix(a: Vec3, b: Vec3) -> Float[Array, "4 4"]:
    """``L(a) - R(b)``: null on the q with ``a = q b q*``."""
    d, s, o = a - b, a + b, jnp.zeros_like(a.x)
    return jnp.stack(
        [
            jnp.stack([o, -d.x, -d.y, -d.z]),
            jnp.stack([d.x, o, -s.z, s.y]),
            jnp.stack([d.y, s.z, o, -s.x]),
            jnp.stack([d.z, -s.y, s.x, o]),
        ]
    )
