"""An attitude that needs no guess: Wahba's problem with the first velocity free, reweighted over a whole history."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.batch.model import Guess
from jaxalign.epochs import Epochs
from jaxalign.estimate import CentredSums, Held, reweighted
from jaxalign.observe.frames import Place, gravity_impulse, turn
from jaxalign.vector import Quat, Vec3

__all__ = ["misfit", "robust_start", "views"]

_CUTOFF = 6.0  # Tukey's


def views(epochs: Epochs) -> tuple[Vec3, Vec3]:
    """What the force and the aid say of the velocity gained since the first epoch.

    Returns:
        alpha (K,) in n0 and beta (K,) in b0, m/s: ``C_n0b0 beta - alpha`` is the first velocity (body aid), less it
        (navigation aid), or zero (standing), but for noise. Left out is what would need the attitude: with a body
        aid the transport rate and the term of Coriolis (0.1 m/s after 300 s at 5 m/s).
    """
    place = Place.of(epochs.site)
    w_ie, nav = place.earth_rate, epochs.aid == "nav"

    def step(carry: Any, row: Any) -> Any:
        q_b0b, q_n0n, force, fallen, moved, seen = carry
        velocity = jax.tree.map(lambda new, old: jnp.where(row.valid, new, old), row.velocity, seen)
        rate = w_ie + place.transport_rate(velocity) if nav else w_ie
        force = force + q_b0b.rotate(row.dvel)
        fallen = fallen + q_n0n.rotate(gravity_impulse(rate, place.gravity, row.dt))
        q_b0b, q_n0n = (q_b0b * row.rotation).renormalised(), turn(q_n0n, rate, row.dt)
        moved = moved + q_n0n.rotate(velocity) * row.dt
        if epochs.aid == "body":
            pair = fallen, q_b0b.rotate(row.velocity) - force
        elif nav:
            pair = q_n0n.rotate(row.velocity) + w_ie.cross(moved) - fallen, force
        else:
            pair = -fallen, force
        return (q_b0b, q_n0n, force, fallen, moved, velocity), pair

    zero, none = Vec3.zero(), Quat.identity()
    return jax.lax.scan(step, (none, none, zero, zero, zero, zero), epochs.rows)[1]


def robust_start(
    alpha: Vec3, beta: Vec3, used: Bool[Array, " K"], sd: Any, aid: str
) -> tuple[Guess, Float[Array, " K"], Float[Array, ""]]:
    """Attitude and first velocity that most of the pairs agree on.

    Args:
        alpha: (K,) in n0.
        beta: (K,) in b0.
        used: which of them to use.
        sd: least noise to believe in, m/s.
        aid: kind of aid.

    Returns:
        The guess, the weights (0..1) and the standard deviation (m/s per axis) of what is left.
    """
    held = Held(alpha, beta, None, Vec3.zero(), used)
    found, sums, weight, scale = reweighted(CentredSums.zero(False), held, Quat.identity(), False, sd, _CUTOFF)
    offset = sums.offset(found.attitude, Vec3.zero())
    return Guess.of(found.attitude, offset if aid == "nav" else -offset), weight, scale


def misfit(alpha: Vec3, beta: Vec3, guess: Guess, aid: str) -> Vec3:
    """(K,) what the pairs are off a guess, m/s, n0."""
    velocity = guess.velocity if aid == "nav" else -guess.velocity
    return alpha - guess.attitude.rotate(beta) - velocity
