"""Aids on their own clocks: rows at the union of their times, samples split at a fix, and what comes of it."""

import dataclasses

import jax
import numpy as np
import pytest
from logs import fields, log_of

import jaxalign as ja
from jaxalign import BodyVelocity, Heading, Measurements, NonHolonomic
from jaxalign.metrics import attitude_error_deg
from jaxalign.preintegration_host import preintegrated, preintegrated_between
from jaxalign.simulate import scenario, simulate, truth
from jaxalign.vector import Quat, Vec3, mean_rotated

RATE, FORCE, DT = np.array([0.3, -0.2, 0.5]), np.array([1.0, -2.0, 9.6]), 0.01


def test_constant_rates_split_exactly():
    """Boundaries anywhere: several in one sample, on a boundary between samples, intervals of one sample."""
    at = np.array([0.0, 0.3, 0.7, 1.0, 2.0, 2.5, 7.25, 9.0, 31.4, 100.0])
    gyro, accel = np.tile(RATE * DT, (100, 1)), np.tile(FORCE * DT, (100, 1))
    found = preintegrated_between(gyro, accel, at)
    for k, steps in enumerate(np.diff(at)):
        turn = Vec3(*RATE * steps * DT)
        np.testing.assert_allclose(found.rotation.array[k], Quat.exp(turn).array, atol=1e-14)
        np.testing.assert_allclose(found.dvel.array[k], mean_rotated(turn, Vec3(*FORCE * steps * DT)).array, atol=1e-13)


def test_whole_samples_are_those_of_equal_intervals():
    rng = np.random.default_rng(0)
    gyro, accel = 0.01 * rng.normal(size=(60, 3)), rng.normal(size=(60, 3))
    for every in (1, 4, 5):
        one, other = preintegrated(gyro, accel, every), preintegrated_between(gyro, accel, np.arange(0.0, 61, every))
        for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-15)


def test_rows_are_at_the_union_of_the_times():
    time = np.arange(0.0, 20.5, 0.5)
    odometer = Measurements(BodyVelocity(components=("forward",)), time, time, 0.05)
    compass = Measurements(Heading(), np.array([0.503, 7.0, 12.34567]), np.array([1.0, 2.0, 3.0]), 0.01)
    log = log_of(**fields(aids=(odometer, compass)))
    epochs = ja.epochs_from_log(log)
    rows = np.cumsum(np.asarray(epochs.rows.dt))
    np.testing.assert_allclose(rows, np.union1d(time, compass.time), atol=1e-9)
    forward, heading = epochs.rows.fixes
    np.testing.assert_allclose(rows[np.asarray(forward.valid)], time, atol=1e-9)
    np.testing.assert_array_equal(np.asarray(heading.value[0])[np.asarray(heading.valid)], [1.0, 2.0, 3.0])
    assert epochs.interval is None
    finer = ja.epochs_from_log(log, interval_samples=10)
    assert np.asarray(finer.rows.dt).max() < 0.1 + 1e-9
    with pytest.raises(ja.UserError, match="do not measure at equal intervals"):
        ja.epochs_from_log(log, scheme="lookback")
    even = ja.epochs_from_log(log, aids=odometer.aid)
    assert (even.interval, len(even)) == (0.5, 41)


@pytest.fixture(scope="module")
def jittered():
    """A log without noise whose fixes come up to 0.3 s early or late, and its truth."""
    made = scenario("dvl-accturn")
    exact = truth(made)
    log = simulate(made, 0, noise=False, truth_of=exact)
    rng = np.random.default_rng(1)
    time = np.arange(1.0, 299.0) + np.concatenate([[-1.0], rng.uniform(-0.3, 0.3, 297)])
    velocity = np.asarray(made.trajectory.velocity_b(time).array)
    return dataclasses.replace(log, aids=(Measurements("body", time, velocity, 0.05),)), velocity


def test_a_fix_counts_at_its_own_time(jittered):
    """With the times to the nearest second, as if they were regular, the velocity is off by up to 0.3 m/s."""
    log, velocity = jittered
    method = ja.build("centred_oba", "body")
    rows = np.array([150, 297])
    found = method.solve(method.epochs(log), rows)
    near = np.searchsorted(log.times, np.asarray(found.time))
    reference = log.C_nb[np.clip(near, 0, log.epochs)]
    turn = np.einsum("kij,klj->kil", found.C_nb, reference)
    heading = np.rad2deg(turn[:, 1, 0])
    nominal = Measurements("body", np.round(log.aids[0].time), velocity, 0.05)
    careless = dataclasses.replace(log, aids=(nominal,))
    wrong = attitude_error_deg(method.solve(method.epochs(careless), rows), careless)
    print(heading, wrong[:, 2])
    assert np.abs(heading[-1]) < 0.2
    assert np.abs(wrong[-1, 2]) > 5 * np.abs(heading[-1])
    with pytest.raises(ja.UserError, match="a window is a number of epochs"):
        ja.align(ja.build("oba", "body", {"observe.window": 60.0}), log)


