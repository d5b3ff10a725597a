"""Sensor errors and faults of the aid."""

import equinox as eqx
import jax
import numpy as np
import pytest
from logs import with_noise
from scipy import stats
from statistical import assert_rate, assert_variance

from jaxalign.earth import STANDARD_GRAVITY, Site
from jaxalign.inertial_unit import AccelErrors, GyroErrors
from jaxalign.simulate import (
    FixedOutliers,
    JumpOutliers,
    Scenario,
    SegmentOutliers,
    SimulatedAid,
    SineForce,
    aid_values,
    draw_bias,
    measure,
    scenario,
    simulate,
    static_base,
    truth,
)
from jaxalign.simulate.sensors import triad_increments

DEG_H = np.pi / 180 / 3600
UG = STANDARD_GRAVITY * 1e-6


@eqx.filter_jit
def increments(errors, key, count, dt, kind="sign"):
    """One program instead of one for each of its operations."""
    if isinstance(errors, SineForce):
        return errors.increments(key, count, dt)
    return triad_increments(errors, kind, key, count, dt)


# --- inertial sensors -------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.01, 0.005])
def test_noise_of_increments(dt):
    """A density d gives increments of variance d^2 dt, a deviation s per sample s^2 dt^2; white, normal."""
    key, n = jax.random.key(3), 20000
    walk = GyroErrors(walk_deg_sqrt_h=0.6)
    per_sample = AccelErrors(noise_ug=500.0)
    both = AccelErrors(density_ug_sqrt_hz=3.0 / UG, noise_ug=4.0 / UG)
    cases = [
        (walk, np.deg2rad(0.6) / 60 * np.sqrt(dt)),
        (per_sample, 500 * UG * dt),
        (both, np.sqrt(9 * dt + 16 * dt**2)),
    ]
    for errors, sd in cases:
        x = np.asarray(increments(errors, key, n, dt))
        assert_variance(x, sd)
        np.testing.assert_allclose(errors.increment_sd(dt), sd, rtol=1e-12)
        assert stats.kstest(x.ravel() / sd, "norm").pvalue > 1e-4
        for lagged in (x[1:] * x[:-1], x * np.roll(x, 1, axis=1)):
            assert abs(np.mean(lagged) / sd**2) < 4.5 / np.sqrt(lagged.size)


def test_angle_random_walk_over_an_hour():
    """0.005 deg/sqrt(h): the sum over one hour has a deviation of 0.005 deg."""
    errors = GyroErrors(walk_deg_sqrt_h=0.005)
    keys = jax.random.split(jax.random.key(0), 300)
    angle = jax.jit(jax.vmap(lambda k: increments(errors, k, 3600, 1.0).sum(0)))(keys)
    assert_variance(np.rad2deg(np.asarray(angle)), 0.005)


def test_bias_kinds():
    keys = jax.random.split(jax.random.key(1), 2000)
    size = np.array([0.02, 0.03, 0.04]) * DEG_H

    def draw(kind):
        return np.asarray(jax.jit(jax.vmap(lambda key: draw_bias(GyroErrors([0.02, 0.03, 0.04]), kind, key)))(keys))

    sign, gaussian, fixed = draw("sign"), draw("gaussian"), draw("fixed")
    np.testing.assert_allclose(np.abs(sign), np.tile(size, (2000, 1)), rtol=1e-12)
    for axis in range(3):
        assert_rate((sign[:, axis] > 0).sum(), 2000, 0.5)
        assert stats.kstest(gaussian[:, axis] / size[axis], "norm").pvalue > 1e-4
    assert_rate((np.prod(sign[:, :2], axis=1) > 0).sum(), 2000, 0.5)  # axes independent
    np.testing.assert_allclose(fixed, np.tile(size, (2000, 1)), rtol=1e-12)


def test_bias_enters_every_increment():
    errors = AccelErrors(50.0)
    np.testing.assert_allclose(increments(errors, jax.random.key(0), 4, 0.005, "fixed"), 50 * UG * 0.005, rtol=1e-12)
    noisy = AccelErrors(50.0, density_ug_sqrt_hz=1.0)
    key = jax.random.key(5)
    mean = np.asarray(increments(noisy, key, 40000, 0.005)).mean(0) / 0.005
    np.testing.assert_allclose(mean, draw_bias(noisy, "sign", jax.random.split(key)[0]), atol=5 * UG / np.sqrt(200.0))


