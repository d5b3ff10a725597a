"""A scan that ends early, and many runs side by side: the same as one by one."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import epochs_of

from jaxalign.batch import RobustMap
from jaxalign.batch.rows import over_rows
from jaxalign.methods import build

COUNT = 7


def step(carry, row):
    moved = 0.5 * carry + row["x"] @ row["y"]
    return moved, {"sum": moved, "row": row["x"]}


def like():
    return {"sum": jnp.zeros(()), "row": jnp.zeros(3)}


@pytest.mark.parametrize("reverse", [False, True])
def test_the_first_rows_are_those_of_a_scan(reverse):
    rows = {key: jax.random.normal(jax.random.key(i), (COUNT, 3)) for i, key in enumerate("xy")}
    early = jax.jit(lambda length: over_rows(step, jnp.asarray(1.0), rows, length, like, reverse))
    for length in (0, 1, 4, COUNT):
        first = {key: x[:length] for key, x in rows.items()}
        expected, outputs = jax.lax.scan(step, jnp.asarray(1.0), first, reverse=reverse)
        last, found = early(length)
        np.testing.assert_allclose(last, expected, rtol=1e-14)
        for key in ("sum", "row"):
            np.testing.assert_allclose(found[key][:length], outputs[key], rtol=1e-14)
            assert not found[key][length:].any()


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("calibrate", ["none", "scale,mounting"])
def test_runs_side_by_side_are_the_runs(calibrate):
    """More runs than lanes, few rows; and with the method as a constant of the program."""
    method = build("robust_map", "body", {"calibrate": calibrate})
    runs = [epochs_of("body", seed) for seed in range(18)]
    every = len(runs[0]) // 3

    def side_by_side(first, *others):
        same = all(x is first or np.array_equal(x, first) for x in others)
        return first if same else jnp.stack([first, *others], axis=-1)

    rows = jax.tree.map(side_by_side, runs[0].rows, *(x.rows for x in runs[1:]))
    epochs = dataclasses.replace(runs[0], rows=rows)
    found = jax.jit(lambda e: method.solve_runs(e, every))(epochs)
    one = jax.jit(lambda e: method.solve(e, every))
    for i, run in enumerate(runs):
        alone = one(run)
        for name in ("q_nb", "covariance", "eigengap"):
            np.testing.assert_allclose(getattr(found, name)[i], getattr(alone, name), rtol=1e-6, atol=1e-9)
        np.testing.assert_array_equal(found.status[i], alone.status)


@pytest.mark.slow
def test_many_rows_inside_traced_code():
    """More rows than two groups of lanes, without unknowns of the aid."""
    method, epochs = RobustMap(), epochs_of("body")
    found, few = (jax.jit(lambda e, every=every: method.solve(e, every))(epochs) for every in (1, 20))
    assert len(found.q_nb) == 61
    np.testing.assert_allclose(found.q_nb[::20], few.q_nb, atol=1e-7)
