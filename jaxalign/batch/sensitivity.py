"""How innovations depend on the figures: a Kalman filter that carries the derivatives of its covariance along.

Of all that a filter is given only the noise (of the process, the measurements, the prior) depends on a figure. So the
derivatives obey recursions of their own, which are written out here: by forward mode XLA's kernels, which have one
output each, would compute what they share again and again (fifty times as slow). Numbers that many need end in a
division or a root, which it computes once.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.batch.rows import over_rows
from jaxalign.batch.smoother import LinearProblem, moved
from jaxalign.batch.trajectory import STATES

__all__ = ["NoiseSlopes", "Score", "score_of_innovations"]


class NoiseSlopes(eqx.Module):
    """Derivatives of the noise by p figures, of which the first axis but one from the end has them.

    Attributes:
        motion: (K, 6, 6, q, L) of the process noise of tilt and velocity, by some of the figures.
        by: the numbers (q) of those figures.
        others: (K, n - 6, p, L) of that of the other states.
        variance: (K, m, p, L) of the measurements.
        prior_variance: (n, p, L).
        prior_mean: (n, p, L).
    """

    motion: Float[Array, "K 6 6 q L"]
    others: Float[Array, "K m p L"]
    variance: Float[Array, "K m p L"]
    prior_variance: Float[Array, "n p L"]
    prior_mean: Float[Array, "n p L"]
    by: tuple[int, ...] = eqx.field(static=True)


class Score(eqx.Module):
    """Of the log-likelihood of the innovations.

    Attributes:
        slope: (p, L) gradient.
        curve: (p, p, L) what its curvature is expected to be, positive.
    """

    slope: Float[Array, "p L"]
    curve: Float[Array, "p p L"]


def _row(row: Any, fade: Any, x: Any) -> Any:
    """State or covariance columns (n, ..., L) over an interval."""
    shape = (len(fade), *[1] * (x.ndim - 2), fade.shape[-1])
    return jnp.concatenate([moved(row, x), x[6:STATES], x[STATES:] * fade.reshape(shape)])


def score_of_innovations(problem: LinearProblem, slopes: NoiseSlopes) -> Score:
    """``sum[-z de/sqrt(S) + (z^2 - 1)/2 dS/S]`` and ``sum[de de'/S + dS dS'/(2 S^2)]``, components one by one."""
    count = slopes.others.shape[2]
    lanes = problem.gap.shape[-1]
    prior = problem.prior
    n = len(prior.mean)
    by = jnp.asarray(slopes.by)

    def step(carry: Any, row: Any) -> Any:
        x, p, dx, dp, slope, curve = carry
        interval, process, gap, h, variance, used, dmotion, dothers, dvariance = row
        fade = process.fade
        x = _row(interval, fade, x)
        x = jnp.concatenate([x[:STATES] + interval.defect, x[STATES:]])
        p = _row(interval, fade, jnp.swapaxes(_row(interval, fade, p), 0, 1))
        p = p.at[:6, :6].add(process.motion) + _diagonal(6, process.others)
        dx = _row(interval, fade, dx)
        dp = _row(interval, fade, jnp.swapaxes(_row(interval, fade, dp), 0, 1))
        dp = dp.at[:6, :6, by].add(dmotion) + _diagonal(6, dothers)
        for i in range(len(gap)):
            hi = h[i]
            g = jnp.sum(p * hi[None], axis=1)
            dg = jnp.sum(dp * hi[None, :, None], axis=1)
            root = jnp.sqrt(jnp.sum(g * hi, axis=0) + variance[i])
            rel = (jnp.sum(dg * hi[:, None], axis=0) + dvariance[i]) / (root * root)
            c = g / root
            z = (gap[i] - jnp.sum(hi * x, axis=0)) / root
            y = -jnp.sum(hi[:, None] * dx, axis=0) / root
            dc = dg / root - 0.5 * c[:, None] * rel
            dz = y - 0.5 * z * rel
            x = x + c * z
            dx = dx + dc * z + c[:, None] * dz
            p = p - c[:, None] * c[None]
            dp = dp - dc[:, None] * c[None, :, None] - c[:, None, None] * dc[None]
            there = used[i]
            slope = slope + jnp.where(there, -z * y + 0.5 * (z * z - 1.0) * rel, 0.0)
            curve = curve + jnp.where(there, y[:, None] * y[None] + 0.5 * rel[:, None] * rel[None], 0.0)
        return (x, p, dx, dp, slope, curve), None

    start = (
        prior.mean,
        _diagonal(0, prior.variance),
        slopes.prior_mean,
        _diagonal(0, slopes.prior_variance),
        jnp.zeros((count, lanes)),
        jnp.zeros((count, count, lanes)),
    )
    rows = (
        problem.intervals,
        problem.process,
        problem.gap,
        problem.slope,
        problem.variance,
        problem.used,
        slopes.motion,
        slopes.others,
        slopes.variance,
    )
    assert start[1].shape == (n, n, lanes)
    last, _ = over_rows(step, start, rows, problem.length, lambda: None)
    return Score(last[-2], last[-1])


def _diagonal(begin: int, x: Any) -> Any:
    """(n, n, ..., L) with these numbers (n - begin, ..., L) on the diagonal behind the first ones."""
    full = jnp.concatenate([jnp.zeros((begin, *x.shape[1:])), x])
    unit = jnp.eye(len(full)).reshape(len(full), len(full), *[1] * (x.ndim - 1))
    return unit * full[:, None]
