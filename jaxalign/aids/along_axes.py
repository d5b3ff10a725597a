"""The slopes of a velocity along the axes of the vehicle, by hand."""

from __future__ import annotations

from typing import Any, TypeAlias

import jax.numpy as jnp

from jaxalign.aids.linearized import Linearized
from jaxalign.aids.motion import Motion
from jaxalign.vector import Vec3

__all__ = ["along_axes"]

Rows: TypeAlias = tuple[Vec3, Vec3, Vec3]


def along_axes(chosen: tuple[int, ...], motion: Motion, unknowns: dict[str, Any]) -> Linearized:
    """Some components in b of the velocity of a point of the vehicle, as a turned and scaled instrument has them.

    What the lever arm adds turns along with the vehicle: a tilt does not change it.

    Args:
        chosen: of right, forward and up the numbers.
        motion: of the vehicle.
        unknowns: scale, mounting and lever arm, as far as there are such.
    """
    axes = motion.axes
    lever, mounting, scale = (unknowns.get(name) for name in ("lever", "mounting", "scale"))
    # All that can be is computed in b, where it is few products: the axes differ from epoch to epoch.
    v = _in_b(motion.velocity, axes)
    if lever is not None:
        v = v + _in_b(motion.rate, axes).cross(lever)
    seen, rows = v, axes
    if mounting is not None:
        seen, rows = v - mounting.cross(v), _turned(mounting, axes)
    factor = 1.0 if scale is None else 1.0 + scale
    slopes: dict[str, Any] = {}
    if scale is not None:
        slopes["scale"] = tuple((_parts(seen)[i],) for i in chosen)
    if mounting is not None:
        slopes["mounting"] = tuple(_parts(_cross_matrix(v * factor)[i]) for i in chosen)
    if lever is not None:
        arm = _cross_matrix(_in_b(motion.rate, axes) * factor)
        arm = arm if mounting is None else _turned(mounting, arm)
        slopes["lever"] = tuple(_parts(arm[i]) for i in chosen)
    velocity = tuple(rows[i] * factor for i in chosen)
    predicted = tuple(_parts(seen)[i] * factor for i in chosen)
    return Linearized(predicted, tuple(row.cross(motion.velocity) for row in velocity), velocity, slopes)


def _parts(v: Vec3) -> tuple[Any, Any, Any]:
    return v.x, v.y, v.z


def _in_b(v: Vec3, axes: Rows) -> Vec3:
    return Vec3(*(axis.dot(v) for axis in axes))


def _cross_matrix(v: Vec3) -> Rows:
    """The rows of ``[v x]``."""
    zero = jnp.zeros_like(v.x)
    return Vec3(zero, -v.z, v.y), Vec3(v.z, zero, -v.x), Vec3(-v.y, v.x, zero)


def _turned(angle: Vec3, rows: Rows) -> Rows:
    """The rows of ``(I - [angle x]) M`` from those of M."""
    a, b, c = rows
    return (
        a + b * angle.z - c * angle.y,
        b + c * angle.x - a * angle.z,
        c + a * angle.y - b * angle.x,
    )
