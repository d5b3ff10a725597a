"""Noise per interval: the distribution of noise per sample, to first order."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxalign import UserError, epochs_from_arrays
from jaxalign.simulate import intervals_of, measure, measure_epochs, noiseless, sample_epochs, scenario, truth
from jaxalign.vector import Quat

SECONDS, SAMPLES = 8.0, 200


def problem(name="dvl-sway", **options):
    made = scenario(name, duration=SECONDS, **options)
    exact = truth(made)
    return made, exact, intervals_of(exact, SAMPLES)


def keys(runs, seed=1):
    return jax.vmap(lambda i: jax.random.fold_in(jax.random.key(seed), i))(jnp.arange(runs))


measured = eqx.filter_jit(measure_epochs)


@eqx.filter_jit
def from_samples(made, exact, key):
    dtheta, dvel, velocity = measure(exact, made, key)
    fixed = {"dt": 1.0 / made.imu_rate, "every": SAMPLES, "site": made.site, "aid": made.aid}
    return epochs_from_arrays(dtheta, dvel, velocity, aid_sd=made.aid_sd, **fixed)


@jax.jit
def increments(epochs, intervals):
    """(..., intervals, 6) errors of rotation (rad) and velocity (m/s) in b at the start of each interval."""
    turned = Quat.of(epochs.rows.rotation.array[..., 1:, :]) * intervals.rotation.conjugate()
    return jnp.concatenate([turned.log().array, epochs.rows.dvel.array[..., 1:, :] - intervals.dvel.array], axis=-1)


@pytest.mark.slow
def test_perfect_sensors():
    made, exact, intervals = problem(bias="fixed")
    clean = noiseless(made)
    found, expected = measured(intervals, clean, jax.random.key(0)), from_samples(clean, exact, jax.random.key(0))
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)
    assert (found.aid, found.interval) == (expected.aid, expected.interval)


def test_biases_enter_to_first_order():
    """Large ones, on a base that swings by 10 deg: what is left is their square and the coning of the bias."""
    made, exact, intervals = problem(bias="fixed")
    quiet = noiseless(made)
    gyro = eqx.tree_at(lambda e: e.bias, quiet.gyro, jnp.array([3e-6, -2e-6, 1e-6]))
    accel = eqx.tree_at(lambda e: e.bias, quiet.accel, jnp.array([2e-3, 1e-3, -3e-3]))
    biased = dataclasses.replace(quiet, gyro=gyro, accel=accel)
    found, expected = (
        np.asarray(increments(e, intervals))
        for e in (measured(intervals, biased, jax.random.key(0)), from_samples(biased, exact, jax.random.key(0)))
    )
    assert np.abs(expected[:, :3]).max() > 2e-6
    assert np.abs(expected[:, 3:]).max() > 2e-3
    np.testing.assert_allclose(found[:, :3], expected[:, :3], atol=1e-3 * 3e-6)
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:], atol=1e-3 * 3e-3)


def test_the_same_run_has_the_same_biases_and_aid():
    made, exact, intervals = problem(outliers="fixed", gaps=((2.0, 3.0),))
    key = jax.random.key(5)
    found, expected = measured(intervals, made, key), from_samples(made, exact, key)
    np.testing.assert_array_equal(found.rows.valid, expected.rows.valid)
    assert not np.asarray(found.rows.valid)[2:4].any()
    np.testing.assert_array_equal(found.rows.velocity.array, expected.rows.velocity.array)


def test_covariance_is_that_of_the_samples():
    """Noise of the samples, whitened with the covariance of the intervals: unit variances, no correlation."""
    runs = 1500
    made, exact, intervals = problem()
    bare = dataclasses.replace(
        made,
        gyro=eqx.tree_at(lambda e: e.bias, made.gyro, jnp.zeros(3)),
        # So much gyro noise that its lever shows beside that of the accelerometers.
        accel=eqx.tree_at(lambda e: (e.bias, e.density), made.accel, (jnp.zeros(3), made.accel.density / 30)),
    )
    sampled = jax.jit(lambda ks: jax.lax.map(lambda k: from_samples(bare, exact, k), ks, batch_size=50))(keys(runs))
    drawn = eqx.filter_jit(jax.vmap(lambda k: measure_epochs(intervals, bare, k)))(keys(runs, seed=2))
    sampled, drawn = (np.asarray(increments(x, intervals)) for x in (sampled, drawn))
    for k in range(sampled.shape[1]):
        dt, n = float(exact.dt), SAMPLES
        sg, sa = float(bare.gyro.increment_sd(dt)), float(bare.accel.increment_sd(dt))
        lever = np.asarray(intervals.lever.array)[k]
        cross = np.array([[0, -lever[2], lever[1]], [lever[2], 0, -lever[0]], [-lever[1], lever[0], 0]])
        speed = sg**2 * np.asarray(intervals.scatter)[k] + n * sa**2 * np.eye(3) + n * sg**2 * cross @ cross.T
        covariance = np.block([[n * sg**2 * np.eye(3), n * sg**2 * cross], [n * sg**2 * cross.T, speed]])
        white = np.linalg.inv(np.linalg.cholesky(covariance))
        for errors in (sampled[:, k], drawn[:, k]):
            z = errors @ white.T
            assert np.abs(z.T @ z / runs - np.eye(6)).max() < 5 * np.sqrt(2 / runs)
            assert np.abs(z.mean(axis=0)).max() < 4.5 / np.sqrt(runs)


def test_a_disturbance_needs_samples():
    made = scenario("disturbed", duration=SECONDS)
    with pytest.raises(UserError, match="at IMU rate"):
        measure_epochs(problem()[2], made, jax.random.key(0))


def test_differentiable_in_the_sensors():
    made, _, intervals = problem()

    @jax.jit
    @jax.value_and_grad
    def size(density):
        some = eqx.tree_at(lambda s: s.gyro.density, made, density)
        return jnp.sum(measure_epochs(intervals, some, jax.random.key(3)).rows.dvel.x)

    at = float(made.gyro.density)
    slope = float(size(at)[1])
    for h in (1e-2, 1e-3):
        numeric = (float(size(at * (1 + h))[0]) - float(size(at * (1 - h))[0])) / (2 * h * at)
        np.testing.assert_allclose(slope, numeric, rtol=1e-4)
    assert np.isfinite(size(0.0)[1])


@pytest.mark.exact
def test_many_runs_are_the_single_ones():
    made, _, intervals = problem(outliers="segment", single_axis=True, gaps=((2.0, 3.0),))
    some = keys(5)
    together = eqx.filter_jit(measure_epochs)(intervals, made, some).rows
    for i in (0, 4):
        alone = measure_epochs(intervals, made, some[i]).rows
        for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(a if a.ndim == 1 else a[..., i], b, rtol=0, atol=1e-15)


@pytest.mark.exact
@pytest.mark.parametrize("samples", [200, 25, 2])
def test_sample_by_sample_is_measure(samples):
    """The same draws as `measure` and a preintegration, for one run and for several side by side."""
    made, exact, _ = problem(outliers="fixed", gaps=((2.0, 3.0),))
    some = keys(3)
    together = sample_epochs(exact, made, some, samples)
    alone = sample_epochs(exact, made, some[1], samples)
    dtheta, dvel, velocity = measure(exact, made, some[1])
    sparse = np.full((made.samples // samples + 1, 3), np.nan)
    sparse[:: SAMPLES // samples] = velocity
    fixed = {"dt": 1.0 / made.imu_rate, "every": samples, "site": made.site, "aid": made.aid}
    expected = epochs_from_arrays(dtheta, dvel, sparse, aid_sd=made.aid_sd, **fixed)
    assert (alone.aid, alone.interval) == (expected.aid, expected.interval)
    for a, b, c in zip(*(jax.tree.leaves(x.rows) for x in (together, alone, expected)), strict=True):
        np.testing.assert_allclose(b, c, rtol=0, atol=3e-15)
        np.testing.assert_allclose(a if a.ndim == 1 else a[..., 1], c, rtol=0, atol=3e-15)


def test_samples_of_a_shaken_base_are_refused():
    made = scenario("disturbed", duration=SECONDS)
    with pytest.raises(UserError, match="sample by sample"):
        sample_epochs(truth(made), made, jax.random.key(0), 20)
