"""Schemes of preintegration that the papers, or frozen reference results, have: for ``preintegrate(scheme=...)``.

Each takes the samples of one interval (rad, m/s; first axis, the intervals are lanes) to its increment, in the notation
of :mod:`jaxalign.preintegration`.
"""

from __future__ import annotations

from collections.abc import Callable

import jax

from jaxalign.preintegration import Increment, integrated, pair
from jaxalign.vector import Quat, Vec3

__all__ = ["interval", "interval_plain", "pairs_series"]


def pairs_series(th: Vec3, dv: Vec3) -> Increment:
    """Pairs with V cut after th x (th x), as the frozen reference results of the swaying base have it.

    Args:
        th: rotation increments of two or more samples, rad.
        dv: their velocity increments, m/s.

    Raises:
        ValueError: a single sample.
    """
    if th.x.shape[0] < 2:
        raise ValueError("the scheme takes pairs: one sample is no pair")

    def turned(rotvec: Vec3, v: Vec3) -> Vec3:
        once = rotvec.cross(v)
        return v + once * 0.5 + rotvec.cross(once) * (1 / 6)

    return integrated(th, dv, turned)


def interval(th: Vec3, dv: Vec3) -> Increment:
    """The two-sample formula over the two halves of the whole interval, with the coning term.

    Args:
        th: rotation increments of an even number of samples, rad.
        dv: their velocity increments, m/s.

    Raises:
        ValueError: an odd number.

    Source: Wu 2013.
    """
    return _of_halves(pair, th, dv)


def interval_plain(th: Vec3, dv: Vec3) -> Increment:
    """The two-sample formula over two halves as printed: rotation as the plain sum, velocity to first order.

    A 10 deg sway at 0.15 Hz makes it drift by 35 deg in 300 s at 1 s intervals.

    Args:
        th: rotation increments of an even number of samples, rad.
        dv: their velocity increments, m/s.

    Raises:
        ValueError: an odd number.

    Source: Xu 2020 (15), (17).
    """

    def plain(th1: Vec3, dv1: Vec3, th2: Vec3, dv2: Vec3) -> Increment:
        th, dv = th1 + th2, dv1 + dv2
        return Increment(Quat.turn(th), dv + th.cross(dv) * 0.5 + (th1.cross(dv2) + dv1.cross(th2)) * (2 / 3))

    return _of_halves(plain, th, dv)


def _of_halves(formula: Callable[[Vec3, Vec3, Vec3, Vec3], Increment], th: Vec3, dv: Vec3) -> Increment:
    every = th.x.shape[0]
    half = every // 2
    if 2 * half != every:
        raise ValueError(f"the scheme halves the interval: {every} samples cannot be halved")
    first, second = (
        jax.tree.map(lambda x, a=a, b=b: x[a:b].sum(axis=0), (th, dv)) for a, b in ((0, half), (half, every))
    )
    whole = formula(*first, *second)
    return Increment(whole.rotation.unit(), whole.dvel)
