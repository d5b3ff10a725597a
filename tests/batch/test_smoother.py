"""The algebra of the batch estimator: the recursion against a dense solution, its model against navigation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxalign import Quat, Vec3, epochs_from_log, rotation
from jaxalign.batch import ImuErrors
from jaxalign.batch.model import Guess, back, forth, navigated
from jaxalign.batch.smoother import Prior, filtered, fixes, smoothed
from jaxalign.simulate import simulate


@pytest.fixture(scope="module")
def short():
    """Twelve epochs on the true path of an accelerated turn, and its noisy fixes."""
    log = simulate("dvl-sway", seed=3, duration=12.0)
    epochs = epochs_from_log(log)
    guess = Guess(
        Quat.of(rotation.quat_from_dcm(log.C_nb[0])),
        Vec3(jnp.array(1.0), jnp.array(1.5), jnp.array(0.1)),
        Vec3(*jnp.array([1e-5, -2e-5, 3e-5])),
        Vec3(*jnp.array([1e-3, 2e-3, -1e-3])),
    )
    return epochs, guess, navigated(epochs, guess)


def test_back_is_the_transpose_of_forth(short):
    _, _, path = short
    row = jax.tree.map(lambda x: x[5], path)
    rng = np.random.default_rng(0)
    x, r = rng.normal(size=(2, 16))
    np.testing.assert_allclose(r @ forth(row, jnp.asarray(x)), x @ back(row, jnp.asarray(r)), rtol=1e-12)


@pytest.mark.parametrize(("kind", "size"), [(0, 1e-6), (1, 1e-5), (2, 1e-8), (3, 1e-6)])
def test_errors_pass_on_as_navigation_has_them(short, kind, size):
    """Navigate from a guess moved by little: the difference is what the model says, to 1 % of the largest axis."""
    epochs, guess, path = short
    found, said = [], []
    for axis in range(3):
        x = jnp.zeros(12).at[3 * kind + axis].set(size)
        moved = navigated(epochs, guess.moved(x))
        for k in range(1, 13):
            x = forth(jax.tree.map(lambda leaf, k=k: leaf[k], path), x)
        q, p = (jax.tree.map(lambda leaf: leaf[12], one.q_n0b) for one in (moved, path))
        speed = (moved.velocity - path.velocity).array[12]
        found.append([(q * p.conjugate()).log().array, speed])
        said.append([x[:3], x[3:6]])
    for i in range(2):
        ours, theirs = (np.array([pair[i] for pair in pairs]) for pairs in (found, said))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-2 * np.abs(theirs).max() + 1e-12)


AID = {"mounting": 4, "latency": 1, "lever": 3}


@pytest.mark.parametrize("calibrated", [(), ("mounting", "latency", "lever")])
def test_smoother_is_the_dense_least_squares_solution(short, calibrated):
    """All unknowns and all white noise of twelve intervals in one normal matrix."""
    epochs, _, path = short
    imu = ImuErrors(*(jnp.asarray(x) for x in (10.0, 2.0, 500.0, 3000.0)))
    used = epochs.rows.valid.at[4].set(False)
    measured = fixes(path, epochs.rows.velocity, used, "body", **{x: jnp.zeros(AID[x]) for x in calibrated})
    n = 12 + sum(AID[x] for x in calibrated)
    variance = jnp.linspace(0.01, 0.3, 13)
    prior = Prior(jnp.linspace(-1e-4, 1e-4, n), jnp.full(n, 1e-3).at[3:6].set(100.0))
    found = filtered(path, measured, variance, imu, prior, keep=True)
    start, noise = smoothed(path, measured, variance, prior, found)

    rows = [jax.tree.map(lambda x, k=k: x[k], path) for k in range(13)]
    from jaxalign.batch.smoother import _noise

    size = n + 6 * 12  # the start, then the noise of each interval as unknowns
    whole = np.zeros((n, size))
    whole[:, :n] = np.eye(n)
    information = np.zeros((size, size))
    information[:n, :n] = np.diag(1 / np.asarray(prior.variance))
    right = np.zeros(size)
    right[:n] = np.asarray(prior.mean / prior.variance)
    at = []
    for k in range(13):
        if k:
            whole = np.array(forth(rows[k], jnp.asarray(whole)))
            here = slice(n + 6 * (k - 1), n + 6 * k)
            whole[:6, here] += np.eye(6)
            information[here, here] += np.linalg.inv(np.asarray(_noise(rows[k], imu)))
        h = np.asarray(measured.slope[k]) @ whole
        at.append(h)
        information += h.T @ h / float(variance[k])
        right += h.T @ np.asarray(measured.gap[k]) / float(variance[k])
    covariance = np.linalg.inv(information)
    solution = covariance @ right
    np.testing.assert_allclose(start, solution[:n], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.mean[-1], whole @ solution, rtol=1e-6, atol=1e-9)
    dense = whole @ covariance @ whole.T
    np.testing.assert_allclose(found.covariance[-1], dense, atol=1e-6 * np.abs(dense).max())
    for k in range(13):
        expected = np.asarray(measured.gap[k]) - at[k] @ solution
        np.testing.assert_allclose(noise[k], expected, rtol=1e-6, atol=1e-9)


def test_likelihood_is_that_of_the_dense_distribution(short):
    """Twelve epochs: the recursion against the normal density of all velocities at once, but for its constant."""
    epochs, _, path = short
    imu = ImuErrors(*(jnp.asarray(x) for x in (10.0, 2.0, 500.0, 3000.0)))
    used = epochs.rows.valid.at[4].set(False)
    measured = fixes(path, epochs.rows.velocity, used, "body")
    variance = jnp.linspace(0.01, 0.3, 13)
    prior = Prior(jnp.linspace(-1e-4, 1e-4, 12), jnp.full(12, 1e-3).at[3:6].set(1.0))
    found = filtered(path, measured, variance, imu, prior)
    rows = [jax.tree.map(lambda x, k=k: x[k], path) for k in range(13)]
    from jaxalign.batch.smoother import _noise

    state, shocks = np.eye(12), []
    slopes, spreads = [], []
    for k, row in enumerate(rows):
        push = np.asarray(forth(row, jnp.eye(12)))
        state = push @ state
        shocks = [push @ s for s in shocks] + [
            np.eye(12)[:, :6] @ np.linalg.cholesky(_noise(row, imu) + 1e-30 * np.eye(6))
        ]
        if used[k]:
            h = np.asarray(measured.slope[k])
            slopes.append(h @ state)
            spreads.append(np.hstack([h @ s for s in shocks] + [np.zeros((3, 6 * (12 - k)))]))
    a, b = np.vstack(slopes), np.vstack(spreads)
    keep = np.asarray(used)
    covariance = a @ np.diag(prior.variance) @ a.T + b @ b.T + np.diag(np.repeat(np.asarray(variance)[keep], 3))
    z = np.asarray(measured.gap)[keep].ravel() - a @ np.asarray(prior.mean)
    dense = -0.5 * (z @ np.linalg.solve(covariance, z) + np.linalg.slogdet(covariance)[1])
    np.testing.assert_allclose(found.log_likelihood, dense, rtol=1e-9)


@pytest.mark.parametrize("unknown", ["latency", "lever"])
def test_slopes_of_the_aids_unknowns(short, unknown):
    """The gap changes as the slope says, exactly: both are linear."""
    epochs, _, path = short
    value = jnp.arange(1.0, 1.0 + AID[unknown]) / 3
    zero, there = (fixes(path, epochs.rows.velocity, epochs.rows.valid, "nav", **{unknown: x * value}) for x in (0, 1))
    np.testing.assert_allclose(zero.gap - there.gap, zero.slope[..., 12:] @ value, atol=1e-13)
    assert np.abs(zero.gap - there.gap).max() > 1e-4
