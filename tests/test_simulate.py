"""Sensor errors, faults of the aid, scenarios by name, and the log that comes out."""

import dataclasses
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxalign.earth import STANDARD_GRAVITY, Site
from jaxalign.errors import UserError
from jaxalign.simulate import (
    FixedOutliers,
    Gap,
    JumpOutliers,
    Scenario,
    SegmentOutliers,
    SineForce,
    TriadErrors,
    accel_errors,
    aid_velocity,
    gyro_errors,
    imu_increments,
    measure,
    noiseless,
    s_turn,
    scenario,
    scenario_options,
    scenarios,
    simulate,
    static_base,
    truth,
)

DEG_H = np.pi / 180 / 3600
UG = STANDARD_GRAVITY * 1e-6


def assert_variance(x, sd):
    """The sample variance lies in the central 99.99 % of its distribution."""
    n = x.size
    low, high = stats.chi2.ppf([5e-5, 1 - 5e-5], n) / n
    assert low < np.mean(np.square(x / sd)) < high


def assert_rate(hits, trials, probability):
    """The number of hits lies in the central 99.99 % of the binomial distribution."""
    low, high = stats.binom.ppf([5e-5, 1 - 5e-5], trials, probability)
    assert low <= hits <= high


@pytest.fixture(scope="module")
def sturn():
    setting = scenario("dvl-sturn", outliers="fixed")
    return setting, truth(setting)


# --- inertial sensors -------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.01, 0.005])
def test_noise_of_increments(dt):
    """A density d gives increments of variance d^2 dt, a deviation s per sample s^2 dt^2; white, normal."""
    key, n = jax.random.key(3), 20000
    walk = gyro_errors(walk_deg_sqrt_h=0.6)
    per_sample = accel_errors(noise_ug=500.0)
    both = TriadErrors(density=3.0, sample_sd=4.0)
    cases = [
        (walk, np.deg2rad(0.6) / 60 * np.sqrt(dt)),
        (per_sample, 500 * UG * dt),
        (both, np.sqrt(9 * dt + 16 * dt**2)),
    ]
    for errors, sd in cases:
        x = np.asarray(errors.increments(key, n, dt))
        assert_variance(x, sd)
        np.testing.assert_allclose(errors.increment_sd(dt), sd, rtol=1e-12)
        assert stats.kstest(x.ravel() / sd, "norm").pvalue > 1e-4
        for lagged in (x[1:] * x[:-1], x * np.roll(x, 1, axis=1)):
            assert abs(np.mean(lagged) / sd**2) < 4.5 / np.sqrt(lagged.size)


def test_angle_random_walk_over_an_hour():
    """0.005 deg/sqrt(h): the sum over one hour has a deviation of 0.005 deg."""
    errors = gyro_errors(walk_deg_sqrt_h=0.005)
    angle = jax.vmap(lambda k: errors.increments(k, 3600, 1.0).sum(0))(jax.random.split(jax.random.key(0), 300))
    assert_variance(np.rad2deg(np.asarray(angle)), 0.005)


def test_bias_kinds():
    keys = jax.random.split(jax.random.key(1), 2000)
    size = np.array([0.02, 0.03, 0.04]) * DEG_H

    def draw(kind):
        return np.asarray(jax.vmap(gyro_errors([0.02, 0.03, 0.04], kind=kind).draw_bias)(keys))

    sign, gaussian, fixed = draw("sign"), draw("gaussian"), draw("fixed")
    np.testing.assert_allclose(np.abs(sign), np.tile(size, (2000, 1)), rtol=1e-12)
    for axis in range(3):
        assert_rate((sign[:, axis] > 0).sum(), 2000, 0.5)
        assert stats.kstest(gaussian[:, axis] / size[axis], "norm").pvalue > 1e-4
    assert_rate((np.prod(sign[:, :2], axis=1) > 0).sum(), 2000, 0.5)  # axes independent
    np.testing.assert_allclose(fixed, np.tile(size, (2000, 1)), rtol=1e-12)


def test_bias_enters_every_increment():
    errors = accel_errors(50.0, kind="fixed")
    np.testing.assert_allclose(errors.increments(jax.random.key(0), 4, 0.005), 50 * UG * 0.005, rtol=1e-12)
    noisy = accel_errors(50.0, density_ug_sqrt_hz=1.0)
    key = jax.random.key(5)
    mean = np.asarray(noisy.increments(key, 40000, 0.005)).mean(0) / 0.005
    np.testing.assert_allclose(mean, noisy.draw_bias(jax.random.split(key)[0]), atol=5 * UG / np.sqrt(200.0))


