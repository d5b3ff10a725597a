"""One step of Fisher scoring: figures of the unit and of the aids by the innovations of the filter.

The trajectory and the weights of the fixes are held. What is believed beforehand counts as in a posterior.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.batch.figures import WHITE, Beliefs, Layout, applied, least_figures, log_prior
from jaxalign.batch.measurement import parts_of, unknowns_of
from jaxalign.batch.problem import AidNoise, Model, Problem, State
from jaxalign.batch.sensitivity import NoiseSlopes, score_of_innovations
from jaxalign.batch.smoother import LinearProblem
from jaxalign.batch.solver import motion_noise, prior_of
from jaxalign.batch.trajectory import STATES, VELOCITY
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors
from jaxalign.linear import solve_positive

__all__ = ["held_noise", "noise_slopes", "score"]

_MOST = 1.0  # of a logarithm, in one step
_RIDGE = 1e-9
_NONE = np.zeros((1, 1))


def held_noise(state: State, layout: Layout, theta: Float[Array, "p L"]) -> State:
    """With the noise of the aids that the figures say."""
    noise = tuple(
        AidNoise(one.weight, jnp.exp(2 * theta[j]), jnp.ones_like(one.times))
        for one, j in zip(state.noise, layout.noise, strict=True)
    )
    return dataclasses.replace(state, noise=noise)


def score(
    model: Model, belief: Beliefs, problem: Problem, state: State, linear: LinearProblem, theta: Float[Array, "p L"]
) -> tuple[Float[Array, "p L"], Float[Array, "p p L"]]:
    """Figures after one step, and the curvature at those before it (expected, of likelihood and prior).

    Args:
        model: what is known but for the figures.
        belief: what is believed of them.
        problem: fixes.
        state: that the linear problem is of, its noise as the figures say.
        linear: of it and the figures.
        theta: figures.
    """
    layout = Layout.of(model)
    found = score_of_innovations(linear, noise_slopes(model, belief, problem, state, linear, layout, theta))
    _, pull, curve = log_prior(belief, layout, theta)
    free = 1.0 - belief.fixed
    slope = (found.slope + pull) * free[:, None]
    curve = (found.curve + curve) * (free[:, None] * free[None])[:, :, None]
    curve = curve + jnp.diag(belief.fixed + _RIDGE)[:, :, None]
    move = solve_positive(jnp.moveaxis(curve, -1, 0), slope.T[..., None])[..., 0].T
    move = jnp.clip(move, -_MOST, _MOST)
    return jnp.maximum(theta + move, least_figures(belief, layout)), curve


def noise_slopes(
    model: Model,
    belief: Beliefs,
    problem: Problem,
    state: State,
    linear: LinearProblem,
    layout: Layout,
    theta: Any,
) -> NoiseSlopes:
    """How all noise depends on the figures: a variance by the logarithm of its deviation is twice itself.

    What is believed of the first velocity is held.
    """
    imu, count = applied(model, belief, theta).imu, layout.size
    without = (
        ImuErrors(GyroErrors(walk_deg_sqrt_h=imu.gyro.walk_deg_sqrt_h), AccelErrors(density_ug_sqrt_hz=_NONE)),
        ImuErrors(GyroErrors(walk_deg_sqrt_h=_NONE), AccelErrors(density_ug_sqrt_hz=imu.accel.density_ug_sqrt_hz)),
    )
    motion = jnp.stack([2.0 * motion_noise(one, linear.intervals) for one in without], axis=-2)

    others = np.zeros((linear.process.others.shape[1], count))
    others[0:3, 4] = others[3:6, 5] = 2.0
    for places, slow in zip(unknowns_of(model.aids, model.unknown), layout.slow, strict=True):
        if slow is not None:
            where = places["slow"]
            others[STATES - 6 + where.start : STATES - 6 + where.stop, slow] = 2.0
    measured = np.zeros((linear.variance.shape[1], count))
    for part, noise in zip(parts_of(model.aids), layout.noise, strict=True):
        measured[part, noise] = 2.0

    def prior(theta: Any) -> Any:
        found = prior_of(applied(model, belief, theta), problem, state)
        return found.variance.at[VELOCITY].set(0.0), found.mean

    def along(one: Any) -> Any:
        return jax.jvp(prior, (theta,), (one[:, None] * jnp.ones_like(theta),))[1]

    first = jax.vmap(along, out_axes=1)(jnp.eye(count))
    return NoiseSlopes(
        motion,
        linear.process.others[:, :, None] * others[:, :, None],
        linear.variance[:, :, None] * measured[:, :, None],
        *first,
        by=WHITE,
    )
