"""A trajectory that needs no guess: Wahba's problem with the first velocity free, reweighted over a whole history."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.aids import Axes
from jaxalign.batch.pool import Pool
from jaxalign.batch.reweight import lower_median
from jaxalign.batch.trajectory import NominalTrajectory
from jaxalign.earth import Site
from jaxalign.epochs import Epoch
from jaxalign.estimate import davenport
from jaxalign.propagation import Place, advance_body, advance_nav
from jaxalign.vector import Quat, Vec3

__all__ = ["InitialState", "IntegratedVectors", "integrate_vectors", "misfit", "robust_start"]

_CUTOFF = 6.0  # Tukey's
_ROUNDS = 12
_LAST = 4  # of them with Tukey's weight, those before with that of least absolute values
_MEDIAN = 1.538  # of the length of three unit normal numbers


class InitialState(eqx.Module):
    """At the first epoch.

    Attributes:
        attitude: q_n0b0.
        velocity: m/s, n0.
    """

    attitude: Quat
    velocity: Vec3


class IntegratedVectors(eqx.Module):
    """What the inertial unit and the aid say of the velocity gained since the first epoch.

    ``C_n0b0 beta - alpha`` is the first velocity (measured in b), or less it (in n), but for noise. Left out is what
    would need the attitude: with a velocity in b the transport rate and the term of Coriolis
    (0.1 m/s after 300 s at 5 m/s).

    Attributes:
        alpha: (K, ...) m/s, n0.
        beta: (K, ...) m/s, b0.
        q_b0b: turn since the first epoch.
        q_n0n: n.
        force: integrated specific force, m/s, b0.
        fallen: integrated gravity, m/s, n0.
    """

    alpha: Vec3
    beta: Vec3
    q_b0b: Quat
    q_n0n: Quat
    force: Vec3
    fallen: Vec3

    def trajectory(self, start: InitialState) -> NominalTrajectory:
        """The trajectory that leads on from a start, without biases and the term of Coriolis."""
        zero = jax.tree.map(lambda x: 0.0 * x, self.force)
        velocity = start.velocity + start.attitude.rotate(self.force) + self.fallen
        at = NominalTrajectory(start.attitude * self.q_b0b, velocity, zero, zero)
        shape = jnp.broadcast_shapes(*(x.shape for x in jax.tree.leaves(at)))
        return jax.tree.map(lambda x: jnp.broadcast_to(x, shape), at)


def integrate_vectors(rows: Epoch, site: Site, seen: Pool) -> IntegratedVectors:
    """Sum up a log, or several side by side.

    Args:
        rows: leaves (K, ...).
        site: leaves () or those that follow K.
        seen: velocities.
    """
    place = Place.of(site)
    w_ie, nav = place.earth_rate, seen.axes is Axes.NAV
    shape = rows.dvel.x.shape[1:]

    def step(carry: Any, given: Any) -> Any:
        row, measured, valid = given
        q_b0b, q_n0n, force, fallen, moved, before = carry
        velocity = jax.tree.map(lambda new, old: jnp.where(valid, new, old), measured, before)
        rate = w_ie + place.transport_rate(velocity) if nav else w_ie
        q_b0b, gained = advance_body(q_b0b, row.rotation, row.dvel)
        q_n0n, fell = advance_nav(q_n0n, rate, place.gravity, row.dt)
        force, fallen = force + gained, fallen + fell
        moved = moved + q_n0n.rotate(velocity) * row.dt
        if nav:
            pair = q_n0n.rotate(measured) + w_ie.cross(moved) - fallen, force
        else:
            pair = fallen, q_b0b.rotate(measured) - force
        carry = (q_b0b, q_n0n, force, fallen, moved, velocity)
        return jax.tree.map(lambda x: jnp.broadcast_to(x, shape), carry), IntegratedVectors(
            *pair, q_b0b, q_n0n, force, fallen
        )

    zero, none = Vec3.zero(), Quat.identity()
    start = jax.tree.map(lambda x: jnp.broadcast_to(x, shape), (none, none, zero, zero, zero, zero))
    found = jax.lax.scan(step, start, (rows, seen.velocity, seen.valid))[1]
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (len(rows.dt), *shape)), found)


def robust_start(
    alpha: Vec3, beta: Vec3, used: Bool[Array, "K L"], sd: Any, axes: Axes
) -> tuple[InitialState, Float[Array, "K L"], Float[Array, " L"]]:
    """Attitude and first velocity that most of the pairs agree on.

    Rounds with the weight of least absolute values, which need no start, then with Tukey's, which throws out.

    Args:
        alpha: (K, L) in n0.
        beta: (K, L) in b0.
        used: which of them to use.
        sd: least noise to believe in, m/s.
        axes: that the velocities were measured in.

    Returns:
        The start, the weights (0..1) and the standard deviation (m/s per axis) of what is left.
    """

    def mean(v: Vec3, weight: Any) -> Vec3:
        total = jnp.sum(weight, axis=0)
        least = jnp.where(total > 0, total, 1.0)
        return jax.tree.map(lambda x: jnp.sum(weight * x, axis=0) / least, v)

    def solved(weight: Any) -> tuple[Quat, Vec3]:
        a, b = mean(alpha, weight), mean(beta, weight)
        profile = jax.tree.map(lambda x: jnp.sum(x, axis=0), ((alpha - a) * weight).outer(beta - b))
        attitude = davenport(profile).vector
        return attitude, a - attitude.rotate(b)

    def round_(carry: Any, number: Any) -> Any:
        weight = carry[0]
        attitude, offset = solved(weight)
        length = (alpha - attitude.rotate(beta) - offset).norm()
        scale = jnp.maximum(lower_median(length, used) / _MEDIAN, sd)
        near = jnp.minimum(1.0, scale / jnp.maximum(length, scale))
        tukey = jnp.maximum(0.0, 1.0 - (length / (_CUTOFF * scale)) ** 2) ** 2
        new = jnp.where(used, jnp.where(number >= _ROUNDS - _LAST, tukey, near), 0.0)
        return (new, weight, attitude, offset, scale, carry[4]), None

    lanes = used.shape[1:]
    zero = jnp.zeros(lanes)
    weight = used * 1.0
    start = (weight, weight, Quat(zero + 1.0, zero, zero, zero), Vec3(zero, zero, zero), zero, zero)
    # One round more: it solves with the weights of the last one, and its own are not used.
    (_, weight, attitude, offset, _, scale), _ = jax.lax.scan(round_, start, jnp.arange(_ROUNDS + 1))
    return InitialState(attitude, offset if axes is Axes.NAV else -offset), weight, scale


def misfit(alpha: Vec3, beta: Vec3, start: InitialState, axes: Axes) -> Vec3:
    """(K,) what the pairs are off a start, m/s, n0."""
    velocity = start.velocity if axes is Axes.NAV else -start.velocity
    return alpha - start.attitude.rotate(beta) - velocity
