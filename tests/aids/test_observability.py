"""When the heading becomes observable, and the white noise of an aid from its vectors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxalign.aid_noise import white_noise_sd
from jaxalign.observability import Observability
from jaxalign.vector import Vec3


@jax.jit
def spread_of(vectors, used):
    found = Observability.of(Vec3.of(vectors), used).cumulated()
    return jax.tree.map(lambda x: x[-1], found)


@jax.jit
def observable(spread, sd):
    return spread.observable(sd)


def fan(ratio, rng, count=50):
    """Vectors around one direction, spread so that (s2 + s3) / s1 is about the ratio."""
    axes = Rotation.random(rng=rng).as_matrix()
    sizes = np.array([1.0, np.sqrt(0.7 * ratio), np.sqrt(0.3 * ratio)])
    vectors = rng.normal(size=(count, 3)) * sizes
    vectors[:, 0] = 1 + 0.3 * vectors[:, 0]
    return 500.0 * vectors @ axes.T


@pytest.mark.parametrize("ratio", [1e-2, 1e-4, 1e-6, 1e-8])
def test_criterion_is_the_sum_of_the_small_eigenvalues(ratio):
    """4 (s2 + s3) = 8 k sd^2 at the switch; s2 + s3 is short by (s2 + s3) / s1 of itself, and by rounding."""
    rng = np.random.default_rng(17)
    for _ in range(5):
        vectors = fan(ratio, rng)
        s = np.linalg.svd(vectors, compute_uv=False) ** 2  # eigenvalues of sum a a^T, small ones kept
        small = s[1] + s[2]
        switch = np.sqrt(small / (2 * len(vectors)))
        slack = small / s[0] + 1e-15 * s[0] / small + 1e-12
        spread = spread_of(vectors, np.ones(len(vectors), bool))
        assert np.linalg.eigvalsh(spread.moments.array)[-1] == pytest.approx(s[0], rel=1e-13)
        assert observable(spread, switch * (1 - slack))
        assert not observable(spread, switch * (1 + 1e-15 * s[0] / small + 1e-12))


def test_criterion_errs_on_the_safe_side_by_a_factor_of_two_at_most():
    """Equal eigenvalues: the principal minors over the trace are half of s2 + s3."""
    spread = spread_of(np.eye(3), np.ones(3, bool))
    exact = np.sqrt(2 / (2 * 3))
    assert observable(spread, 0.99 * exact / np.sqrt(2))
    assert not observable(spread, exact)


def test_unused_vectors_do_not_count():
    vectors = fan(1e-3, np.random.default_rng(18))
    used = np.arange(len(vectors)) % 3 == 0
    some, only = spread_of(vectors, used), spread_of(vectors[used], np.ones(used.sum(), bool))
    assert float(some.count) == used.sum() == float(only.count)
    np.testing.assert_allclose(some.moments.array, only.moments.array, rtol=1e-13)
    np.testing.assert_allclose(only.moments.array, vectors[used].T @ vectors[used], rtol=1e-12)


def test_running_sums_are_a_loop_of_additions():
    vectors, used = fan(1e-2, np.random.default_rng(19), count=6), np.array([1, 1, 0, 1, 0, 1], bool)
    running = Observability.of(Vec3.of(vectors), jnp.asarray(used)).cumulated()
    total = Observability.zero()
    for i in range(6):
        total = total + Observability.of(Vec3.of(jnp.asarray(vectors[i])), used[i])
        for one, all_ in zip(jax.tree.leaves(total), jax.tree.leaves(running), strict=True):
            np.testing.assert_allclose(all_[i], one, rtol=1e-14)
    np.testing.assert_array_equal(running.count, np.cumsum(used))


@pytest.mark.parametrize("count", [0, 1, 20])
def test_nothing_and_one_direction_are_not_observable(count):
    vectors = np.tile([3.0, -4.0, 9.0], (20, 1)) * 100
    spread = spread_of(vectors, np.arange(20) < count)
    assert not observable(spread, 1e-4)


SD = 0.05


def _record(rng, samples=400, sd=SD):
    """Vectors that turn, grow and shake, in a turned frame with smooth errors and noise: (alpha, beta, valid)."""
    t = np.arange(samples) / samples
    alpha = 300 * t[:, None] * np.stack([np.sin(t), np.cos(2 * t), np.ones(samples)], axis=1) + [1.0, 2.0, 3.0]
    alpha[:, 2] += 0.2 * np.sin(2 * np.pi / 3 * np.arange(samples))  # third differences need the frame to remove it
    smooth = 0.5 * np.stack([t, np.sin(3 * t), t**2], axis=1)
    beta = (alpha + smooth + sd * rng.normal(size=(samples, 3))) @ Rotation.random(rng=rng).as_matrix()
    return alpha, beta, np.ones(samples, bool)


# Of n third differences the median of |x| has the relative sd 1.17 / sqrt(n) if they were independent, but
# neighbours are correlated (-15/20, 6/20, -1/20): 1.4 times that. Three axes average.
def tolerance(samples):
    return 4 * 1.17 * 1.4 / np.sqrt(3 * samples)


@pytest.mark.parametrize("sd", [0.002, SD])
@pytest.mark.parametrize("outliers", [0.0, 0.02])
def test_sd_is_recovered_under_smooth_errors_and_outliers(sd, outliers):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        alpha, beta, valid = _record(rng, sd=sd)
        wild = rng.random(len(alpha)) < outliers
        beta[wild] += rng.uniform(-5, 5, size=(wild.sum(), 3))
        found = white_noise_sd(alpha, beta, valid)
        assert found is not None
        # an outlier touches four differences: 8 % of them at either end move the median up by 11 %
        assert -tolerance(len(alpha)) < found / sd - 1 < tolerance(len(alpha)) + (0.11 if outliers else 0.0)


def test_sd_of_a_long_record():
    found = white_noise_sd(*_record(np.random.default_rng(20), samples=20_000))
    assert found == pytest.approx(SD, rel=tolerance(20_000))


def test_missing_vectors_are_left_out():
    rng = np.random.default_rng(21)
    alpha, beta, valid = _record(rng, samples=1000)
    valid[rng.random(1000) < 0.1] = False
    spoilt = beta.copy()
    spoilt[~valid] = 1e3
    found = white_noise_sd(alpha, spoilt, valid)
    assert found == pytest.approx(SD, rel=tolerance(0.9**4 * 1000))
    spoilt[~valid] = np.nan
    assert white_noise_sd(alpha, spoilt, valid) == found


def test_noise_free_vectors_give_the_floor():
    alpha, _, valid = _record(np.random.default_rng(22))
    turned = alpha @ Rotation.random(rng=np.random.default_rng(22)).as_matrix()
    assert white_noise_sd(alpha, turned, valid) == pytest.approx(1e-6)


@pytest.mark.parametrize("samples", [0, 1, 3, 4, 12, 13])
def test_short_records(samples):
    """Ten runs of four consecutive vectors take 13."""
    alpha, beta, valid = (x[:samples] for x in _record(np.random.default_rng(23)))
    found = white_noise_sd(alpha, beta, valid)
    assert (found is None) == (samples < 13)


def test_scattered_vectors_serve_too():
    """Every third one missing (or fixes of a slow aid among faster epochs): differences skip them."""
    alpha, beta, valid = _record(np.random.default_rng(24))
    whole = white_noise_sd(alpha, beta, valid)
    valid[::3] = False
    assert white_noise_sd(alpha, beta, valid) == pytest.approx(whole, rel=0.2)
    assert white_noise_sd(alpha, beta, np.zeros_like(valid)) is None


def test_absurd_vectors_give_none():
    alpha, beta, valid = _record(np.random.default_rng(24))
    alpha[7] = np.inf
    assert white_noise_sd(alpha, beta, valid) is None
    assert np.isfinite(white_noise_sd(np.where(np.isinf(alpha), 1e160, alpha), beta, valid))


def test_steps_of_a_random_walk():
    rng = np.random.default_rng(25)
    alpha = np.outer(np.arange(2000.0), [0.1, -0.2, 9.8])
    walk = np.cumsum(rng.normal(scale=0.02, size=alpha.shape), axis=0)
    assert white_noise_sd(alpha, alpha + walk, np.ones(2000, bool), walk=True) == pytest.approx(0.02, rel=0.1)
