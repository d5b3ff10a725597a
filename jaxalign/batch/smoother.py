"""Kalman filter, disturbance smoother and a pass forward over the errors of a trajectory: one Gauss-Newton step.

The backward pass carries no covariance: it gives the start, the noise of each interval and that of each measurement
by all of them; the pass forward makes the errors of all epochs of these.

Source: Durbin and Koopman, Time Series Analysis by State Space Methods, (4.3) and (4.58)-(4.69).
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.batch.rows import over_rows
from jaxalign.batch.trajectory import ACCEL, GYRO, STATES, TILT, VELOCITY, Intervals

__all__ = [
    "Filtered",
    "LinearProblem",
    "Prior",
    "Process",
    "Smoothed",
    "cross_rows",
    "filter_forward",
    "moved",
    "process_noise_effect",
    "propagate",
    "propagate_transposed",
    "smooth_backward",
    "times",
]


class Prior(eqx.Module):
    """Errors at the first epoch before its measurement.

    Attributes:
        mean: (n, L).
        variance: (n, L).
    """

    mean: Float[Array, "n L"]
    variance: Float[Array, "n L"]


class Process(eqx.Module):
    """What happens to the errors over an interval beside the motion.

    Attributes:
        motion: (K, 6, 6, L) covariance of what the white noise of the unit does to tilt and velocity.
        others: (K, n - 6, L) variance that the other states gain.
        fade: (K, n - 12, L) factor of the unknowns of the aid: one for constants.
    """

    motion: Float[Array, "K 6 6 L"]
    others: Float[Array, "K m L"]
    fade: Float[Array, "K c L"]


class LinearProblem(eqx.Module):
    """Errors of a trajectory and measurements of them, ``gap = slope x + noise``.

    Attributes:
        intervals: of the trajectory.
        process: noise.
        gap: (K, m, L) measured minus nominal; zero where there is none.
        slope: (K, m, n, L); zero where there is no measurement.
        variance: (K, m, L) of the noise; any positive number where there is no measurement.
        used: (K, m, L) where there is one.
        prior: of the first errors.
        length: of the rows that are looked at, see :func:`jaxalign.batch.rows.over_rows`; None: of all.
    """

    intervals: Intervals
    process: Process
    gap: Float[Array, "K m L"]
    slope: Float[Array, "K m n L"]
    variance: Float[Array, "K m L"]
    used: Bool[Array, "K m L"]
    prior: Prior
    length: Any = None


class Filtered(eqx.Module):
    """What the filter leaves.

    Attributes:
        mean: (n, L) errors at the last epoch; (K, n, L) where all were kept.
        covariance: (n, n, L) or (K, n, n, L) of them.
        innovation: (K, m, L) over its covariance.
        gain: (K, n, m, L).
        log_likelihood: (L,) of all measurements, but for a constant.
    """

    mean: Float[Array, "*K n L"]
    covariance: Float[Array, "*K n n L"]
    innovation: Float[Array, "K m L"]
    gain: Float[Array, "K n m L"]
    log_likelihood: Float[Array, " L"]


def times(m: Any, rows: Any) -> Any:
    """A 3x3 matrix (3, 3, L) times three rows (3, ..., L): sums that fuse, where a dot of this size would not."""
    shape = (3, *[1] * (rows.ndim - 2), m.shape[-1])
    return _dot([x.reshape(shape) for x in _apart(m, 1)], _apart(rows))


def cross_rows(v: Any, rows: Any) -> Any:
    """``[v x]`` times three rows."""
    (x, y, z), (a, b, c) = _apart(v), _apart(rows)
    return jnp.stack([y * c - z * b, z * a - x * c, x * b - y * a])


def moved(row: Intervals, x: Any) -> Any:
    """Tilt and velocity (6, ..., L) after an interval; x (12 or more, ..., L) before it."""
    tilt = x[TILT] - times(row.turned, x[GYRO])
    carried = x[VELOCITY] - cross_rows(row.gained, x[TILT]) - cross_rows(row.spin, x[VELOCITY])
    return jnp.concatenate([tilt, carried + times(row.coupled, x[GYRO]) - times(row.turned, x[ACCEL])])


def propagate(row: Intervals, fade: Any, x: Float[Array, "n L"]) -> Float[Array, "n L"]:
    """Errors at the epoch of a row from those at the one before it, without its defect."""
    return jnp.concatenate([moved(row, x), x[6:STATES], x[STATES:] * fade])


def propagate_transposed(row: Intervals, fade: Any, r: Float[Array, "n L"]) -> Float[Array, "n L"]:
    """The transpose of :func:`propagate`."""
    turned, coupled = (jnp.swapaxes(m, 0, 1) for m in (row.turned, row.coupled))
    t, v = r[TILT], r[VELOCITY]
    tilt = t + cross_rows(row.gained, v)
    velocity = v + cross_rows(row.spin, v)
    gyro = r[GYRO] - times(turned, t) + times(coupled, v)
    return jnp.concatenate([tilt, velocity, gyro, r[ACCEL] - times(turned, v), r[STATES:] * fade])


def _propagated(row: Intervals, process: Process, p: Any) -> Any:
    """Covariance (n, n, L) after an interval: only its first six rows and columns are new, but for what fades."""
    ones = jnp.ones((STATES - 6, 1))
    fade = jnp.concatenate([jnp.broadcast_to(ones, (STATES - 6, process.fade.shape[-1])), process.fade])
    top = moved(row, p)
    corner = moved(row, jnp.swapaxes(top[:, :STATES], 0, 1)) + process.motion
    side = top[:, 6:] * fade
    rest = p[6:, 6:] * fade[:, None] * fade[None] + jnp.eye(len(fade))[:, :, None] * process.others[:, None]
    return jnp.concatenate(
        [jnp.concatenate([corner, side], axis=1), jnp.concatenate([jnp.swapaxes(side, 0, 1), rest], axis=1)]
    )


def _apart(x: Any, axis: int = 0) -> list[Any]:
    """The slices of an array along an axis: taken once, and without the detours of indexing, they are traced faster."""
    return [jax.lax.index_in_dim(x, i, axis, keepdims=False) for i in range(x.shape[axis])]


def _dot(a: list[Any], b: list[Any]) -> Any:
    """Sum of the products."""
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def _updated(x: Any, p: Any, gap: Any, slope: Any, variance: Any, used: Any) -> Any:
    """Take in the m components of the measurements of one epoch together.

    With ``S = H P H' + R = L D L'`` the components are made independent, which needs no inverse.
    """
    m = len(gap)
    h, columns, gap, state = [_apart(row) for row in _apart(slope)], _apart(p, 1), _apart(gap), _apart(x)
    across = [_dot(columns, h[i]) for i in range(m)]
    parts = [_apart(g) for g in across]
    spread = [[_dot(h[k], parts[i]) for k in range(i + 1)] for i in range(m)]
    surprise = [gap[i] - _dot(h[i], state) for i in range(m)]
    noise = _apart(variance)
    size: list[Any] = []
    lower: list[list[Any]] = []
    for i in range(m):
        row: list[Any] = []
        for k in range(i):
            row.append((spread[i][k] - sum(row[j] * lower[k][j] * size[j] for j in range(k))) / size[k])
        lower.append(row)
        size.append(spread[i][i] + noise[i] - sum(row[k] ** 2 * size[k] for k in range(i)))
        for k in range(i):
            across[i] = across[i] - row[k] * across[k]
            surprise[i] = surprise[i] - row[k] * surprise[k]
    gain = [g / s for g, s in zip(across, size, strict=True)]
    innovation = [e / s for e, s in zip(surprise, size, strict=True)]
    x = x + sum(g * e for g, e in zip(across, innovation, strict=True))
    p = p - sum(k[:, None] * g[None] for k, g in zip(gain, across, strict=True))
    terms = (e * u + jnp.log(s) for e, u, s in zip(innovation, surprise, size, strict=True))
    fit = sum(jnp.where(there, term, 0.0) for there, term in zip(_apart(used), terms, strict=True))
    for i in reversed(range(m)):  # back from the independent components
        for j in range(i + 1, m):
            gain[i] = gain[i] - lower[j][i] * gain[j]
            innovation[i] = innovation[i] - lower[j][i] * innovation[j]
    return x, p, jnp.stack(innovation), jnp.stack(gain, axis=1), fit


def filter_forward(problem: LinearProblem, keep: bool = False) -> Filtered:
    """Run the Kalman filter forward.

    Args:
        problem: with the defects of the trajectory as known inputs.
        keep: mean and covariance at all epochs, else only at the last.
    """
    lanes = problem.gap.shape[-1]

    def step(carry: Any, row: Any) -> Any:
        x, p, likelihood = carry
        interval, process, gap, slope, variance, used = row
        x = propagate(interval, process.fade, x)
        x = jnp.concatenate([x[:STATES] + interval.defect, x[STATES:]])
        p = _propagated(interval, process, p)
        x, p, innovation, gain, fit = _updated(x, p, gap, slope, variance, used)
        return (x, p, likelihood - 0.5 * fit), ((x, p) if keep else None, innovation, gain)

    prior = problem.prior
    start = (prior.mean, jnp.eye(len(prior.mean))[:, :, None] * prior.variance[:, None], jnp.zeros(lanes))
    rows = (problem.intervals, problem.process, problem.gap, problem.slope, problem.variance, problem.used)

    def like() -> Any:
        gap = problem.gap[0]
        return (start[:2] if keep else None), gap, jnp.zeros((len(prior.mean), *gap.shape))

    last, (kept, innovation, gain) = over_rows(step, start, rows, problem.length, like)
    mean, covariance = kept if keep else last[:2]
    return Filtered(mean, covariance, innovation, gain, last[2])


class Smoothed(eqx.Module):
    """Errors, noise and the costate by all measurements.

    Attributes:
        first: (n, L) errors before the first interval.
        error: (K, n, L) at every epoch.
        costate: (K, n, L) ``Q costate`` is what the noise of an interval has done.
        before: (n, L) costate of the prior.
        pull: (K, m, L) ``R pull`` is the noise of a measurement.
    """

    first: Float[Array, "n L"]
    error: Float[Array, "K n L"]
    costate: Float[Array, "K n L"]
    before: Float[Array, "n L"]
    pull: Float[Array, "K m L"]


def process_noise_effect(process: Process, costate: Any) -> Any:
    """``Q costate``, (n, L)."""
    motion = _dot(_apart(process.motion, 1), _apart(costate[:6]))
    return jnp.concatenate([motion, process.others * costate[6:]])


def smooth_backward(problem: LinearProblem, found: Filtered) -> Smoothed:
    """Errors, noise and costates by all measurements: a pass backward and one forward."""
    process, prior = problem.process, problem.prior

    def backward(r: Any, row: Any) -> Any:
        interval, process, slope, innovation, gain = row
        u = innovation - jnp.sum(gain * r[:, None], axis=0)
        r = r + jnp.sum(slope * u[:, None], axis=0)
        return propagate_transposed(interval, process.fade, r), (r, u)

    rows = (problem.intervals, process, problem.slope, found.innovation, found.gain)
    none = jnp.zeros_like(prior.mean)
    like, length = (lambda: (none, problem.gap[0])), problem.length
    before, (costate, pull) = over_rows(backward, none, rows, length, like, reverse=True)

    def forward(x: Any, row: Any) -> Any:
        interval, process, costate = row
        x = propagate(interval, process.fade, x) + process_noise_effect(process, costate)
        x = jnp.concatenate([x[:STATES] + interval.defect, x[STATES:]])
        return x, x

    first = prior.mean + prior.variance * before
    error = over_rows(forward, first, (problem.intervals, process, costate), length, lambda: first)[1]
    return Smoothed(first, error, costate, before, pull)
