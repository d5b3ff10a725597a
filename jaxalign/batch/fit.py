"""Attitude and figures together: Gauss-Newton steps alternate with steps of Fisher scoring, from several starts.

Lanes are starts of one record, or rows of it. One compiled step serves all phases: windows that grow, the fit, rows.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.batch.figures import Beliefs, Layout, applied, least_figures
from jaxalign.batch.problem import Model, Problem, Readout, State
from jaxalign.batch.scoring import held_noise, score
from jaxalign.batch.solver import advance, linearize_problem, with_steady

__all__ = ["FIT", "HOLD", "SETTLE", "Fitted", "fit_step"]

SETTLE, FIT, HOLD = 0, 1, 2
"""Phases: the noise of the aids by the median of the misfits, other figures held; all figures fitted; all held."""


class Fitted(eqx.Module):
    """Between two steps.

    Attributes:
        state: trajectory, unknowns and noise.
        theta: (p, L) figures.
    """

    state: State
    theta: Float[Array, "p L"]


def fit_step(
    model: Model, belief: Beliefs, problem: Problem, fitted: Fitted, phase: Any, final: Any
) -> tuple[Fitted, Readout]:
    """One Gauss-Newton step with the figures as they are, then, where they are fitted, one step of scoring.

    Args:
        model: what is known but for the figures; ``aid_noise`` "held".
        belief: what is believed of them.
        problem: fixes.
        fitted: from the step before.
        phase: :data:`SETTLE`, :data:`FIT` or :data:`HOLD`.
        final: it is read out after this one.
    """
    layout = Layout.of(model)
    early = jnp.broadcast_to(phase == SETTLE, fitted.state.early.shape)
    moving = fitted.state.moving | (phase != HOLD)
    state = with_steady(dataclasses.replace(fitted.state, early=early, moving=moving), final)
    own = applied(model, belief, fitted.theta)
    linear = linearize_problem(own, problem, state)
    new, read = advance(own, problem, state, linear, phase != SETTLE, final)
    found = jnp.maximum(_noise_found(new, layout, fitted.theta), least_figures(belief, layout))
    theta = jax.lax.cond(
        phase == FIT,
        lambda: score(model, belief, problem, state, linear, fitted.theta)[0],
        lambda: jnp.where(phase == SETTLE, found, fitted.theta),
    )
    return Fitted(held_noise(new, layout, theta), theta), read


def _noise_found(state: State, layout: Layout, theta: Any) -> Any:
    """The figures with the noise of the aids that a state has."""
    for one, j in zip(state.noise, layout.noise, strict=True):
        theta = theta.at[j].set(0.5 * jnp.log(one.variance))
    return theta
