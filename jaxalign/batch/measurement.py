"""The measurements of the aids along a trajectory: what they are off, and how that depends on the errors.

One rule gives the slopes of all aids. A tilt turns the velocity of the trajectory where an aid measures in axes that
turn along: so turning the whole trajectory about the vertical changes nothing that such an aid sees. An aid in n has
measured the velocity as it is; of a trajectory whose velocities change by noise alone a tilt turns what is noise, which
must tell no heading. So slopes are taken at velocities without that noise, *steady* ones, and the errors of the
velocity are told from the turning of the rest.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.aids import AbstractAid, Axes, Linearized
from jaxalign.aids.linearization import as_components, named
from jaxalign.aids.motion import Motion
from jaxalign.batch.trajectory import STATES, NominalTrajectory
from jaxalign.epochs import Fix
from jaxalign.vector import Quat, Vec3

__all__ = [
    "LinearMeasurements",
    "Unknowns",
    "first_velocity",
    "linearize",
    "parts_of",
    "steady_aid",
    "turn_to_n0",
    "unknowns_of",
]

Unknowns = tuple[tuple[str, ...], ...]
"""Of each aid the names of its unknowns that are estimated."""


def parts_of(aids: tuple[AbstractAid, ...]) -> list[slice]:
    """Where the components of each aid are among all."""
    out, end = [], 0
    for aid in aids:
        out.append(slice(end, end + len(aid.components)))
        end += len(aid.components)
    return out


def unknowns_of(aids: tuple[AbstractAid, ...], names: Unknowns) -> list[dict[str, slice]]:
    """Where the unknowns of each aid are among all unknowns."""
    out, end = [], 0
    for aid, own in zip(aids, names, strict=True):
        places = {}
        for name, unknown in aid.known_unknowns.items():
            if name in own:
                places[name] = slice(end, end + unknown.size)
                end += unknown.size
        out.append(places)
    return out


def steady_aid(aids: tuple[AbstractAid, ...]) -> int | None:
    """The first aid that measures a velocity in n, which has steady velocities; None if there is none."""
    return next((i for i, aid in enumerate(aids) if aid.velocity_axes is Axes.NAV), None)


def first_velocity(aids: tuple[AbstractAid, ...]) -> int:
    """The first aid that tells a whole velocity, else a part of one, else the first."""
    told = [i for i, aid in enumerate(aids) if aid.velocity_axes is not None]
    return next(iter([i for i in told if aids[i].full_velocity] or told), 0)


def turn_to_n0(aid: AbstractAid, values: Float[Array, "m L"], q_n0b: Quat, q_n0n: Quat) -> Float[Array, "3 L"]:
    """Components of a velocity in n0, those that the aid does not tell zero."""
    seen = aid.velocity(tuple(values))
    zero = jnp.zeros_like(values[0])
    axes, parts = (Axes.BODY, (zero, zero, zero)) if seen is None else seen
    v = Vec3(*(zero if x is None else x for x in parts))
    v = (q_n0n if axes is Axes.NAV else q_n0b).rotate(v)
    return jnp.stack([v.x, v.y, v.z])


class LinearMeasurements(eqx.Module):
    """``gap = slope x errors + noise``, each component in the unit of its aid.

    Attributes:
        gap: (K, m, L) measured minus predicted; zero where there is none.
        slope: (K, m, n, L); zero where there is none.
        known: (K, m, L) where there is one.
    """

    gap: Float[Array, "K m L"]
    slope: Float[Array, "K m n L"]
    known: Bool[Array, "K m L"]


def _before(tree: Any) -> Any:
    return jax.tree.map(lambda x: jnp.concatenate([x[:1], x[:-1]]), tree)


def _rate(at: NominalTrajectory, dt: Any) -> Vec3:
    """How fast the vehicle turns, n0, rad/s: over the two intervals around each epoch, as far as they count."""
    turn = (at.attitude * _before(at.attitude).conjugate()).positive().log()
    turn = jax.tree.map(lambda x: jnp.where(dt > 0, x, 0.0), turn)
    turn, dt = jax.tree.map(lambda x: x + jnp.concatenate([x[1:], 0.0 * x[:1]]), (turn, dt))
    return turn * jnp.where(dt > 0, 1.0 / jnp.where(dt > 0, dt, 1.0), 0.0)


def _within_half_a_turn(x: Any) -> Any:
    return jnp.arctan2(jnp.sin(x), jnp.cos(x))


def linearize(
    aids: tuple[AbstractAid, ...],
    names: Unknowns,
    fixes: tuple[Fix, ...],
    at: NominalTrajectory,
    q_n0n: Quat,
    dt: Float[Array, "K L"],
    on: Bool[Array, "K L"],
    unknowns: Float[Array, "c L"],
    steady: Vec3 | None = None,
) -> LinearMeasurements:
    """The measurements of all aids.

    Args:
        aids: of them.
        names: of the unknowns of each that are estimated.
        fixes: of each aid, components (K, L) or (K, 1).
        at: the trajectory.
        q_n0n: n at its epochs.
        dt: of the interval before each epoch, s; zero where it does not count.
        on: whether an epoch counts.
        unknowns: what is known so far of all unknowns.
        steady: (K, L) velocities without the part of their changes that is noise, m/s, n0; None: those of the
            trajectory.
    """
    shape, count = at.velocity.x.shape, STATES + len(unknowns)
    rate, time = _rate(at, dt), jnp.cumsum(dt, axis=0)
    velocity = at.velocity if steady is None else steady
    gap, slope, known = [], [], []
    for aid, fix, places in zip(aids, fixes, unknowns_of(aids, names), strict=True):
        numbers = {name: unknowns[where] for name, where in places.items()}
        own = {name: tuple(x) for name, x in numbers.items() if name not in ("latency", "slow")}
        said = _seen(aid, at, q_n0n, rate, time, velocity, named(own))
        predicted = said.predicted
        if steady is not None and said.velocity is not None:
            predicted = _predicted(aid, at, q_n0n, rate, time, named(own))
        change = [_change(aid, x, dt) for x in predicted] if "latency" in numbers else None
        for i, (value, there) in enumerate(zip(fix.value, fix.known, strict=True)):
            there = there & on
            rows = [jnp.zeros(shape)] * count
            if said.tilt is not None:
                rows[0:3] = _parts(said.tilt[i])
            if said.velocity is not None:
                row = said.velocity[i]
                rows[3:6] = _parts(row)
                if steady is not None:
                    more = row.cross(at.velocity - steady)
                    rows[0:3] = [a + b for a, b in zip(rows[0:3], _parts(more), strict=True)]
            for name, slopes in said.unknowns.items():
                begin = STATES + places[name].start
                rows[begin : begin + len(slopes[i])] = slopes[i]
            expected = predicted[i]
            if change is not None:
                expected = expected - numbers["latency"][0] * change[i]
                rows[STATES + places["latency"].start] = -change[i]
            if "slow" in numbers:
                expected = expected + numbers["slow"][i]
                rows[STATES + places["slow"].start + i] = jnp.ones(shape)
            off = value - expected
            gap.append(jnp.broadcast_to(_within_half_a_turn(off) if aid.periodic else off, shape))
            slope.append(jnp.stack([jnp.broadcast_to(x, shape) for x in rows], axis=1))
            known.append(jnp.broadcast_to(there, shape))
    there = jnp.stack(known, axis=1)
    gaps, slopes = jnp.stack(gap, axis=1), jnp.stack(slope, axis=1)
    return LinearMeasurements(jnp.where(there, gaps, 0.0), jnp.where(there[:, :, None], slopes, 0.0), there)


def _parts(v: Vec3) -> list[Any]:
    return [v.x, v.y, v.z]


def _motion(aid: AbstractAid, at: NominalTrajectory, q_n0n: Quat, rate: Vec3, time: Any, velocity: Vec3) -> Motion:
    if not aid.needs_north:
        return Motion(at.attitude, velocity, rate, time)
    back = q_n0n.conjugate()
    return Motion(back * at.attitude, back.rotate(velocity), back.rotate(rate), time)


def _seen(aid: Any, at: Any, q_n0n: Any, rate: Any, time: Any, velocity: Vec3, unknowns: Any) -> Linearized:
    """The prediction and its slopes, by tilt and velocity in n0."""
    said = aid.linearize(_motion(aid, at, q_n0n, rate, time, velocity), unknowns)
    if not aid.needs_north:
        return said
    tilt, speed = (None if rows is None else tuple(q_n0n.rotate(row) for row in rows) for rows in said[1:3])
    return said._replace(tilt=tilt, velocity=speed)


def _predicted(aid: Any, at: Any, q_n0n: Any, rate: Any, time: Any, unknowns: Any) -> tuple[Any, ...]:
    return as_components(aid, aid.predict(_motion(aid, at, q_n0n, rate, time, at.velocity), unknowns))


def _change(aid: AbstractAid, predicted: Any, dt: Any) -> Any:
    """How fast a component changes, over the interval before each epoch."""
    moved = dt > 0
    step = predicted - _before(predicted)
    if aid.periodic:
        step = _within_half_a_turn(step)
    return step * jnp.where(moved, 1.0 / jnp.where(moved, dt, 1.0), 0.0)
