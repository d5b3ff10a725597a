"""A weight that a small network gives, trained by gradient through the recursion."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from jaxalign import Aligner
from jaxalign.estimate import AbstractEstimate
from jaxalign.observe import BodyVelocityVectors, Context, Pair
from jaxalign.simulate import Scenario
from jaxalign.tune import Tune, Tuned, run
from jaxalign.weight import AbstractWeight

__all__ = ["LearnedWeight", "learn"]

WIDTH = 8
TRUST = 3.0  # before it has learned anything the weight is sigmoid(3) = 0.95


class LearnedWeight(AbstractWeight):
    """A network of what Huber's weight and Mahalanobis distances look at, to a weight in (0, 1).

    It sees ``ln(1 + r)`` of the residual's size and of the misfit in length, both in standard deviations of the pair,
    and whether there is an attitude yet (if not, the residual counts as zero).
    """

    net: eqx.nn.MLP

    def __init__(self, key: PRNGKeyArray):
        net = eqx.nn.MLP(3, "scalar", WIDTH, 2, jax.nn.tanh, dtype=jnp.float64, key=key)
        last = net.layers[-1]
        put = last.weight * 0.1, jnp.full_like(last.weight[:, 0], TRUST)
        self.net = eqx.tree_at(lambda n: (n.layers[-1].weight, n.layers[-1].bias), net, put)

    def init(self) -> Any:
        """No state."""
        return None

    def weight(self, residual: Any, misfit: Any, defined: Any) -> Any:
        """Of sizes in standard deviations of the pair."""
        known = jnp.where(defined, 1.0, 0.0)
        return jax.nn.sigmoid(self.net(jnp.stack([known * jnp.log1p(residual), jnp.log1p(misfit), known])))

    def step(self, state: Any, context: Context, pair: Pair) -> tuple[Any, Any]:
        """Weigh one pair."""
        sd = jnp.sqrt(2.0) * context.sd
        misfit = jnp.abs(pair.beta.norm() - pair.alpha.norm())
        return state, self.weight(pair.residual(context.attitude).norm() / sd, misfit / sd, context.defined)


def learn(made: Scenario, estimate: AbstractEstimate, runs: int, steps: int, seed: int) -> Tuned:
    """Train the network on simulated runs: the smallest mean logarithm of a run's heading RMSE."""
    start = Aligner(BodyVelocityVectors(), weight=LearnedWeight(jax.random.key(seed)), estimate=estimate)
    how = {"runs": runs, "held_out": runs, "steps": steps, "rate": 0.03, "seed": seed, "patience": 0}
    return run(Tune(made, start, ["weight.net"], "log-rmse", **how))