def test_bias_that_wanders():
    """60 deg/h/sqrt(h) are 1 deg/h/sqrt(s): after 100 s its changes have 10 deg/h, without memory of each other."""
    errors, dt = GyroErrors(bias_walk_deg_h_sqrt_h=[60.0, 120.0, 0.0]), 0.1
    keys = jax.random.split(jax.random.key(2), 400)
    rate = np.asarray(jax.jit(jax.vmap(lambda k: increments(errors, k, 2001, dt)))(keys)) / dt / DEG_H
    np.testing.assert_allclose(rate[:, 0], 0.0, atol=1e-12)
    for axis, size in ((0, 10.0), (1, 20.0)):
        first, second = rate[:, 1000, axis], rate[:, 2000, axis] - rate[:, 1000, axis]
        assert_variance(np.concatenate([first, second]), size)
        assert abs(np.mean(first * second)) / size**2 < 4.5 / np.sqrt(len(keys))
    assert (rate[:, :, 2] == 0).all()


def test_sine_force():
    """(28) of the Vondrak paper: five sines of half the amplitude, less what a sample averages out."""
    amplitude, dt, n = 10e-3 * STANDARD_GRAVITY, 0.005, 2000
    plain = np.asarray(increments(SineForce.of_mg(10.0, random_start=False), jax.random.key(0), n, dt))
    edges = np.arange(n + 1) * dt
    primitive = sum(-np.cos(2 * np.pi * f * edges) / (2 * np.pi * f) for f in (1, 5, 10, 20, 50))
    np.testing.assert_allclose(plain, np.tile(np.diff(primitive)[:, None] * amplitude / 2, (1, 3)), atol=1e-14)
    keys = jax.random.split(jax.random.key(0), 50)
    drawn = np.asarray(jax.jit(jax.vmap(lambda k: SineForce(amplitude).increments(k, n, dt)[:, 0]))(keys)) / dt
    spectrum = np.abs(np.fft.rfft(drawn, axis=1)) / n * 2
    lines = (np.array([1, 5, 10, 20, 50]) * n * dt).astype(int)
    np.testing.assert_allclose(
        spectrum[:, lines],
        np.tile(amplitude / 2 * np.sinc(np.array([1, 5, 10, 20, 50]) * dt), (50, 1)),
        rtol=1e-9,
    )
    assert np.unique(drawn[:, 0].round(9)).size == 50


def test_frozen_disturbance(shared):
    """The frozen shaken base has the same amplitudes, one common start time, noise and size of errors."""
    z = np.load(shared / "cases" / "disturbed_align_c2_10mg.npz")
    setting = scenario("disturbed", condition=2, amplitude_mg=10.0, noise_per="density", duration=60.0)
    t = truth(setting)
    dtheta, dvel, values = eqx.filter_jit(measure)(t, setting, jax.random.key(1))
    assert values == ()
    np.testing.assert_allclose(t.C_nb, z["C_nb_true"], atol=1e-14)
    frequency, dt = np.array([1, 5, 10, 20, 50]), 0.005
    middle = (np.arange(12000) + 0.5) * dt
    columns = np.exp(-2j * np.pi * frequency[:, None] * middle) * 2 / 12000
    ours, theirs = columns @ np.asarray(dvel) / dt, columns @ z["dvel"] / dt
    half, scatter = 5e-3 * STANDARD_GRAVITY, 5 * np.sqrt(200.0) * 50 * UG * np.sqrt(2 / 12000)
    np.testing.assert_allclose(np.abs(ours), half * np.sinc(frequency * dt)[:, None] * np.ones(3), atol=scatter)
    np.testing.assert_allclose(np.abs(theirs), half, atol=scatter)  # point samples there
    for lines in (ours, theirs):  # phase = 2 pi f shift - pi/2: those of 5 and 10 Hz follow from that of 1 Hz
        shift = (np.angle(lines[0, 0]) + np.pi / 2) / (2 * np.pi)
        model = np.exp(1j * (2 * np.pi * frequency[:3] * shift - np.pi / 2))
        np.testing.assert_allclose(lines[:3, 0] / np.abs(lines[:3, 0]), model, atol=0.1)
    for got, case in ((dtheta, z["dtheta"]), (dvel, z["dvel"])):
        ratio = np.var(np.diff(got[:, 2], n=4)) / np.var(np.diff(case[:, 2], n=4))
        assert 0.8 < ratio < 1.25


# --- faults of the aid ------------------------------------------------------------------------------------


@eqx.filter_jit
def faulty(fault, keys, t, noise):
    return jax.vmap(fault, (0, None, 0))(keys, t, noise)


