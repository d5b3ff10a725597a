"""Slopes of any aid by forward mode: a tangent for each number that the prediction depends on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from jaxalign.aids.linearized import Linearized
from jaxalign.aids.motion import Motion
from jaxalign.vector import Quat, Vec3

if TYPE_CHECKING:
    from jaxalign.aids.base import AbstractAid

__all__ = ["as_components", "forward_mode", "named"]


def as_components(aid: AbstractAid, predicted: Any) -> tuple[Any, ...]:
    """A prediction as a tuple of its components.

    Raises:
        ValueError: there are not as many as the aid has.
    """
    if isinstance(predicted, Vec3):
        parts = (predicted.x, predicted.y, predicted.z)
    else:
        parts = tuple(predicted) if isinstance(predicted, tuple | list) else (predicted,)
    if len(parts) != len(aid.components):
        raise ValueError(f"{aid.name}: predicts {len(parts)} components, has {len(aid.components)}")
    return parts


def named(numbers: dict[str, tuple[Any, ...]]) -> dict[str, Any]:
    """Unknowns as :meth:`AbstractAid.predict` wants them: a number, a Vec3 for three, else a tuple."""
    return {k: v[0] if len(v) == 1 else Vec3(*v) if len(v) == 3 else v for k, v in numbers.items()}


def forward_mode(aid: AbstractAid, motion: Motion, unknowns: dict[str, Any]) -> Linearized:
    """Prediction and slopes.

    Args:
        aid: any.
        motion: components of one shape.
        unknowns: of :func:`named`.
    """
    sizes = {name: aid.known_unknowns[name].size for name in unknowns}
    flat = {
        k: (v.x, v.y, v.z) if isinstance(v, Vec3) else v if isinstance(v, tuple) else (v,) for k, v in unknowns.items()
    }
    shape = jnp.broadcast_shapes(*(jnp.shape(x) for x in jax.tree.leaves((motion, flat))))
    zero, one = jnp.zeros(shape), jnp.ones(shape)
    numbers = [zero] * 6 + [x + zero for name in flat for x in flat[name]]

    def seen(*x: Any) -> tuple[Any, ...]:
        tilt, change, rest = Vec3(*x[:3]), Vec3(*x[3:6]), list(x[6:])
        own = {name: tuple(rest.pop(0) for _ in range(size)) for name, size in sizes.items()}
        turn = Quat.exp(tilt)
        moved = motion._replace(
            attitude=turn * motion.attitude, velocity=motion.velocity + change, rate=turn.rotate(motion.rate)
        )
        return tuple(y + zero for y in as_components(aid, aid.predict(moved, named(own))))

    predicted, along = jax.linearize(seen, *numbers)
    columns = [along(*(one if i == j else zero for j in range(len(numbers)))) for i in range(len(numbers))]
    rows = list(zip(*columns, strict=True))  # of each component
    slopes, begin = {}, 6
    for name, size in sizes.items():
        slopes[name] = tuple(row[begin : begin + size] for row in rows)
        begin += size
    tilt, velocity = (tuple(Vec3(*row[i : i + 3]) for row in rows) for i in (0, 3))
    return Linearized(predicted, tilt, velocity, slopes)
