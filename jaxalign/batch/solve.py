"""The solution of a linear problem, with derivatives that need none of the covariance recursion.

Errors, costates and pulls solve a linear system. How they change with the numbers of that system is the solution of
the same system for other right-hand sides, with the gains that the filter has left: a pass forward, one backward, one
forward. What depends on the covariance itself (:class:`jaxalign.batch.smoother.Filtered`) is differentiated through
the filter, if anybody asks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.batch.smoother import (
    Filtered,
    LinearProblem,
    Smoothed,
    filter_forward,
    process_noise_effect,
    propagate,
    propagate_transposed,
    smooth_backward,
)
from jaxalign.batch.trajectory import STATES

__all__ = ["solve_linear"]


class _Sides(NamedTuple):
    """Right-hand sides: of the prior, the intervals, the measurements, and of the costates (prior, epochs)."""

    prior: Float[Array, "n L"]
    interval: Float[Array, "K n L"]
    measured: Float[Array, "K m L"]
    before: Float[Array, "n L"]
    costate: Float[Array, "K n L"]


def _sides(problem: LinearProblem, at: Smoothed) -> _Sides:
    """What the equations of the system say at a solution: its tangents are the right-hand sides of the derivative."""
    intervals, process, fade = problem.intervals, problem.process, problem.process.fade
    earlier = jnp.concatenate([at.first[None], at.error[:-1]])
    defect = jnp.concatenate([intervals.defect, jnp.zeros_like(at.error[:, STATES:])], axis=1)
    interval = (
        jax.vmap(propagate)(intervals, fade, earlier) + defect + jax.vmap(process_noise_effect)(process, at.costate)
    )
    measured = problem.gap - jnp.sum(problem.slope * at.error[:, None], axis=2) - problem.variance * at.pull
    pulled = jnp.sum(problem.slope * at.pull[:, :, None], axis=1)
    handed = jax.vmap(propagate_transposed)(intervals, fade, at.costate)
    costate = pulled + jnp.concatenate([handed[1:], jnp.zeros_like(handed[:1])])
    prior = problem.prior.mean + problem.prior.variance * at.before
    return _Sides(prior, interval, measured, handed[0], costate)


def _response(problem: LinearProblem, kept: Filtered, sides: _Sides) -> tuple[Any, Any]:
    """Errors (K, n, L) and pulls (K, m, L) for these right-hand sides. Linear in them."""
    variance = problem.prior.variance

    def times(gain: Any, v: Any) -> Any:
        return jnp.sum(gain * v[None], axis=1)

    def forward(x: Any, row: Any) -> Any:
        interval, fade, slope, r, gain, p, side, measured, costate = row
        x = propagate(interval, fade, x) + side
        v = measured - jnp.sum(slope * x[None], axis=1)
        x = x + times(gain, v)
        left = (v - jnp.sum(slope * times(gain, v)[None], axis=1)) / r
        return x + jnp.sum(p * costate[None], axis=1), left

    fade = problem.process.fade
    rows = (problem.intervals, fade, problem.slope, problem.variance, kept.gain, kept.covariance)
    start = sides.prior + variance * sides.before
    _, left = jax.lax.scan(forward, start, (*rows, sides.interval, sides.measured, sides.costate))

    def backward(r: Any, row: Any) -> Any:
        interval, fade, slope, gain, left, costate = row
        r = r + costate
        u = left - jnp.sum(gain * r[:, None], axis=0)
        r = r + jnp.sum(slope * u[:, None], axis=0)
        return propagate_transposed(interval, fade, r), (r, u)

    rows = (problem.intervals, fade, problem.slope, kept.gain, left, sides.costate)
    before, (costate, pull) = jax.lax.scan(backward, jnp.zeros_like(start), rows, reverse=True)

    def again(x: Any, row: Any) -> Any:
        interval, process, costate, side = row
        x = propagate(interval, process.fade, x) + side + process_noise_effect(process, costate)
        return x, x

    first = sides.prior + variance * (before + sides.before)
    error = jax.lax.scan(again, first, (problem.intervals, problem.process, costate, sides.interval))[1]
    return error, pull


@jax.custom_jvp
def solve_linear(problem: LinearProblem) -> tuple[Filtered, Float[Array, "K n L"], Float[Array, "K m L"]]:
    """What the filter leaves, the errors at every epoch, and the noise of each measurement by all measurements."""
    found = filter_forward(problem)
    at = smooth_backward(problem, found)
    return found, at.error, problem.variance * at.pull


@solve_linear.defjvp
def _solve_linear_jvp(primals: Any, tangents: Any) -> Any:
    (problem,), (moved,) = primals, tangents
    kept = jax.lax.stop_gradient(filter_forward(problem, keep=True))
    at = jax.lax.stop_gradient(smooth_backward(problem, kept))
    found, changed = jax.jvp(filter_forward, (problem,), (moved,))
    _, sides = jax.jvp(lambda p: _sides(p, at), (problem,), (moved,))
    error, pull = _response(jax.lax.stop_gradient(problem), kept, sides)
    noise = problem.variance * pull + moved.variance * at.pull
    return (found, at.error, problem.variance * at.pull), (changed, error, noise)