def test_sine_force():
    """(28) of the Vondrak paper: five sines of half the amplitude, less what a sample averages out."""
    amplitude, dt, n = 10e-3 * STANDARD_GRAVITY, 0.005, 2000
    plain = np.asarray(SineForce.of_mg(10.0, random_start=False).increments(jax.random.key(0), n, dt))
    edges = np.arange(n + 1) * dt
    primitive = sum(-np.cos(2 * np.pi * f * edges) / (2 * np.pi * f) for f in (1, 5, 10, 20, 50))
    np.testing.assert_allclose(plain, np.tile(np.diff(primitive)[:, None] * amplitude / 2, (1, 3)), atol=1e-14)
    keys = jax.random.split(jax.random.key(0), 50)
    drawn = np.asarray(jax.vmap(lambda k: SineForce(amplitude).increments(k, n, dt)[:, 0])(keys)) / dt
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
    dtheta, dvel, velocity = measure(t, setting, jax.random.key(1))
    assert velocity is None
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


def apply(fault, epochs=301, runs=400, dt=1.0, seed=0):
    """Errors without and with the fault, (runs, epochs, 3), for unit noise."""
    keys = jax.random.split(jax.random.key(seed), runs)
    t = jnp.arange(epochs) * dt
    noise = jax.random.normal(jax.random.key(99), (runs, epochs, 3))
    return np.asarray(noise), np.asarray(jax.vmap(fault, (0, None, 0))(keys, t, noise))


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


def test_gaps_and_composition():
    setting = scenario("dvl-sturn", outliers="fixed", gaps=((30, 40), (100.5, 102)), duration=150.0)
    velocity = simulate(setting, 1).velocity
    missing = np.isnan(velocity)
    assert np.array_equal(missing.any(1), missing.all(1))
    assert np.flatnonzero(missing[:, 0]).tolist() == [*range(30, 41), 101, 102]
    without = simulate("dvl-sturn", 1, outliers="fixed", duration=150.0).velocity
    np.testing.assert_array_equal(velocity[~missing], without[~missing])


def test_two_faults_draw_independently():
    """Two of the same kind on one aid: both at a quarter of the epochs, not at half of them."""
    faults = (FixedOutliers(0.5, 1e3), FixedOutliers(0.5, 1e3))
    setting = Scenario(static_base(), Site(0.5), aid_sd=1.0, faults=faults, duration=2000.0, imu_rate=1.0, aid_every=1)
    key, exact = jax.random.key(4), truth(setting)
    base = aid_velocity(exact, eqx.tree_at(lambda s: s.faults, setting, ()), key)
    factor = np.round(np.log10(np.asarray(aid_velocity(exact, setting, key) / base))[1:, 0])
    for exponent, probability in ((0, 0.25), (3, 0.5), (6, 0.25)):
        assert_rate((factor == exponent).sum(), 2000, probability)


# --- scenarios --------------------------------------------------------------------------------------------


def test_sturn_log_has_the_declared_errors(sturn):
    setting, exact = sturn
    log = simulate(setting, 7, truth_of=exact)
    assert (log.aid, log.aid_every, log.epochs, log.dt) == ("body", 200, 300, 0.005)
    assert log.duration == pytest.approx(300.0)
    assert (log.aid_sd, log.name) == (0.1, "dvl-sturn")
    assert np.rad2deg([log.lat, log.lon]) == pytest.approx([32.057313, 118.786365])
    np.testing.assert_array_equal(log.C_nb, exact.C_nb)
    assert all(a.dtype == np.float64 for a in (log.dtheta, log.dvel, log.velocity, log.C_nb))
    gyro, accel = (log.dtheta - exact.dtheta) / log.dt, (log.dvel - exact.dvel) / log.dt
    gyro_sd, accel_sd = np.deg2rad(0.005) / 60 / np.sqrt(log.dt), 50 * UG / np.sqrt(log.dt)
    for rate, bias, sd in ((gyro, 0.02 * DEG_H, gyro_sd), (accel, 50 * UG, accel_sd)):
        mean = rate.mean(0)
        np.testing.assert_allclose(np.abs(mean), bias, atol=4.5 * sd / np.sqrt(len(rate)))
        assert_variance(rate - np.sign(mean) * bias, sd)
    error = log.velocity - exact.velocity_b
    hit = np.abs(error).max(1) > 0.6
    assert_variance(error[~hit], 0.1)


