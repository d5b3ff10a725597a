"""A velocity aid in the body frame as the papers observe it: Coriolis term by recursion, n fixed to the Earth."""

from __future__ import annotations

from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from jaxalign.aids import AbstractAid, BodyVelocity
from jaxalign.earth import Site
from jaxalign.epochs import Epoch
from jaxalign.observe.base import AbstractObserve, Context, Pair
from jaxalign.observe.options import check_window
from jaxalign.observe.window import Sliding, Sums, Whole, window
from jaxalign.parametrization import given
from jaxalign.propagation import Place, advance_body, advance_nav
from jaxalign.vector import Quat, Vec3, where

__all__ = ["RecursiveBodyVelocityVectors"]


class _State(eqx.Module):
    q_b0b: Quat
    q_n0n: Quat
    place: Place
    force: Vec3  # int C_b0b f dt
    coriolis: Vec3  # int C_b0b (w_ie x v) dt, of the past
    sums: Sums
    window: Whole | Sliding
    velocity: Vec3  # last valid one, in b
    velocity_b0: Vec3  # the same carried along with b, in b0
    fix_b0: Vec3  # in b0 at the last valid epoch
    fix_time: Float[Array, ""]
    w_ie: Vec3


class RecursiveBodyVelocityVectors(AbstractObserve):
    """The vectors of :class:`jaxalign.BodyVelocityVectors` by the recursions of the papers.

    The Coriolis integral takes each interval once, with the attitude of the previous epoch (zero until there is one).
    That costs up to 0.05 deg at 60 s and 0.003 deg at 300 s without noise.

    Attributes:
        transport_rate: False (default), as published: n is fixed to the Earth, a yaw bias of -v_N / (R w_ie cos(lat)),
            0.43 deg at 3 m/s. True: n turns with the velocity and the attitude of the previous epoch, to first order;
            the latitude stays that of the start (the frozen results named "wen").
        window: length of the window in seconds, 0 for the whole time.
        interval: between epochs, s, which a window must know; None: to be told (:meth:`jaxalign.Aligner.at_interval`).
        aid: that it observes.

    Source: Xu 2020 (5)-(20), Shen 2025 (alpha and beta exchanged there).
    """

    transport_rate: bool = eqx.field(static=True, default=False)
    window: float = eqx.field(static=True, default=0.0)
    interval: float | None = given(None)
    aid: AbstractAid = given(BodyVelocity())

    def __check_init__(self):
        check_window(self.window)

    def init(self, site: Site) -> Any:
        """State before the first epoch (see the base class)."""
        sums = Sums.zero(displacement=False)
        zero, none, place = Vec3.zero(), Quat.identity(), Place.of(site)
        held = window(self.window, self.interval, sums)
        return _State(none, none, place, zero, zero, sums, held, zero, zero, zero, zero.x, place.earth_rate)

    def _rate(self, s: Any, context: Context) -> Vec3:
        """w_in of the interval."""
        if not self.transport_rate:
            return s.place.earth_rate
        velocity_n = s.q_n0n.conjugate().rotate(context.attitude.rotate(s.velocity_b0))
        return s.place.earth_rate + s.place.transport_rate(where(context.defined, velocity_n, Vec3.zero()))

    def step(self, state: Any, context: Context, epoch: Epoch) -> tuple[Any, Pair]:
        """Consume one epoch."""
        s = state
        q_b0b, gained = advance_body(s.q_b0b, epoch.rotation, epoch.dvel)
        force = s.force + gained
        velocity = where(epoch.valid, epoch.velocity, s.velocity)
        velocity_b0 = q_b0b.rotate(velocity)
        rate = self._rate(s, context)
        q_n0n, fallen = advance_nav(s.q_n0n, rate, s.place.gravity, epoch.dt)
        alpha = s.sums.alpha + fallen

        displacement = (s.fix_b0 + velocity_b0) * (0.5 * (context.time - s.fix_time))
        displacement = where(epoch.valid, displacement, Vec3.zero())
        fix_b0, fix_time = where(epoch.valid, (velocity_b0, context.time), (s.fix_b0, s.fix_time))
        w_ie_b0 = where(context.defined, context.attitude.conjugate().rotate(s.w_ie), Vec3.zero())
        coriolis = s.coriolis + w_ie_b0.cross(displacement)
        sums = Sums(alpha, velocity_b0 + coriolis - force, None)
        held, pair, valid, since = s.window.push(context.index, sums, epoch.valid)
        new = _State(
            *(q_b0b, q_n0n, s.place, force, coriolis, sums, held),
            *(velocity, velocity_b0, fix_b0, fix_time, s.w_ie),
        )
        return new, Pair(pair.alpha, pair.beta, valid, since.alpha, pair.beta, None, s.w_ie)
