"""Scenarios by name, and the log that comes out."""

import dataclasses
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from statistical import assert_variance

from jaxalign.earth import STANDARD_GRAVITY, Site
from jaxalign.errors import UserError
from jaxalign.inertial_unit import GyroErrors, ImuErrors
from jaxalign.simulate import (
    FixedOutliers,
    Gap,
    Scenario,
    SegmentOutliers,
    SimulatedAid,
    aid_values,
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
SECONDS = 4.0  # one length: one program for the truth of each trajectory


@pytest.fixture(scope="module")
def sturn():
    setting = scenario("dvl-sturn", outliers="fixed")
    return setting, truth(setting)


def test_sturn_log_has_the_declared_errors(sturn):
    setting, exact = sturn
    log = simulate(setting, 7, truth_of=exact)
    assert (log.aids[0].name, log.epoch_samples, log.epochs, log.dt) == ("body", 200, 300, 0.005)
    assert log.duration == pytest.approx(300.0)
    assert (log.aids[0].sd, log.name) == (0.1, "dvl-sturn")
    assert np.rad2deg([log.lat, log.lon]) == pytest.approx([32.057313, 118.786365])
    np.testing.assert_array_equal(log.C_nb, exact.C_nb)
    assert all(a.dtype == np.float64 for a in (log.dtheta, log.dvel, log.aids[0].value, log.C_nb))
    gyro, accel = (log.dtheta - exact.dtheta) / log.dt, (log.dvel - exact.dvel) / log.dt
    gyro_sd, accel_sd = np.deg2rad(0.005) / 60 / np.sqrt(log.dt), 50 * UG / np.sqrt(log.dt)
    for rate, bias, sd in ((gyro, 0.02 * DEG_H, gyro_sd), (accel, 50 * UG, accel_sd)):
        mean = rate.mean(0)
        np.testing.assert_allclose(np.abs(mean), bias, atol=4.5 * sd / np.sqrt(len(rate)))
        assert_variance(rate - np.sign(mean) * bias, sd)
    error = log.aids[0].value - exact.velocity_b
    hit = np.abs(error).max(1) > 0.6
    assert_variance(error[~hit], 0.1)


def test_seed_decides_everything(sturn):
    setting, exact = sturn
    a, b, c = (simulate(setting, seed, truth_of=exact) for seed in (5, 5, 6))
    for one, same, other in zip(*((x.dtheta, x.dvel, x.aids[0].value) for x in (a, b, c)), strict=True):
        np.testing.assert_array_equal(one, same)
        assert not np.any(one == other)
    by_name = simulate("dvl-sturn", 5, outliers="fixed")
    np.testing.assert_array_equal(by_name.dvel, a.dvel)


def test_sources_draw_independently(sturn):
    """Switching outliers on leaves the other draws alone, and so does measuring the aid without the IMU."""
    setting, exact = sturn
    key = jax.random.key(2)
    clean = scenario("dvl-sturn")
    dtheta, dvel, (velocity,) = measure(exact, setting, key)
    dtheta_clean, dvel_clean, (velocity_clean,) = measure(exact, clean, key)
    np.testing.assert_array_equal(dtheta, dtheta_clean)
    np.testing.assert_array_equal(dvel, dvel_clean)
    same = (velocity == velocity_clean).all(1)
    assert 0.9 < same.mean() < 1.0
    np.testing.assert_array_equal(aid_values(exact, setting, key)[0], velocity)
    np.testing.assert_array_equal(imu_increments(exact, setting, key)[1], dvel)
    gyro, accel = (dtheta - exact.dtheta).ravel(), (dvel - exact.dvel).ravel()
    assert abs(np.corrcoef(gyro, accel)[0, 1]) < 4.5 / np.sqrt(gyro.size)


def test_noise_free():
    exact = truth(scenario("dvl-accturn", duration=SECONDS))
    log = simulate("dvl-accturn", 3, noise=False, outliers="fixed", gaps=((2, 3),), duration=SECONDS)
    np.testing.assert_array_equal(log.dtheta, exact.dtheta)
    np.testing.assert_array_equal(log.dvel, exact.dvel)
    inside = (np.asarray(exact.t) > 1.99) & (np.asarray(exact.t) < 3.01)
    assert np.isnan(log.aids[0].value[inside]).all()
    np.testing.assert_allclose(log.aids[0].value[~inside], np.asarray(exact.velocity_b)[~inside], atol=1e-14)
    assert log.aids[0].sd == 0.05


def test_nav_aid_measures_in_n():
    setting = scenario("gps-zigzag", duration=SECONDS)
    exact = np.asarray(truth(setting).velocity_n)
    np.testing.assert_array_equal(simulate(setting, 0, noise=False).aids[0].value, exact)
    assert_variance(np.array([simulate(setting, seed).aids[0].value - exact for seed in range(12)]), 1.0)


def test_static_scenarios_have_no_aid():
    for name, epoch in (("sway", 0.1), ("disturbed", 0.1)):
        log = simulate(name, 0, duration=SECONDS)
        assert log.standing
        assert log.dt * log.epoch_samples == pytest.approx(epoch)
        assert log.epochs == 40


def test_disturbed_conditions():
    """Table 2 of the Vondrak paper; the amplitude is the accelerometer bias unless given."""
    for condition, gyro, accel in ((1, 0.1, 50), (2, 0.1, 50), (3, 0.02, 10), (4, 0.02, 10)):
        s = scenario("disturbed", condition=condition)
        np.testing.assert_allclose(s.imu.gyro.bias, gyro * DEG_H, rtol=1e-12)
        np.testing.assert_allclose(s.imu.accel.bias, accel * UG, rtol=1e-12)
        assert (s.force is None) == (condition in (1, 3))
        if s.force is not None:
            assert float(s.force.amplitude) == pytest.approx(accel * UG)
    assert float(scenario("disturbed", amplitude_mg=10).force.amplitude) == pytest.approx(0.0980665)
    per_sample, density = (scenario("disturbed", noise_per=n) for n in ("sample", "density"))
    assert float(per_sample.imu.gyro.increment_sd(0.005)) == pytest.approx(0.05 * DEG_H * 0.005)
    assert float(density.imu.gyro.increment_sd(0.005)) == pytest.approx(0.05 * DEG_H * np.sqrt(0.005))
    # Noise-free, the shaking stays: it belongs to the base, not to the sensor.
    still = simulate("disturbed", 1, noise=False, condition=1, duration=SECONDS)
    shaken = simulate("disturbed", 1, noise=False, condition=2, amplitude_mg=10, duration=SECONDS)
    assert np.ptp(still.dvel, axis=0).max() < 1e-15
    assert np.ptp(shaken.dvel, axis=0).min() > 1e-3 * STANDARD_GRAVITY * 0.005


def test_sway_mean_yaw():
    log = simulate("sway", 0, mean_yaw_deg=40.0, duration=SECONDS)
    np.testing.assert_allclose(np.arctan2(-log.C_nb[0, 0, 1], log.C_nb[0, 1, 1]), np.deg2rad(40.0), rtol=1e-12)


@pytest.mark.parametrize("name", list(scenarios()))
def test_every_scenario_runs(name):
    line = scenarios()[name]
    assert 20 < len(line) < 110
    log = simulate(name, 0, duration=SECONDS)
    assert log.name.startswith(name)
    assert len(log.dtheta) == log.epochs * log.epoch_samples
    assert len(log.C_nb) == log.epochs + 1
    assert log.warnings == ()
    # Sanity of units: close to 1 g, and far slower than a radian per second.
    assert np.linalg.norm(log.dvel, axis=1).mean() / log.dt == pytest.approx(9.8, abs=0.5)
    assert np.abs(log.dtheta).max() / log.dt < 1.0


def test_vmap_over_keys_is_the_loop(sturn):
    """But for the rounding of normal numbers in float32."""
    setting = scenario("dvl-sturn", outliers="segment", duration=SECONDS)
    exact = truth(setting)
    keys = jax.random.split(jax.random.key(0), 3)
    batch = eqx.filter_jit(jax.vmap(measure, (None, None, 0)))(exact, setting, keys)
    for i, key in enumerate(keys):
        for together, alone in zip(
            *map(jax.tree.leaves, (batch, eqx.filter_jit(measure)(exact, setting, key))), strict=True
        ):
            np.testing.assert_allclose(together[i], alone, rtol=0, atol=1e-7 * np.abs(alone).max())


def test_seeds_and_numbers_do_not_recompile():
    traces = []

    @eqx.filter_jit
    def run(t, s, key):
        traces.append(1)
        return measure(t, s, key)

    setting = scenario("dvl-sturn", outliers="fixed", duration=SECONDS)
    exact = truth(setting)
    run(exact, setting, jax.random.key(0))
    run(exact, setting, jax.random.key(1))
    changed = eqx.tree_at(
        lambda s: (s.aids[0].sd, s.aids[0].faults[0].factor, s.imu.gyro.walk_deg_sqrt_h),
        setting,
        replace_fn=lambda x: x * 2,
    )
    run(exact, changed, jax.random.key(0))
    run(exact, noiseless(setting), jax.random.key(0))
    run(truth(scenario("dvl-sturn", outliers="fixed", duration=SECONDS)), setting, jax.random.key(0))
    assert len(traces) == 1


def test_measurement_is_differentiable_in_the_errors():
    setting = scenario("disturbed", duration=SECONDS)
    exact = truth(setting)

    @eqx.filter_jit
    @eqx.filter_value_and_grad
    def both(s):
        dtheta, dvel, _ = measure(exact, s, jax.random.key(0))
        return jnp.sum(dtheta**2) * 1e6 + jnp.sum(dvel**2)

    gradient = both(setting)[1]
    for get in (lambda s: s.imu.gyro.bias_deg_h, lambda s: s.imu.accel.noise_ug, lambda s: s.force.amplitude):
        direction = np.asarray(get(setting)).mean() * 1e-2
        up, down = (
            float(both(eqx.tree_at(get, setting, replace_fn=lambda x, d=d: x + d))[0]) for d in (direction, -direction)
        )
        np.testing.assert_allclose(np.sum(get(gradient)) * 2 * direction, up - down, rtol=1e-4)
    # A deviation of zero has a finite gradient too.
    assert np.all(np.isfinite(jax.tree.leaves(both(noiseless(setting))[1].imu)))


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
            "outliers = 'fix': must be one of none, fixed, segment; did you mean 'fixed'",
        ),
        (lambda: scenario("disturbed", condition=5), "condition = 5: must be one of 1, 2, 3, 4"),
        (lambda: scenario("disturbed", condition=1, amplitude_mg=1.0), "condition 1 is undisturbed"),
        (lambda: scenario("disturbed", amplitude_mg=-1.0), "amplitude_mg: must be at least 0"),
        (lambda: scenario("disturbed", noise_per="psd"), "noise_per = 'psd': must be one of"),
        (lambda: simulate("disturbed", 1, noise="density"), "noise = 'density': must be one of"),
        (lambda: scenario("dvl-sturn", single_axis="yes"), "single_axis = 'yes': must be one of"),
        (lambda: scenario("dvl-sturn", bias="normal"), "kind of bias = 'normal': must be one of"),
        (lambda: scenario("dvl-sturn", duration=10.5), r"duration: 10\.5 s are 10\.5 epochs of 1 s"),
        (lambda: scenario("dvl-sturn", duration="long"), "duration: expected a number"),
        (lambda: scenario("dvl-sturn", duration=0), "at least one"),
        (lambda: scenario("dvl-sturn", gaps=(30, 40)), "gaps: expected pairs of times"),
        (lambda: scenario("gps-zigzag", sway="yes"), "sway = 'yes': must be one of"),
        (lambda: Gap(40.0, 30.0), "ends .* before it starts"),
        (lambda: FixedOutliers(1.5), "outlier probability: must be between 0 and 1"),
        (lambda: FixedOutliers(0.1, first="sometimes"), "first = 'sometimes': must be one of"),
        (lambda: SegmentOutliers(ends=[10.0, 20.0]), "2 ends, 5 probabilities and 5 factors"),
        (lambda: SegmentOutliers([2.0, 1.0], [0.1, 0.1], [2.0, 2.0]), "must increase"),
        (lambda: GyroErrors(walk_deg_sqrt_h=-1.0), "walk_deg_sqrt_h: must be at least 0"),
        (lambda: GyroErrors(float("nan")), "bias_deg_h: must be finite"),
        (lambda: simulate("dvl-sturn", "one"), "seed = 'one': must be a whole number"),
        (lambda: simulate(Scenario(s_turn(), Site(0.5)), 1, sway=True), "options sway go with"),
        (lambda: SimulatedAid("dvl"), "no aid 'dvl': did you mean"),
        (lambda: Scenario(s_turn(), Site(0.5), epoch_samples=0), "epoch_samples = 0: must be a whole number"),
        (lambda: Scenario(s_turn(), Site(0.5), imu_rate=-5.0), "imu_rate: must be a positive number"),
        (lambda: SimulatedAid("body", -0.1), "body: sd: must be at least 0"),
        (lambda: SimulatedAid("body", unknowns={"latency": 0.1}), "no unknown 'latency' to simulate"),
        (lambda: SimulatedAid("static"), "not simulated"),
        (lambda: SimulatedAid("heading", stride=0), "stride: must be a whole number"),
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
        static_base(yaw_deg=90.0),
        Site(0.5),
        imu=ImuErrors(GyroErrors(1.0)),
        duration=2.0,
        imu_rate=50.0,
        epoch_samples=10,
    )
    log = simulate(setting, 0)
    assert log.epochs == 10
    assert log.standing


def test_single_precision_is_refused():
    code = (
        "from jaxalign.simulate import simulate\nfrom jaxalign.errors import UserError\n"
        "try:\n    simulate('dvl-sturn', 1)\nexcept UserError as e:\n    print(e)\n"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "jax_enable_x64" in done.stdout