def test_a_log_from_streams():
    """Each array on its own clock; the log begins with the first fix and ends with the last one."""
    t = 1e6 + np.arange(0.0, 30.0, DT) + 0.004
    n = len(t)
    gyro, accel = np.tile([0.0, 0.0, 0.01], (n, 1)), np.tile([0.1, 0.0, 9.8], (n, 1))
    time = 1e6 + np.arange(2.0, 28.0, 0.1)
    forward = Measurements(BodyVelocity(components=("forward",)), time, 0.0 * time, 0.05)
    level = Measurements(NonHolonomic(), time[::10], np.zeros((len(time[::10]), 2)), [0.05, 0.1])
    log = ja.log_from_streams(t, gyro, accel, [forward, level], lat=0.5, h=20.0, name="car")
    assert (log.epoch_samples, log.epochs, log.name) == (10, 259, "car")
    assert log.t0 == pytest.approx(1e6 + 2.0)
    np.testing.assert_allclose(log.aids[0].time, np.arange(260) * 0.1, atol=1e-8)
    np.testing.assert_allclose(log.aids[1].time, np.arange(0.0, 25.95, 1.0), atol=1e-8)
    np.testing.assert_allclose(log.dvel.sum(axis=0), np.array([0.1, 0.0, 9.8]) * 25.9, rtol=1e-9)
    turned = ja.log_from_streams(t, gyro * DT, accel * DT, [forward], lat=0.5, increments=True)
    np.testing.assert_allclose(turned.dvel.sum(axis=0), log.dvel.sum(axis=0), rtol=1e-9)
    assert ja.log_from_streams(t, gyro, accel, lat=0.5).standing


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, w, f: (t, w[:, :2], f), r"\(N,\), \(N, 3\), \(N, 3\) are expected"),
        (lambda t, w, f: (np.where(t > 5, np.nan, t), w, f), "time is NaN or infinite"),
        (lambda t, w, f: (np.where(t > 5, t - 1, t), w, f), "time does not increase at 1 rows, first after row 500"),
        (lambda t, w, f: (t[:3], w[:3], f[:3]), "too short: 3 rows"),
        (lambda t, w, f: (t * 1e3, w, f), "sampling interval is 10 s.*: is time in seconds"),
        (
            lambda t, w, f: (np.where(t > 5, t + 1, t), w, f),
            r"gap in the IMU of 1.01 s \(100 samples, at most 3\) after row",
        ),
    ],
)
def test_streams_that_are_no_log(change, message):
    t = np.arange(0.0, 10.0, DT)
    with pytest.raises(ja.UserError, match=message):
        ja.log_from_streams(*change(t, np.zeros((1000, 3)), np.tile([0.0, 0.0, 9.8], (1000, 1))), lat=0.5)


def test_an_aid_beside_the_record():
    t = np.arange(0.0, 10.0, DT)
    late = Measurements("nav", t + 50.0, np.zeros((1000, 3)))
    with pytest.raises(ja.UserError, match=r"no nav sample within the IMU record: IMU 0 to 9.99 s, nav 50 to 59.99 s"):
        ja.log_from_streams(t, np.zeros((1000, 3)), np.tile([0.0, 0.0, 9.8], (1000, 1)), late, lat=0.5)


def test_no_data_count_twice():
    log = log_of(**fields(aids=(Measurements(BodyVelocity(name="dvl"), np.arange(21.0), np.zeros((21, 3)), 0.05),)))
    with pytest.raises(ja.UserError, match="the method observes dvl and second: the same values would count twice"):
        ja.epochs_from_log(log, aids=(BodyVelocity(name="dvl"), BodyVelocity(name="second")))


def test_epochs_of_another_aid():
    epochs = ja.epochs_from_log(log_of(**fields()), aids=BodyVelocity())
    with pytest.raises(ja.UserError, match=r"the method observes body .*\(forward\)\): build it"):
        ja.align(ja.build("robust_map", aid=BodyVelocity(components=("forward",))), epochs)


def test_the_order_of_aids_does_not_matter():
    """Epochs are those of the aid that measures most often; what comes after its last value counts."""
    time = 0.01 * np.arange(6001)
    turning, still = np.tile([0.0, 5e-5, 5e-5], (6001, 1)), np.tile([0.0, 0.0, 9.8], (6001, 1))
    wheels = Measurements(BodyVelocity(components=("forward",)), np.arange(0.0, 59.05, 0.1), np.zeros(591), 0.05)
    compass = Measurements(Heading(), np.array([0.0, 17.0, 34.0, 59.537]), np.zeros(4), 0.01)
    once = Measurements(Heading(name="gyrocompass"), np.array([58.93]), np.zeros(1), 0.01)
    for aids in ((wheels, compass, once), (compass, once, wheels)):
        log = ja.log_from_streams(time, turning, still, aids, lat=0.7)
        assert log.interval == pytest.approx(0.1)
        assert len(log.dtheta) * log.dt == pytest.approx(59.54)
        assert [(~log.measured(one.aid).missing).sum() for one in (wheels, compass, once)] == [591, 4, 1]
        rows = np.cumsum(np.asarray(ja.epochs_from_log(log).rows.dt))
        assert rows[-1] == pytest.approx(59.537)
    for wrong in (np.nan, "1"):
        with pytest.raises(ja.UserError, match=r"interval is .*: it must be one finite number"):
            ja.log_from_streams(time, turning, still, wheels, lat=0.7, interval=wrong)


def test_the_noise_of_a_velocity_with_a_dead_axis():
    rng = np.random.default_rng(3)
    value = 0.02 * rng.normal(size=(201, 3))
    value[:, 0] = np.nan
    turns, pushes = (np.tile(fields()[key], (10, 1)) for key in ("dtheta", "dvel"))
    aids = (Measurements("body", np.arange(201.0), value),)
    log = log_of(**fields(dtheta=turns, dvel=pushes, C_nb=None, aids=aids))
    assert ja.estimate_aid_sd(ja.epochs_from_log(log)) == pytest.approx(0.02, rel=0.2)