def apply(fault, epochs=301, runs=400, dt=1.0, seed=0):
    """Errors without and with the fault, (runs, epochs, 3), for unit noise."""
    keys = jax.random.split(jax.random.key(seed), runs)
    noise = np.random.default_rng(99).normal(size=(runs, epochs, 3))
    return noise, np.asarray(faulty(fault, keys, np.arange(epochs) * dt, noise))


def test_fixed_outliers_hit_whole_vectors():
    noise, error = apply(FixedOutliers(0.02, 300.0))
    hit = error != noise
    assert not hit[:, 0].any()
    assert np.array_equal(hit.any(-1), hit.all(-1))
    assert_rate(hit[:, 1:, 0].sum(), 400 * 300, 0.02)
    np.testing.assert_allclose(error[hit], 300 * noise[hit], rtol=1e-12)
    assert_variance(error[hit], 300.0)


def test_fixed_outliers_on_a_single_axis():
    noise, error = apply(FixedOutliers(0.05, 10.0, single_axis=True))
    hit = error != noise
    assert set(np.unique(hit.sum(-1))) == {0, 1}
    total = hit.sum()
    assert_rate(total, 400 * 300, 0.05)
    for axis in range(3):
        assert_rate(hit[..., axis].sum(), total, 1 / 3)


@pytest.mark.parametrize(("first", "expected"), [("never", 0.0), ("random", 0.3), ("always", 1.0)])
@pytest.mark.parametrize("kind", [FixedOutliers, JumpOutliers, SegmentOutliers])
def test_epoch_zero(kind, first, expected):
    fault = kind(probability=[0.3] * 5, first=first) if kind is SegmentOutliers else kind(0.3, first=first)
    noise, error = apply(fault, epochs=3)
    assert_rate((error != noise)[:, 0, 0].sum(), 400, expected)
    assert_rate((error != noise)[:, 1, 0].sum(), 400, 0.3)


def test_segment_outliers_follow_table_3():
    """Shen et al. (2025), Table 3: rate and size per minute."""
    noise, error = apply(SegmentOutliers(), epochs=1501, runs=300, dt=0.2)
    hit = (error != noise)[..., 0]
    table = [(0.001, 10), (0.010, 50), (0.015, 100), (0.020, 150), (0.020, 200)]
    for segment, (probability, factor) in enumerate(table):
        here = slice(max(1, 300 * segment), 300 * (segment + 1) + (segment == 4))
        assert_rate(hit[:, here].sum(), hit[:, here].size, probability)
        rows = hit[:, here]
        np.testing.assert_allclose(error[:, here][rows], factor * noise[:, here][rows], rtol=1e-12)


def test_jump_outliers():
    noise, error = apply(JumpOutliers(0.1, 20.0, 50.0))
    jump = error - noise
    size = np.linalg.norm(jump, axis=-1)
    hit = size > 0
    assert_rate(hit[:, 1:].sum(), 400 * 300, 0.1)
    assert stats.kstest((size[hit] - 20) / 30, "uniform").pvalue > 1e-4
    # A coordinate of a uniformly distributed direction is uniform (Archimedes).
    for axis in range(3):
        assert stats.kstest((jump[hit][:, axis] / size[hit] + 1) / 2, "uniform").pvalue > 1e-4


@pytest.mark.exact
def test_gaps_and_composition():
    setting = scenario("dvl-sturn", outliers="fixed", gaps=((30, 40), (100.5, 102)), duration=150.0)
    velocity = simulate(setting, 1).aids[0].value
    missing = np.isnan(velocity)
    assert np.array_equal(missing.any(1), missing.all(1))
    assert np.flatnonzero(missing[:, 0]).tolist() == [*range(30, 41), 101, 102]
    without = simulate("dvl-sturn", 1, outliers="fixed", duration=150.0).aids[0].value
    np.testing.assert_array_equal(velocity[~missing], without[~missing])


def test_two_faults_draw_independently():
    """Two of the same kind on one aid: both at a quarter of the epochs, not at half of them."""
    faults = (FixedOutliers(0.5, 1e3), FixedOutliers(0.5, 1e3))
    aids = (SimulatedAid("body", 1.0, faults),)
    setting = Scenario(static_base(), Site(0.5), aids=aids, duration=2000.0, imu_rate=1.0, epoch_samples=1)
    key, exact = jax.random.key(4), truth(setting)
    velocity = eqx.filter_jit(aid_values)
    base = np.asarray(velocity(exact, with_noise(setting, faults=()), key)[0])
    factor = np.round(np.log10(np.asarray(velocity(exact, setting, key)[0]) / base)[1:, 0])
    for exponent, probability in ((0, 0.25), (3, 0.5), (6, 0.25)):
        assert_rate((factor == exponent).sum(), 2000, probability)
