"""Derivatives of a whole alignment, by its data and its tunable numbers: two programs for all tests of a recipe."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from problems import EPOCHS, epochs_of, log_of, sparse, velocities

from jaxalign import Quat, Vec3, parameters
from jaxalign.methods import build
from jaxalign.parametrization import tunables, with_parameters
from jaxalign.rotation import quat_from_dcm

WEIGHTS = (0.3, -0.5, 1.0)  # of the three angles at the end
LOST = 20  # an epoch without a fix
LOSSES = ("end", "rows", "defined")


@functools.cache
def _programs(name: str, aid: str, chosen: tuple):
    method = build(name, aid, dict(chosen))
    paths = list(tunables(method))

    def loss(x, velocity, numbers, epochs, direction, reference, share):
        """By x: velocities (along a direction), latitude, what stands in a lost fix, logarithms of the numbers."""
        changed = with_parameters(method, dict(zip(paths, numbers * jnp.exp(x[3:]), strict=True)))
        rows = epochs.rows
        if aid != "static":
            valid = jnp.isfinite(velocity).all(axis=1)
            moved = jnp.where(valid[:, None], velocity + x[0] * direction, 0.0)
            moved = moved.at[LOST, 0].add(jnp.where(valid[LOST], 0.0, x[2]))
            rows = rows.with_velocity(Vec3.of(moved), valid)
        epochs = eqx.tree_at(lambda e: (e.rows, e.site.lat), epochs, (rows, epochs.site.lat + x[1]))
        found = changed.solve(epochs, sparse(name))
        attitudes = Quat.of(found.q_nb)
        last = (Quat.of(found.q_nb[-1]) * Quat.of(reference)).log().array
        parts = {
            "end": jnp.dot(jnp.array(WEIGHTS), last),
            "rows": jnp.sum(attitudes.log().array ** 2),
            "defined": jnp.sum(jnp.where(found.defined, attitudes.z, 0.0)),
        }
        return sum(share[i] * parts[key] for i, key in enumerate(LOSSES)), found.eigengap[-1]

    def along(x, towards, *rest):
        return jax.jvp(lambda x: loss(x, *rest), (x,), (towards,), has_aux=True)[1]

    reverse = jax.jit(jax.value_and_grad(loss, argnums=(0, 1), has_aux=True))
    # Of a search a value costs more than to compile it by itself.
    alone = jax.jit(lambda *args: loss(*args)[0]) if method.rows_are_costly else None
    value = alone or (lambda *args: reverse(*args)[0][0])
    return reverse, jax.jit(along), value


class Slopes:
    """A loss of a recipe with given settings.

    Args:
        loss: of the attitude at the "end", of all "rows", or of those that are "defined".
        velocity: (EPOCHS + 1, 3) of the aid, m/s, NaN where missing; by default one fix is lost.

    Attributes:
        paths: of its tunable numbers, in their order behind the first three of ``x``.
        zero: where ``x`` starts.
        direction: of the velocities, (EPOCHS + 1, 3), by which the first of ``x`` moves them.
    """

    def __init__(self, name: str, aid: str, settings: dict, loss: str = "end", velocity=None):
        method = build(name, aid, settings)
        self.paths = list(tunables(method))
        self.numbers = np.array([float(parameters(method)[path] or 0.0) for path in self.paths])
        chosen = {path: x for path, x in settings.items() if path not in self.paths}
        self._reverse, self._forward, self._value = _programs(name, aid, tuple(chosen.items()))
        self.zero = np.zeros(3 + len(self.paths))
        self._velocity = np.zeros((EPOCHS + 1, 3)) if aid == "static" else velocities(aid).copy()
        if velocity is None:
            self._velocity[LOST] = np.nan
        else:
            self._velocity = velocity
        direction = np.random.default_rng(5).normal(size=self._velocity.shape)
        truth = np.array(quat_from_dcm(log_of(aid).C_nb[0])) * [1, -1, -1, -1]
        self.direction = direction
        self._rest = (epochs_of(aid), direction, truth, np.array([float(loss == x) for x in LOSSES]))

    def reverse(self, x, numbers=None):
        """Value, slope by x, slope by the velocities, eigengap at the end."""
        numbers = self.numbers if numbers is None else numbers
        (value, gap), (slope, by_velocity) = self._reverse(x, self._velocity, numbers, *self._rest)
        return float(value), np.asarray(slope), np.asarray(by_velocity), float(gap)

    def forward(self, x, towards):
        """Forward mode: the slope towards somewhere. One direction shows each part that is wrong, and compiles fast."""
        return float(self._forward(x, towards, self._velocity, self.numbers, *self._rest))

    def difference(self, i: int, step: float) -> float:
        """The central difference by one of x."""
        axis = step * np.eye(len(self.zero))[i]
        ends = [float(self._value(x, self._velocity, self.numbers, *self._rest)) for x in (axis, -axis)]
        return (ends[0] - ends[1]) / (2 * step)
