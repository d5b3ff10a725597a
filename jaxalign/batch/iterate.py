"""From a start to a solution: the step repeated, from several headings where that is wished.

Two drivers of the same step. Inside traced code it is a loop of the program, with derivatives. On the host the step is
a program of its own, called again and again: rows in groups of a few lanes, epochs filled up to one of few lengths, so
that logs of similar length and all grades, rows and starts share it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.aids import AbstractAid
from jaxalign.batch.measurement import steady_aid
from jaxalign.batch.modes import best_of, turns
from jaxalign.batch.pool import pool_velocities
from jaxalign.batch.problem import AidNoise, Model, Problem, Readout, State
from jaxalign.batch.solver import initial_state, step
from jaxalign.batch.start import integrate_vectors
from jaxalign.batch.trajectory import ACCEL, GYRO, STATES, TILT, VELOCITY, NominalTrajectory
from jaxalign.compilation.programs import Program
from jaxalign.epochs import Epoch, Epochs
from jaxalign.vector import Quat, Vec3

__all__ = [
    "LANES",
    "RowSolutions",
    "begin_search",
    "converged",
    "filled_rows",
    "padded_length",
    "solve_on_host",
    "solve_traced",
    "with_heading",
]

LANES = 16
"""Rows or runs side by side: what the step holds of them stays in the fastest cache."""
_EXACT = 1e-9  # of a derivative: what further rounds would change
_FEWEST, _OFTEN = 3, 100  # rounds at least and at most
_SLOWEST = 0.99  # share of a change that the next round leaves


class RowSolutions(NamedTuple):
    """Solutions and the vectors of their epochs.

    Attributes:
        read: lanes on the last axis.
        alpha: (3, L) m/s, n0.
        beta: (3, L) m/s, b0.
    """

    read: Readout
    alpha: Float[Array, "3 L"]
    beta: Float[Array, "3 L"]


def begin_search(model: Model, problem: Problem) -> tuple[State, Array, Array]:
    """The state to begin with, and the vectors of the last epochs (3, L), m/s, in n0 and b0."""
    pool = pool_velocities(model.aids, problem.rows.fixes)
    seen = integrate_vectors(problem.rows, problem.site, pool)

    def at_last(v: Any) -> Array:
        lanes = problem.last.shape
        full = jnp.stack([jnp.broadcast_to(x, (len(x), *lanes)) for x in (v.x, v.y, v.z)])
        return jnp.take_along_axis(full, jnp.broadcast_to(problem.last, (3, 1, *lanes)), axis=1)[:, 0]

    return initial_state(model, problem, pool, seen), at_last(seen.alpha), at_last(seen.beta)


def with_heading(begun: State, found: State, angle: Any, aids: tuple[AbstractAid, ...]) -> State:
    """To begin again from a solution with another heading; an aid in n has measured the velocity."""
    return dataclasses.replace(begun, at=found.at.turned(angle, steady_aid(aids) is None))


def _best(reads: Readout) -> Readout:
    """Of the solutions from several headings (first axis) the most likely, the others in mind."""

    def one(q: Any, tilt: Any, likelihood: Any) -> Any:
        return best_of(q, tilt, likelihood)

    best, tilt = jax.vmap(one, in_axes=-1, out_axes=-1)(reads.q_nb, reads.tilt, reads.log_likelihood)
    chosen = jax.tree.map(lambda x: jnp.take_along_axis(x, best.reshape(1, *[1] * (x.ndim - 2), -1), axis=0)[0], reads)
    return dataclasses.replace(chosen, tilt=tilt)


def _rounds(model: Model, problem: Problem, state: State, iterations: int) -> tuple[State, Readout]:
    """Steps until all lanes have converged, at most so many; then one that only reads out."""

    def body(carry: Any) -> Any:
        state, _, number, _ = carry
        final = (number >= iterations) | ~jnp.any(state.moving)
        new, read = step(model, problem, state, number >= iterations // 2, final)
        state = jax.tree.map(lambda a, b: jnp.where(final, a, b), state, new)
        return state, read, number + 1, final

    nothing = jax.eval_shape(lambda: step(model, problem, state, True, True)[1])
    zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), nothing)
    state, read, _, _ = jax.lax.while_loop(lambda c: ~c[-1], body, (state, zeros, jnp.asarray(0), jnp.asarray(False)))
    return state, read


def _searched(model: Model, problem: Problem, begun: State, iterations: int, starts: int) -> tuple[Readout, State]:
    """All starts; the solution and the state that it was read from."""
    problem = dataclasses.replace(problem, length=jnp.max(problem.last) + 1)

    def search(first: Any, number: Any) -> Any:
        start = jax.tree.map(
            lambda a, b: jnp.where(number == 0, a, b), begun, with_heading(begun, first, angles[number], model.aids)
        )
        state, read = _rounds(model, problem, start, iterations)
        return jax.tree.map(lambda a, b: jnp.where(number == 0, a, b), state, first), (read, state)

    if starts == 1:
        state, read = _rounds(model, problem, begun, iterations)
        return read, state
    angles = jnp.asarray([0.0, *turns(starts)])
    _, (reads, states) = jax.lax.scan(search, begun, jnp.arange(starts))
    best = jnp.argmax(jnp.where(jnp.isfinite(reads.log_likelihood), reads.log_likelihood, -jnp.inf), axis=0)
    state = jax.tree.map(lambda x: jnp.take_along_axis(x, jnp.broadcast_to(best, (1, *x.shape[1:])), axis=0)[0], states)
    return _best(reads), state


@eqx.filter_custom_jvp
def converged(model: Model, problem: Problem, begun: State, iterations: int, starts: int) -> Readout:
    """The solution; its derivatives are those of the fixed point of the step."""
    return _searched(model, problem, begun, iterations, starts)[0]


@converged.def_jvp
def _converged_jvp(primals: Any, tangents: Any) -> Any:
    model, problem, begun, iterations, starts = primals
    read, state = jax.lax.stop_gradient(_searched(model, problem, begun, iterations, starts))
    state = dataclasses.replace(state, moving=jnp.ones_like(state.moving))
    numbers, rest = eqx.partition(state, eqx.is_inexact_array)
    towards = tangents[:2]
    told, fixed = eqx.partition((model, problem), jax.tree.map(lambda x: x is not None, towards, is_leaf=_absent))

    def stepped(told: Any, numbers: Any) -> tuple[Any, Readout]:
        model, problem = eqx.combine(told, fixed)
        state = eqx.combine(numbers, rest)
        alike = state.steady is None  # the step that is read out is one as any other
        new, read = step(model, problem, state, True, alike)
        if not alike:
            read = step(model, problem, state, True, True)[1]
        return eqx.filter(new, eqx.is_inexact_array), read

    _, onward = jax.linearize(stepped, told, numbers)
    none = jax.tree.map(jnp.zeros_like, told)
    by_figures, _ = onward(towards, jax.tree.map(jnp.zeros_like, numbers))
    # Reverse mode wants each part to depend on a tangent, also where it is zero whatever the figures. A product with
    # zero would bring the NaN of one lane to the others.
    nothing = jnp.where(False, sum(jnp.sum(x) for x in jax.tree.leaves(towards)), 0.0)
    by_figures = jax.tree.map(lambda x: x + nothing, by_figures)
    sizes = _sizes(state, read)
    units = jax.tree.map(lambda size: jnp.where(size > 0, 1.0 / jnp.where(size > 0, size, 1.0), 0.0), sizes)
    moved = jax.lax.custom_linear_solve(
        lambda x: jax.tree.map(jnp.subtract, x, onward(none, x)[0]),
        by_figures,
        lambda left, b: _repeated(left, b, units),
        lambda left, b: _repeated(left, b, sizes),
    )
    return read, onward(towards, moved)[1]


def _absent(x: Any) -> bool:
    return x is None


def _sizes(state: State, read: Readout) -> Any:
    """What is little for each number of a state: its standard deviation at the end; as the numbers of a state."""
    sd = jnp.stack([jnp.sqrt(read.covariance[i, i]) for i in range(len(read.covariance))])
    tilt, velocity, gyro, accel = (jnp.max(sd[part], axis=0) for part in (TILT, VELOCITY, GYRO, ACCEL))
    turn, speed = Quat(tilt, tilt, tilt, tilt), Vec3(velocity, velocity, velocity)
    at = NominalTrajectory(turn, speed, Vec3(gyro, gyro, gyro), Vec3(accel, accel, accel))
    noise = tuple(AidNoise(jnp.ones_like(n.variance), n.variance, jnp.ones_like(n.variance)) for n in state.noise)
    steady = None if state.steady is None else speed
    out = State(at, turn, sd[STATES:], noise, steady, state.early, state.moving)
    return eqx.filter(out, eqx.is_inexact_array)


def _repeated(left: Callable[[Any], Any], b: Any, units: Any) -> Any:
    """The solution x of ``left(x) = b``, where ``x - left(x)`` is smaller than x: the sum of what is left each time.

    Args:
        left: linear, lane by lane.
        b: leaves (..., L).
        units: times which a change is measured; zero where nothing can change.
    """

    def length(x: Any) -> Any:
        parts = jax.tree.map(lambda x, unit: jnp.sum((x * unit) ** 2, axis=tuple(range(x.ndim - 1))), x, units)
        return jnp.sqrt(sum(jax.tree.leaves(parts)))

    def again(at: Any) -> Any:
        x, change, before, count, _ = at
        change = jax.tree.map(jnp.subtract, change, left(change))
        x = jax.tree.map(jnp.add, x, change)
        now = length(change)
        share = jnp.clip(now / jnp.where(before > 0, before, 1.0), 0.0, _SLOWEST)
        more = now * share / (1.0 - share) > _EXACT * length(x)  # what all further rounds would add
        return x, change, now, count + 1, jnp.any(more) | (count + 1 < _FEWEST)

    start = b, b, length(b), jnp.asarray(0), jnp.asarray(True)
    return jax.lax.while_loop(lambda at: at[4] & (at[3] < _OFTEN), again, start)[0]


def solve_traced(model: Model, problem: Problem, iterations: int, starts: int) -> RowSolutions:
    """The solutions of some lanes, inside traced code."""
    begun, alpha, beta = begin_search(model, problem)
    return RowSolutions(converged(model, problem, begun, iterations, starts), alpha, beta)


def padded_length(count: int) -> int:
    """The next of few lengths: powers of two and half way between them, at least 64."""
    size = 64
    while size < count:
        size += size // 2 if size & (size - 1) == 0 else size // 3
    return size


def filled_rows(rows: Epoch) -> Epoch:
    """Epochs (K,) filled up with nothing, one lane: (K', 1)."""
    count = len(rows.dt)
    more = padded_length(count) - count

    def fill(x: Any, value: Any = 0) -> np.ndarray:
        x = np.asarray(x)
        return np.concatenate([x, np.full(more, value, x.dtype)])[:, None]

    out = jax.tree.map(fill, rows)
    return eqx.tree_at(lambda e: e.rotation.w, out, fill(rows.rotation.w, 1.0))


_begin = Program(begin_search, {"xla_backend_optimization_level": 1})  # it runs once, and compiles faster so
_step, _again, _chosen = Program(step), Program(with_heading), Program(_best)


def solve_on_host(
    model: Model,
    epochs: Epochs,
    last: np.ndarray,
    iterations: int,
    starts: int,
    *,
    lanes: int = LANES,
    done: Callable[[int], None] | None = None,
) -> RowSolutions:
    """The solutions of some rows, or of some models, of one log; NumPy arrays.

    Args:
        model: its figures of the unit may be (1, n) or (3, n).
        epochs: of a log.
        last: (n,) epochs up to which fixes count.
        iterations: steps.
        starts: how many headings to start from.
        lanes: side by side.
        done: told how many rows are finished, group by group.
    """
    rows = filled_rows(epochs.rows)
    groups = []
    for own, problem, count in _groups(model, epochs, rows, np.asarray(last), lanes):
        begun, alpha, beta = _begin(own, problem)
        reads, first = [], begun
        for angle in (0.0, *turns(starts)):
            state = begun if not reads else _again(begun, first, np.float64(angle), own.aids)
            state, read = _looped(own, problem, state, iterations)
            first = state if not reads else first
            reads.append(read)
        read = reads[0] if starts == 1 else _chosen(jax.tree.map(lambda *x: np.stack(x), *reads))
        groups.append(jax.tree.map(lambda x, n=count: np.asarray(x)[..., :n], RowSolutions(read, alpha, beta)))
        if done is not None:
            done(count)
    return jax.tree.map(lambda *x: np.concatenate(x, axis=-1), *groups)


def _looped(model: Model, problem: Problem, state: State, iterations: int) -> tuple[State, Readout]:
    """Steps until all lanes have converged, each a call of the compiled step."""
    number, final = 0, False
    while True:
        final = number >= iterations or not np.asarray(state.moving).any()
        new, read = _step(model, problem, state, np.asarray(number >= iterations // 2), np.asarray(final))
        if final:
            return state, read
        state, number = new, number + 1


def _groups(model: Model, epochs: Epochs, rows: Epoch, last: np.ndarray, lanes: int) -> Iterator[tuple[Any, Any, int]]:
    """Models and problems of so many lanes each; the last one is filled up with its last row."""
    imu = model.imu.over_lanes(len(last))
    for begin in range(0, len(last), lanes):
        count = min(lanes, len(last) - begin)
        index = np.minimum(begin + np.arange(lanes), len(last) - 1)
        own = dataclasses.replace(model, imu=jax.tree.map(lambda x, index=index: x[:, index], imu))
        yield own, Problem(rows, epochs.site, epochs.sd, last[index], np.max(last[index]) + 1), count
