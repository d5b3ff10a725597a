"""Vondrak's smoothing: frozen 60-digit results, exact gain, preserved moments, another solver, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import cho_solve_banded, cholesky_banded

from jaxalign.prefilter import cutoff_from_theta, factor, gain, smooth, solve, theta_from_cutoff

run = jax.jit(smooth)


@pytest.mark.parametrize("name", ["eq200_fc5", "eq200_theta_lo", "uneq400_fc2", "n5", "grav4000_fc0p5"])
def test_frozen(shared, name):
    with np.load(shared / "cases" / "disturbed_vondrak.npz") as z:
        assert name in z["names"]
        t, y, p, theta, out, err = (z[f"{name}_{key}"] for key in ("t", "y", "p", "theta", "out", "qr64_err"))
    found = run(t, y, p, jnp.asarray(float(theta)))
    assert np.abs(found - out).max() < max(1e-8, 10 * float(err))


@pytest.mark.parametrize("cutoff", [5.0, 0.5, 0.05])
def test_gain_measured_with_sines(cutoff):
    """In the middle of 300 s at 200 Hz, where the ends do not reach."""
    t = np.arange(60000) * 0.005
    theta = theta_from_cutoff(cutoff)
    problem = jax.jit(factor)(t, np.ones_like(t), theta)
    middle = slice(25000, 35000)
    for frequency in (0.3, 0.5, 1.0, 5.0):
        out = np.asarray(jax.jit(solve)(problem, np.sin(2 * np.pi * frequency * t)))[middle]
        angle = 2 * np.pi * frequency * t[middle]
        both = np.linalg.lstsq(np.stack([np.sin(angle), np.cos(angle)], axis=1), out, rcond=None)[0]
        np.testing.assert_allclose(both, [gain(frequency, 0.005, theta), 0.0], atol=1e-6)


def test_gain_at_the_cutoff():
    theta = theta_from_cutoff(0.5)
    assert theta == pytest.approx(np.pi**6)
    assert cutoff_from_theta(theta) == pytest.approx(0.5)
    assert gain(0.5, 1e-4, theta) == pytest.approx(0.5, rel=1e-6)
    assert cutoff_from_theta(theta_from_cutoff(0.7, 0.3), 0.3) == pytest.approx(0.7)


@pytest.mark.parametrize("cutoff", [0.5, 0.05, 0.005])
def test_quadratics_pass(cutoff):
    """The paper's setting and two decades beyond: rounding is all that is lost."""
    t = np.arange(60000) * 0.005
    y = 9.8 + 0.3 * (t / 300) - 0.7 * (t / 300) ** 2
    np.testing.assert_allclose(run(t, y, np.ones_like(t), theta_from_cutoff(cutoff)), y, atol=1e-8)


def uneven(n=400, seed=1):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 4, n))
    p = np.where(np.arange(n) % 7 == 0, 0.0, rng.uniform(0.5, 2.0, n))
    return t, rng.normal(size=n) + 9.8, p


def test_weighted_moments_are_preserved():
    """Sums of p y, p t y, p t^2 y, whatever theta: a mean of filtered data is the mean of the data."""
    t, y, p = uneven()
    for cutoff in (0.1, 2.0, 50.0):
        s = np.asarray(run(t, y, p, theta_from_cutoff(cutoff)))
        for power in range(3):
            np.testing.assert_allclose((p * t**power * s).sum(), (p * t**power * y).sum(), rtol=1e-10)


def test_missing_samples_have_no_influence():
    t, y, p = uneven()
    theta = theta_from_cutoff(2.0)
    spoilt = np.where(p == 0, 1e6, y)
    np.testing.assert_allclose(run(t, spoilt, p, theta), run(t, y, p, theta), atol=1e-12)


def test_limits():
    """No smoothing, and the weighted quadratic."""
    t, y, p = uneven()
    p = np.maximum(p, 0.5)
    np.testing.assert_allclose(run(t, y, p, 1e40), y, atol=1e-9)
    basis = np.stack([np.ones_like(t), t, t * t], axis=1)
    fit = np.linalg.lstsq(basis * np.sqrt(p)[:, None], y * np.sqrt(p), rcond=None)[0]
    np.testing.assert_allclose(run(t, y, p, 1e-9), basis @ fit, atol=1e-6)


def test_another_solver():
    """Banded Cholesky of the normal matrix with refinement, at 0.5 Hz and 200 Hz."""
    n, dt = 4000, 0.005
    t = np.arange(n) * dt
    y = np.random.default_rng(7).normal(size=n)
    kappa = 1.0 / (float(theta_from_cutoff(0.5)) * dt**6)
    third = np.array([-1.0, 3.0, -3.0, 1.0])

    def penalty(x):
        d = sum(c * x[i : n - 3 + i] for i, c in enumerate(third))
        return sum(np.pad(c * d, (i, 3 - i)) for i, c in enumerate(third))

    # Columns 0 to 3 below the diagonal of D'D: correlations of the stencil, cut at the ends.
    band = np.zeros((4, n))
    for j in range(4):
        for i in range(4 - j):
            band[j, i : i + n - 3] += third[i] * third[i + j]
    band *= kappa
    band[0] += 1.0
    chol = cholesky_banded(band, lower=True)
    x = cho_solve_banded((chol, True), y)
    for _ in range(4):
        x = x + cho_solve_banded((chol, True), (y - x) - kappa * penalty(x))
    np.testing.assert_allclose(run(t, y, np.ones(n), theta_from_cutoff(0.5)), x, atol=1e-8)


def test_derivatives():
    t, y, p = uneven()
    w = np.random.default_rng(3).normal(size=len(t))
    theta = theta_from_cutoff(2.0)

    def loss(log_theta, y, p):
        return jnp.dot(w, smooth(jnp.asarray(t), y, p, theta * jnp.exp(log_theta)))

    at = (jnp.zeros(()), jnp.asarray(y), jnp.asarray(p))
    reverse = jax.jit(jax.grad(loss, (0, 1, 2)))(*at)
    forward = jax.jit(jax.jacfwd(loss, (0, 1, 2)))(*at)
    value = jax.jit(loss)
    direction = np.random.default_rng(5).normal(size=len(t))
    moves = (1.0, direction, np.where(p > 0, 0.1 * direction, 0.0))
    for i, move in enumerate(moves):
        np.testing.assert_allclose(reverse[i], forward[i], rtol=1e-8, atol=1e-9 * np.abs(forward[i]).max())
        for step in (1e-3, 1e-4):
            ahead, behind = (
                value(*(x + sign * step * move if i == j else x for j, x in enumerate(at))) for sign in (1, -1)
            )
            np.testing.assert_allclose(jnp.sum(reverse[i] * move), (ahead - behind) / (2 * step), rtol=1e-4)
    assert np.isfinite(reverse[2]).all()


def test_columns_share_a_factor():
    t, y, p = uneven()
    problem = jax.jit(factor)(t, p, theta_from_cutoff(1.0))
    columns = np.stack([y, 2 * y + 1, -y])
    together = jax.jit(jax.vmap(solve, (None, 0)))(problem, columns)
    for alone, one in zip(together, columns, strict=True):
        np.testing.assert_allclose(alone, run(t, one, p, theta_from_cutoff(1.0)), atol=1e-10)
