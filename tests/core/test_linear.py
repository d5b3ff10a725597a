"""Small positive definite systems: against NumPy and SciPy, in values, derivatives, and where there is no solution."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from numeric import assert_derivatives

from jaxalign import linear

cholesky, solve_positive, solve_covariance = (
    jax.jit(f) for f in (linear.cholesky, linear.solve_positive, linear.solve_covariance)
)


def positive(*batch, size, seed=3):
    a = np.random.default_rng(seed).normal(size=(*batch, size, size))
    return a @ np.swapaxes(a, -1, -2) + 0.1 * np.eye(size)


@pytest.mark.parametrize("batch", [(), (7,), (2, 3)])
@pytest.mark.parametrize("size", [1, 3, 10])
def test_factor_and_solution(batch, size):
    a, b = positive(*batch, size=size), np.random.default_rng(1).normal(size=(*batch, size, 2))
    np.testing.assert_allclose(cholesky(jnp.asarray(a)), np.linalg.cholesky(a), atol=1e-13)
    found = solve_positive(jnp.asarray(a), jnp.asarray(b))
    np.testing.assert_allclose(found, np.linalg.solve(a, b), rtol=1e-9, atol=1e-12)


def test_only_the_lower_half_is_read():
    a = positive(size=4)
    np.testing.assert_array_equal(cholesky(jnp.asarray(np.tril(a))), cholesky(jnp.asarray(a)))


def test_as_accurate_as_lapack():
    """The Hilbert matrix of 8 (condition 1.5e10): the same residual as SciPy, within a factor of ten."""
    a, x = scipy.linalg.hilbert(8), np.ones((8, 1))
    ours, theirs = solve_positive(jnp.asarray(a), jnp.asarray(a @ x)), scipy.linalg.solve(a, a @ x, assume_a="pos")
    assert np.abs(a @ ours - a @ x).max() <= 10 * np.abs(a @ theirs - a @ x).max() + 1e-15


def test_derivatives():
    b = np.random.default_rng(2).normal(size=(3, 2))

    def of(x):
        root = jnp.zeros((3, 3)).at[jnp.tril_indices(3)].set(x)
        return solve_positive(root @ root.T + jnp.eye(3), jnp.asarray(b)) * jnp.sum(x)

    assert_derivatives(of, np.random.default_rng(4).normal(size=(3, 6)), third=100.0)


def test_not_positive_is_nan():
    a = np.diag([1.0, -1.0, 1.0])
    assert np.isnan(solve_positive(jnp.asarray(a), jnp.ones((3, 1)))).any()


def test_solve_covariance():
    rng = np.random.default_rng(3)
    a = rng.normal(size=(5, 5))
    s, b = a @ a.T + 0.1 * np.eye(5), rng.normal(size=(5, 2))
    solution, regular = solve_covariance(jnp.asarray(s), jnp.asarray(b))
    assert regular
    np.testing.assert_allclose(solution, np.linalg.solve(s, b), rtol=1e-10)
    badly_scaled = s * np.outer(10.0 ** np.arange(5), 10.0 ** np.arange(5))
    assert solve_covariance(jnp.asarray(badly_scaled), jnp.asarray(b))[1]
    slope_of = jax.jit(jax.grad(lambda m: linear.solve_covariance(m, jnp.asarray(b))[0].sum()))
    for bad in (np.outer(a[0], a[0]), np.full((5, 5), np.nan), -s, np.zeros((5, 5))):
        solution, regular = solve_covariance(jnp.asarray(bad), jnp.asarray(b))
        assert not regular
        assert np.isfinite(solution).all()
        assert np.isfinite(slope_of(jnp.asarray(bad))).all()