def test_seed_decides_everything(sturn):
    setting, exact = sturn
    a, b, c = (simulate(setting, seed, truth_of=exact) for seed in (5, 5, 6))
    for name in ("dtheta", "dvel", "velocity"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert not np.any(getattr(a, name) == getattr(c, name))
    by_name = simulate("dvl-sturn", 5, outliers="fixed")
    np.testing.assert_array_equal(by_name.dvel, a.dvel)


def test_sources_draw_independently(sturn):
    """Switching outliers on leaves the other draws alone, and so does measuring the aid without the IMU."""
    setting, exact = sturn
    key = jax.random.key(2)
    clean = scenario("dvl-sturn")
    dtheta, dvel, velocity = measure(exact, setting, key)
    dtheta_clean, dvel_clean, velocity_clean = measure(exact, clean, key)
    np.testing.assert_array_equal(dtheta, dtheta_clean)
    np.testing.assert_array_equal(dvel, dvel_clean)
    same = (velocity == velocity_clean).all(1)
    assert 0.9 < same.mean() < 1.0
    np.testing.assert_array_equal(aid_velocity(exact, setting, key), velocity)
    np.testing.assert_array_equal(imu_increments(exact, setting, key)[1], dvel)
    gyro, accel = (dtheta - exact.dtheta).ravel(), (dvel - exact.dvel).ravel()
    assert abs(np.corrcoef(gyro, accel)[0, 1]) < 4.5 / np.sqrt(gyro.size)


def test_noise_free():
    exact = truth(scenario("dvl-accturn", duration=20.0))
    log = simulate("dvl-accturn", 3, noise=False, outliers="fixed", gaps=((4, 5),), duration=20.0)
    np.testing.assert_array_equal(log.dtheta, exact.dtheta)
    np.testing.assert_array_equal(log.dvel, exact.dvel)
    inside = (exact.t > 3.99) & (exact.t < 5.01)
    assert np.isnan(log.velocity[inside]).all()
    np.testing.assert_array_equal(log.velocity[~inside], exact.velocity_b[~inside])
    assert log.aid_sd == 0.05


def test_nav_aid_measures_in_n():
    setting = scenario("gps-zigzag", duration=60.0)
    exact = truth(setting)
    np.testing.assert_array_equal(simulate(setting, 0, noise=False).velocity, exact.velocity_n)
    error = simulate(setting, 0).velocity - exact.velocity_n
    assert_variance(error, 1.0)


def test_static_scenarios_have_no_aid():
    for name, epoch in (("sway", 0.1), ("disturbed", 0.1)):
        log = simulate(name, 0, duration=2.0)
        assert (log.aid, log.velocity, log.aid_sd) == ("static", None, None)
        assert log.dt * log.aid_every == pytest.approx(epoch)
        assert log.epochs == 20


def test_disturbed_conditions():
    """Table 2 of the Vondrak paper; the amplitude is the accelerometer bias unless given."""
    for condition, gyro, accel in ((1, 0.1, 50), (2, 0.1, 50), (3, 0.02, 10), (4, 0.02, 10)):
        s = scenario("disturbed", condition=condition)
        np.testing.assert_allclose(s.gyro.bias, gyro * DEG_H, rtol=1e-12)
        np.testing.assert_allclose(s.accel.bias, accel * UG, rtol=1e-12)
        assert (s.force is None) == (condition in (1, 3))
        if s.force is not None:
            assert float(s.force.amplitude) == pytest.approx(accel * UG)
    assert float(scenario("disturbed", amplitude_mg=10).force.amplitude) == pytest.approx(0.0980665)
    per_sample, density = (scenario("disturbed", noise_per=n) for n in ("sample", "density"))
    assert float(per_sample.gyro.increment_sd(0.005)) == pytest.approx(0.05 * DEG_H * 0.005)
    assert float(density.gyro.increment_sd(0.005)) == pytest.approx(0.05 * DEG_H * np.sqrt(0.005))
    # Noise-free, the shaking stays: it belongs to the base, not to the sensor.
    still = simulate("disturbed", 1, noise=False, condition=1, duration=1.0)
    shaken = simulate("disturbed", 1, noise=False, condition=2, amplitude_mg=10, duration=1.0)
    assert np.ptp(still.dvel, axis=0).max() < 1e-15
    assert np.ptp(shaken.dvel, axis=0).min() > 1e-3 * STANDARD_GRAVITY * 0.005


def test_sway_mean_yaw():
    log = simulate("sway", 0, mean_yaw_deg=40.0, duration=10.0)
    np.testing.assert_allclose(np.arctan2(-log.C_nb[0, 0, 1], log.C_nb[0, 1, 1]), np.deg2rad(40.0), rtol=1e-12)


@pytest.mark.parametrize("name", list(scenarios()))
def test_every_scenario_runs(name):
    line = scenarios()[name]
    assert 20 < len(line) < 110
    log = simulate(name, 0, duration=4.0)
    assert log.name.startswith(name)
    assert len(log.dtheta) == log.epochs * log.aid_every
    assert len(log.C_nb) == log.epochs + 1
    assert log.warnings == ()
    # Sanity of units: close to 1 g, and far slower than a radian per second.
    assert np.linalg.norm(log.dvel, axis=1).mean() / log.dt == pytest.approx(9.8, abs=0.5)
    assert np.abs(log.dtheta).max() / log.dt < 1.0


def test_vmap_over_keys_is_the_loop(sturn):
    setting = scenario("dvl-sturn", outliers="segment", duration=5.0)
    exact = truth(setting)
    keys = jax.random.split(jax.random.key(0), 3)
    batch = jax.vmap(measure, (None, None, 0))(exact, setting, keys)
    for i, key in enumerate(keys):
        for together, alone in zip(batch, measure(exact, setting, key), strict=True):
            np.testing.assert_allclose(together[i], alone, rtol=1e-14)


def test_seeds_and_numbers_do_not_recompile():
    traces = []

    @eqx.filter_jit
    def run(t, s, key):
        traces.append(1)
        return measure(t, s, key)

    setting = scenario("dvl-sturn", outliers="fixed", duration=2.0)
    exact = truth(setting)
    run(exact, setting, jax.random.key(0))
    run(exact, setting, jax.random.key(1))
    changed = eqx.tree_at(lambda s: (s.aid_sd, s.faults[0].factor, s.gyro.density), setting, replace_fn=lambda x: x * 2)
    run(exact, changed, jax.random.key(0))
    run(exact, noiseless(setting), jax.random.key(0))
    run(truth(scenario("dvl-sturn", outliers="fixed", duration=2.0)), setting, jax.random.key(0))
    assert len(traces) == 1


def test_measurement_is_differentiable_in_the_errors():
    setting = scenario("disturbed", duration=1.0)
    exact = truth(setting)

    def energy(s):
        dtheta, dvel, _ = measure(exact, s, jax.random.key(0))
        return jnp.sum(dtheta**2) * 1e6 + jnp.sum(dvel**2)

    gradient = eqx.filter_grad(energy)(setting)
    for get in (lambda s: s.gyro.bias, lambda s: s.accel.sample_sd, lambda s: s.force.amplitude):
        direction = np.asarray(get(setting)).mean() * 1e-2
        up, down = (energy(eqx.tree_at(get, setting, replace_fn=lambda x, d=d: x + d)) for d in (direction, -direction))
        np.testing.assert_allclose(jnp.sum(get(gradient)) * 2 * direction, up - down, rtol=1e-4)
    # A deviation of zero has a finite gradient too.
    assert np.all(np.isfinite(jax.tree.leaves(eqx.filter_grad(energy)(noiseless(setting)).gyro)[1]))


# --- what a user gets wrong -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: scenario("dvl-strun"), r"unknown scenario 'dvl-strun'; did you mean 'dvl-sturn'"),
        (lambda: scenario("xyz"), r"unknown scenario 'xyz'; known: dvl-sturn, dvl-accturn"),
        (lambda: scenario_options("gps"), "unknown scenario 'gps'"),
        (lambda: scenario("dvl-sturn", outlier="fixed"), "no option 'outlier'; did you mean 'outliers'"),
        (
            lambda: scenario("dvl-sturn", outliers="fix"),
            "outliers: unknown value 'fix'; did you mean 'fixed'",
        ),
        (lambda: scenario("disturbed", condition=5), "condition: unknown value 5; known: 1, 2, 3, 4"),
        (lambda: scenario("disturbed", condition=1, amplitude_mg=1.0), "condition 1 is undisturbed"),
        (lambda: scenario("disturbed", amplitude_mg=-1.0), "amplitude_mg: must be at least 0"),
        (lambda: scenario("disturbed", noise_per="psd"), "noise_per: unknown value 'psd'"),
        (lambda: simulate("disturbed", 1, noise="density"), "noise: unknown value 'density'"),
        (lambda: scenario("dvl-sturn", single_axis="yes"), "single_axis: unknown value 'yes'"),
        (lambda: scenario("dvl-sturn", bias="normal"), "kind of bias: unknown value 'normal'"),
        (lambda: scenario("dvl-sturn", duration=10.5), r"duration: 10\.5 s are 10\.5 epochs of 1 s"),
        (lambda: scenario("dvl-sturn", duration="long"), "duration: expected a number"),
        (lambda: scenario("dvl-sturn", duration=0), "at least one"),
        (lambda: scenario("dvl-sturn", gaps=(30, 40)), "gaps: expected pairs of times"),
        (lambda: scenario("gps-zigzag", sway="yes"), "sway: unknown value 'yes'"),
        (lambda: Gap(40.0, 30.0), "ends .* before it starts"),
        (lambda: FixedOutliers(1.5), "outlier probability: must be between 0 and 1"),
        (lambda: FixedOutliers(0.1, first="sometimes"), "first: unknown value"),
        (lambda: SegmentOutliers(ends=[10.0, 20.0]), "2 ends, 5 probabilities and 5 factors"),
        (lambda: SegmentOutliers([2.0, 1.0], [0.1, 0.1], [2.0, 2.0]), "must increase"),
        (lambda: gyro_errors(walk_deg_sqrt_h=-1.0), "walk_deg_sqrt_h: must be at least 0"),
        (lambda: gyro_errors(float("nan")), "bias_deg_h: must be finite"),
        (lambda: simulate("dvl-sturn", "one"), "seed: must be a whole number"),
        (lambda: simulate(Scenario(s_turn(), Site(0.5)), 1, sway=True), "options sway go with"),
        (lambda: Scenario(s_turn(), Site(0.5), aid="dvl"), "aid: unknown value 'dvl'"),
        (lambda: Scenario(s_turn(), Site(0.5), aid_every=0), "aid_every: must be a whole number"),
        (lambda: Scenario(s_turn(), Site(0.5), imu_rate=-5.0), "imu_rate: must be a positive number"),
        (lambda: Scenario(s_turn(), Site(0.5), aid_sd=-0.1), "aid_sd: must be at least 0"),
    ],
)
def test_messages(call, message):
    with pytest.raises(UserError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_options_as_text():
    """As the command line hands them over."""
    text = scenario("dvl-sturn", outliers="fixed", single_axis="true", gaps="[[3, 4]]", duration="5")
    plain = scenario("dvl-sturn", outliers="fixed", single_axis=True, gaps=((3, 4),), duration=5)
    assert eqx.tree_equal(text, plain)
    assert eqx.tree_equal(
        scenario("disturbed", condition="4", amplitude_mg="2.5"),
        scenario("disturbed", condition=4, amplitude_mg=2.5),
    )


def test_foreign_truth(sturn):
    setting, exact = sturn
    shorter = dataclasses.replace(setting, duration=10.0)
    with pytest.raises(UserError, match="do not belong to scenario 'dvl-sturn'"):
        simulate(shorter, 1, truth_of=exact)


def test_own_scenario():
    """What a user writes: an own trajectory, own sensors."""
    setting = Scenario(
        static_base(yaw_deg=90.0), Site(0.5), gyro=gyro_errors(1.0), duration=2.0, imu_rate=50.0, aid_every=10
    )
    log = simulate(setting, 0)
    assert log.epochs == 10
    np.testing.assert_array_equal(log.velocity, 0.0)


def test_single_precision_is_refused():
    code = (
        "from jaxalign.simulate import simulate\nfrom jaxalign.errors import UserError\n"
        "try:\n    simulate('dvl-sturn', 1)\nexcept UserError as e:\n    print(e)\n"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "jax_enable_x64" in done.stdout
