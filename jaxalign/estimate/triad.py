"""Attitude from two pairs of directions."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxalign.rotation import quat_from_dcm
from jaxalign.vector import Quat, Vec3

__all__ = ["triad"]


def triad(alpha: Vec3, beta: Vec3, alpha2: Vec3, beta2: Vec3) -> tuple[Quat, Any]:
    """The C with ``C beta`` along ``alpha`` exactly and ``C beta2`` in the half-plane of ``alpha2``.

    Returns:
        The quaternion of C (the identity where undefined), and whether it is defined: neither pair of directions is
        parallel (to 1e-12 in the sine).

    Source: Black 1964; Xu 2017's comparison method.
    """

    def axes(first: Vec3, second: Vec3) -> tuple[Vec3, Vec3, Vec3, Any]:
        one = first.unit()
        normal = one.cross(second.unit())
        two = normal.unit()
        return one, two, one.cross(two), normal.norm2() > 1e-24

    a, b = axes(alpha, alpha2), axes(beta, beta2)
    outer = [x.outer(y) for x, y in zip(a[:3], b[:3], strict=True)]
    defined = a[3] & b[3]
    matrix = (outer[0] + outer[1] + outer[2]).array
    return Quat.of(quat_from_dcm(jnp.where(defined[..., None, None], matrix, jnp.eye(3)))), defined
