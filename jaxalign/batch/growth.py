"""A start that survives large biases: windows that grow from the first seconds to the whole record.

A gyroscope bias of degrees per second turns the path by a hundred degrees before there is anything to linearise about.
Over the first seconds it does not; each window then begins with what the one before it has found, and the trajectory
goes on from its end.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxalign.batch.problem import AidNoise, Problem, State
from jaxalign.batch.trajectory import NominalTrajectory
from jaxalign.preintegration import Increment
from jaxalign.propagation import Place, advance_nav
from jaxalign.vector import Quat, Vec3

__all__ = ["LEVELS", "extend", "window_ends", "with_gyro_bias"]

LEVELS = 10
_FIRST, _RATIO = 4.0, 1.6  # s; of one window to the one before it
_FEWEST = 3  # fixes in the first


def window_ends(time: Any, aided: Any, last: Any) -> Any:
    """(10, ...) the last epoch of each window; NumPy or traced.

    Args:
        time: (K,) of the epochs, s.
        aided: (K,) whether there is a fix.
        last: (...) epochs that the last windows end at.
    """
    xp = np if isinstance(time, np.ndarray) else jnp
    last = xp.asarray(last)
    time = time - time[0]
    span = xp.maximum(time[last], _FIRST)
    ratio = xp.maximum(_RATIO, (span / _FIRST) ** (1.0 / (LEVELS - 1)))
    power = np.arange(LEVELS).reshape(LEVELS, *[1] * last.ndim)
    ends = xp.searchsorted(time, _FIRST * ratio**power)
    fixes = xp.cumsum(aided)
    fewest = xp.minimum(xp.sum(fixes < _FEWEST), len(time) - 1)
    ends = xp.maximum(ends, xp.maximum(fewest, 2))
    ends = xp.where(power == LEVELS - 1, last, ends)
    return xp.minimum(ends, last)


def extend(problem: Problem, state: State, after: Any) -> State:
    """The trajectory from an epoch on mechanized from the state there; fixes beyond it count in full.

    Args:
        problem: its rows and its site.
        state: what is known.
        after: (L,) the last epoch that stays as it is.
    """
    begin = Place.of(problem.site)
    w_ie = begin.earth_rate
    lanes = state.moving.shape
    index = jnp.arange(len(problem.rows.dt))

    def step(carry: Any, row: Any) -> Any:
        (q, v, gyro, accel), q_n0n, north = carry
        epoch, now, k = row
        dt = epoch.dt
        moved = Increment(epoch.rotation, epoch.dvel).corrected(gyro, accel, dt)
        gained = q.rotate(moved.dvel)
        meridian, _ = begin.circle.radii
        place = Place(begin.circle.moved(north / (meridian + begin.h)), begin.h, begin.anomaly)
        kept = k <= after
        soon = v + gained + q_n0n.rotate(Vec3(0.0 * dt, 0.0 * dt, -place.gravity * dt))
        middle = (v + jax.tree.map(lambda a, b: jnp.where(kept, a, b), now[1], soon)) * 0.5
        in_n = q_n0n.conjugate().rotate(middle)
        q_n0n, fallen = advance_nav(q_n0n, place.earth_rate + place.transport_rate(in_n), place.gravity, dt)
        ahead = (q * moved.rotation).renormalised(), v + gained + fallen - w_ie.cross(middle) * dt, gyro, accel
        at = jax.tree.map(lambda a, b: jnp.where(kept, a, b), now, ahead)
        return (at, q_n0n, north + in_n.y * dt), (at, q_n0n)

    nominal = state.at.attitude, state.at.velocity, state.at.gyro, state.at.accel
    level = jax.tree.map(lambda x: x * jnp.ones(lanes), Quat.identity())
    start = jax.tree.map(lambda x: x[0], nominal), level, jnp.zeros(lanes)
    _, (at, q_n0n) = jax.lax.scan(step, start, (problem.rows, nominal, index))
    fresh = index[:, None] > after
    noise = tuple(
        AidNoise(jnp.where(fresh, 1.0, one.weight), one.variance, jnp.ones_like(one.times)) for one in state.noise
    )
    return dataclasses.replace(state, at=NominalTrajectory(*at), q_n0n=q_n0n, noise=noise)


def with_gyro_bias(state: State, gyro: Any) -> State:
    """The same trajectory with this bias (3, L) of the gyroscopes at all epochs."""
    shape = state.at.gyro.x.shape
    return dataclasses.replace(
        state, at=dataclasses.replace(state.at, gyro=Vec3(*(jnp.broadcast_to(x, shape) for x in gyro)))
    )
