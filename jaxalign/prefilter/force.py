"""The specific force of an inertial record, filtered."""

from __future__ import annotations

from typing import get_args

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxalign.arguments import check_choice
from jaxalign.errors import UserError
from jaxalign.prefilter.base import AbstractPrefilter, Frame
from jaxalign.preintegration import middle_attitudes
from jaxalign.vector import Vec3

__all__ = ["filtered_force"]


def filtered_force(
    prefilter: AbstractPrefilter, dtheta: Float[ArrayLike, "n 3"], dvel: Float[ArrayLike, "n 3"], dt: float
) -> Float[Array, "n 3"]:
    """Velocity increments (m/s, b) with their disturbance filtered away; pure.

    In the frame "inertial" each increment is turned into b at the start of the record by the gyros, at the middle of
    its sample, filtered there, and turned back: on a base that rocks the force in b moves with the tilt, and a filter
    in b would take that motion for a disturbance.

    Args:
        prefilter: the filter.
        dtheta: rotation increments, rad, b.
        dvel: velocity increments, m/s, b.
        dt: sampling interval, s.

    Raises:
        UserError: fewer than four samples, or an unknown frame.
    """
    dtheta, dvel = jnp.asarray(dtheta), jnp.asarray(dvel)
    if len(dvel) < 4:
        raise UserError(f"a prefilter needs at least 4 samples, the record has {len(dvel)}")
    check_choice("frame", prefilter.frame, get_args(Frame))
    if prefilter.frame != "inertial":
        return prefilter(dvel, dt)
    q = middle_attitudes(Vec3.of(dtheta))
    still = prefilter(q.rotate(Vec3.of(dvel)).array, dt)
    return q.conjugate().rotate(Vec3.of(still)).array
