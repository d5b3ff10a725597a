"""The fixes of an aid along a trajectory: what they are off, and how that depends on the errors.

The only place of the batch estimator that knows what an aid measures.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.batch.trajectory import Trajectory
from jaxalign.vector import Quat, Vec3

__all__ = ["PARTS", "Fixes", "fixes", "parts_of"]

PARTS = {"mounting": 4, "latency": 1, "lever": 3, "slow": 3}
"""Unknowns of an aid, in the order of their states, and how many numbers each is.

mounting: scale factor and misalignment (rad, b) of a body aid, ``v_measured = (1 + scale) (v - misalignment x v)``;
latency: s, it measures the velocity of so long ago; lever: m, b, from the inertial unit to the aid, which moves as the
vehicle turns; slow: m/s, an error in the frame of the aid that fades and renews itself (Gauss-Markov).
"""


def parts_of(names: tuple[str, ...]) -> dict[str, slice]:
    """Where the unknowns of these names are among the unknowns."""
    out, end = {}, 0
    for name, size in PARTS.items():
        if name in names:
            out[name] = slice(end, end + size)
            end += size
    return out


class Fixes(eqx.Module):
    """``gap = slope x errors + noise``, in n0.

    Attributes:
        gap: (K, m, L) measured minus nominal, m/s; zero where there is no fix.
        slope: (K, m, n, L); zero where there is none.
        variance: (K, m, L) of the noise, as a multiple of that of the aid.
    """

    gap: Float[Array, "K m L"]
    slope: Float[Array, "K m n L"]
    variance: Float[Array, "K m L"]


class _Neighbours(NamedTuple):
    before: Trajectory
    dt: Array


def _change(at: Trajectory, near: _Neighbours, aid: str) -> Vec3:
    """How fast a velocity changes in the frame of its aid, turned into n0: over the interval before each epoch."""
    before = near.before.velocity
    if aid == "body":
        before = (at.attitude * near.before.attitude.conjugate()).rotate(before)
    moved = near.dt > 0
    return (at.velocity - before) * jnp.where(moved, 1.0 / jnp.where(moved, near.dt, 1.0), 0.0)


def _rate(at: Trajectory, near: _Neighbours) -> Vec3:
    """How fast the vehicle turns, n0, rad/s: over the two intervals around each epoch, as far as they count."""
    turn = (at.attitude * near.before.attitude.conjugate()).positive().log()
    turn = jax.tree.map(lambda x: jnp.where(near.dt > 0, x, 0.0), turn)
    turn, dt = jax.tree.map(lambda x: x + jnp.concatenate([x[1:], 0.0 * x[:1]]), (turn, near.dt))
    return turn * jnp.where(dt > 0, 1.0 / jnp.where(dt > 0, dt, 1.0), 0.0)


def _axes(q: Quat) -> tuple[Vec3, Vec3, Vec3]:
    """The columns of its matrix."""
    m = q.matrix
    return Vec3(m.r0.x, m.r1.x, m.r2.x), Vec3(m.r0.y, m.r1.y, m.r2.y), Vec3(m.r0.z, m.r1.z, m.r2.z)


def fixes(
    at: Trajectory,
    q_n0n: Quat,
    dt: Float[Array, "K L"],
    velocity: Vec3,
    used: Bool[Array, "K L"],
    aid: str,
    unknowns: dict[str, Array],
    settled: Vec3 | None = None,
) -> Fixes:
    """The fixes of a velocity aid.

    A tilt turns the velocity of the trajectory where the aid measures in a frame that turns along: a body aid, and a
    standing vehicle. A navigation aid has measured it as it is; of a trajectory whose velocities change by noise alone
    a tilt turns what is noise, which must tell no heading: it is taken out.

    Args:
        at: the trajectory.
        q_n0n: n at its epochs.
        dt: of the interval before each epoch, s; zero where it does not count.
        velocity: (K, L) or (K, 1) of the aid, m/s, in b or n; any where the vehicle stands.
        used: where there is one to use.
        aid: "body", "nav" or "static" (the velocity is zero).
        unknowns: (size, L) what is known so far of the unknowns of the aid, by name.
        settled: (K, L) for a navigation aid, velocities without the part of their changes that is noise, m/s, n0.
    """
    v, shape = at.velocity, at.velocity.x.shape
    near = _Neighbours(jax.tree.map(lambda x: jnp.concatenate([x[:1], x[:-1]]), at), dt)
    zero, one = jnp.zeros(shape), jnp.ones(shape)
    none = [Vec3(zero, zero, zero)] * 3
    off = v if settled is None else v - settled
    turning = [Vec3(zero, off.z, -off.y), Vec3(-off.z, zero, off.x), Vec3(off.y, -off.x, zero)]
    columns = [*turning, Vec3(one, zero, zero), Vec3(zero, one, zero), Vec3(zero, zero, one), *none, *none]
    if "mounting" in unknowns:
        scale, *turn = unknowns["mounting"]
        velocity = (velocity + Vec3(*turn).cross(velocity)) * (1.0 / (1.0 + scale))
        columns += [v, *(v.cross(axis) for axis in _axes(at.attitude))]
    frame = q_n0n if aid == "nav" else at.attitude
    seen = v * 0.0 if aid == "static" else frame.rotate(velocity)
    if "latency" in unknowns:
        change = _change(at, near, aid)
        seen = seen + change * unknowns["latency"][0]
        columns.append(-change)
    if "lever" in unknowns:
        rate = _rate(at, near)
        seen = seen - rate.cross(at.attitude.rotate(Vec3(*unknowns["lever"])))
        columns += [rate.cross(axis) for axis in _axes(at.attitude)]
    if "slow" in unknowns:
        columns += _axes(frame)
    there = used[:, None]

    def stack(u: Vec3) -> Array:
        return jnp.stack(jnp.broadcast_arrays(u.x, u.y, u.z), axis=1)

    gap = jnp.where(there, stack(seen - v), 0.0)
    slope = jnp.where(there[:, None], jnp.stack([stack(c) for c in columns], axis=2), 0.0)
    return Fixes(gap, slope, jnp.ones_like(gap))
