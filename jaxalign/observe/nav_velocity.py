"""A velocity aid in the navigation frame: GNSS."""

from __future__ import annotations

from typing import Any

import equinox as eqx
from jaxtyping import Array, Float

from jaxalign.aids import AbstractAid, NavVelocity
from jaxalign.earth import Site
from jaxalign.epochs import Epoch
from jaxalign.observe.base import AbstractObserve, Context, Pair
from jaxalign.observe.options import check_window
from jaxalign.observe.window import Sliding, Sums, Whole, window
from jaxalign.parametrization import given
from jaxalign.propagation import Place, advance_body, advance_nav
from jaxalign.vector import Quat, Vec3, where

__all__ = ["NavVelocityVectors"]


class _State(eqx.Module):
    q_b0b: Quat
    q_n0n: Quat
    place: Place
    gravity: Vec3  # int C_n0n g dt
    displacement: Vec3  # int C_n0n v dt
    sums: Sums
    window: Whole | Sliding
    velocity: Vec3  # last valid one, in n
    fix_n0: Vec3  # the same in n0 at its epoch
    fix_time: Float[Array, ""]
    w_ie: Vec3


class NavVelocityVectors(AbstractObserve):
    """``alpha = C_n0n v(t) - v(0) + int C_n0n (w_ie x v) dt - int C_n0n g dt``, ``beta = int C_b0b f dt``.

    The Coriolis integral is ``w_ie_n0 x int C_n0n v dt`` (w_ie is constant in n0), with the trapezoid of C_n0n v,
    which also bridges missing fixes; for a velocity linear between fixes it equals Huang's (23). n turns with the
    vehicle: the rate is that of the mean velocity of the interval, the latitude is integrated. The paper's
    observation, with n fixed to the Earth, is :class:`jaxalign.published.EarthFixedNavVelocityVectors`.

    Attributes:
        window: length of the window in seconds, 0 for the whole time.
        interval: between epochs, s, which a window must know; None: to be told (:meth:`jaxalign.Aligner.at_interval`).
        aid: that it observes.

    Source: Huang (004) (8)-(31) with its names alpha and beta exchanged.
    """

    window: float = eqx.field(static=True, default=0.0)
    interval: float | None = given(None)
    aid: AbstractAid = given(NavVelocity())

    def __check_init__(self):
        check_window(self.window)

    def init(self, site: Site) -> Any:
        """State before the first epoch (see the base class)."""
        sums = Sums.zero(displacement=False)
        zero, none, place = Vec3.zero(), Quat.identity(), Place.of(site)
        held = window(self.window, self.interval, sums)
        return _State(none, none, place, zero, zero, sums, held, zero, zero, zero.x, place.earth_rate)

    def step(self, state: Any, context: Context, epoch: Epoch) -> tuple[Any, Pair]:
        """Consume one epoch."""
        s = state
        velocity = where(epoch.valid, epoch.velocity, s.velocity)
        # Before the first fix there is nothing to average with: its own velocity stands for the interval.
        mean = (where(s.window.started, s.velocity, velocity) + velocity) * 0.5
        middle, place = s.place.moved(mean, 0.5 * epoch.dt), s.place.moved(mean, epoch.dt)
        rate = middle.earth_rate + middle.transport_rate(mean)
        q_b0b, gained = advance_body(s.q_b0b, epoch.rotation, epoch.dvel)
        q_n0n, fallen = advance_nav(s.q_n0n, rate, s.place.gravity, epoch.dt)
        gravity = s.gravity + fallen
        velocity_n0 = q_n0n.rotate(velocity)
        moved = (s.fix_n0 + velocity_n0) * (0.5 * (context.time - s.fix_time))
        displacement = s.displacement + where(epoch.valid, moved, Vec3.zero())
        fix_n0, fix_time = where(epoch.valid, (velocity_n0, context.time), (s.fix_n0, s.fix_time))
        sums = Sums(
            velocity_n0 + s.w_ie.cross(displacement) - gravity,
            s.sums.beta + gained,
            None,
        )
        held, pair, valid, since = s.window.push(context.index, sums, epoch.valid)
        new = _State(q_b0b, q_n0n, place, gravity, displacement, sums, held, velocity, fix_n0, fix_time, s.w_ie)
        return new, Pair(pair.alpha, pair.beta, valid, since.beta, pair.beta, None, s.w_ie)
