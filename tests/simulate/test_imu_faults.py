"""Faults of the inertial unit against closed forms; in scenarios, files and studies."""

import dataclasses
import re
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from statistical import assert_rate, assert_variance

from jaxalign.errors import UserError
from jaxalign.simulate import (
    Drift,
    Gap,
    GSensitivity,
    IncrementQuantisation,
    Misalignment,
    PointSamples,
    RateQuantisation,
    Saturation,
    ScaleFactor,
    Spikes,
    Stuck,
    Vibration,
    WarmUp,
    Zeros,
    intervals_of,
    measure_epochs,
    sample_epochs,
    scenario,
    scenario_file,
    simulate,
    truth,
)
from jaxalign.simulate.file import _IMU_FAULTS
from jaxalign.study import Study, run
from jaxalign.study.epochs_spec import EpochsSpec, run_keys, run_model

DEG, G = np.pi / 180, 9.80665
DEG_H, MG = DEG / 3600, 1e-3 * G
N, DT = 60, 0.05
T = DT * np.arange(1, N + 1)
SMALL = np.random.default_rng(1).normal(size=(2, N, 3)) * [[[0.01]], [[0.5]]]
PAGE = (Path(__file__).parents[2] / "docs" / "faults.md").read_text()

_apply = eqx.filter_jit(lambda fault, key, dtheta, dvel: fault(key, jnp.asarray(T), DT, dtheta, dvel))


def spoiled(fault, of=SMALL, key=0):
    """What a fault makes of increments."""
    return tuple(np.asarray(x) for x in _apply(fault, jax.random.key(key), *(jnp.asarray(x) for x in of)))


def added(fault, of=SMALL, key=0):
    return tuple(new - old for new, old in zip(spoiled(fault, of, key), of, strict=True))


def test_warm_up_fades():
    """The sum of a bias that fades is A tau (1 - exp(-t / tau)), sample for sample."""
    gyro, accel = added(WarmUp(0.7, [3.0, 0.0, -2.0], 400.0))
    seconds = 0.7 * (1 - np.exp(-T / 0.7))[:, None]
    np.testing.assert_allclose(np.cumsum(gyro, 0), np.array([3.0, 0.0, -2.0]) * DEG_H * seconds, atol=1e-15)
    np.testing.assert_allclose(np.cumsum(accel, 0), np.full(3, 0.4 * MG) * seconds, atol=1e-13)
    assert np.isfinite(spoiled(WarmUp(1e-3, 1.0))).all()


def test_drift_is_linear():
    """The sum of a bias that grows is its slope times t^2 / 2."""
    gyro, accel = added(Drift([0.0, 40.0, 0.0], 9e4))
    np.testing.assert_allclose(np.cumsum(gyro, 0)[:, 1], 40.0 * DEG_H / 3600 * T**2 / 2, atol=1e-14)
    np.testing.assert_allclose(np.cumsum(accel, 0)[:, 2], 90 * MG / 3600 * T**2 / 2, atol=1e-14)
    np.testing.assert_array_equal(gyro[:, [0, 2]], 0.0)


def test_scale_factor_and_misalignment():
    gyro, accel = spoiled(ScaleFactor([1.0, 0.0, -2.0], 0.5))
    np.testing.assert_allclose(gyro, SMALL[0] * [1.01, 1.0, 0.98], rtol=1e-14)
    np.testing.assert_allclose(accel, SMALL[1] * 1.005, rtol=1e-14)
    m = np.array([[9.0, 1.0, 2.0], [-1.0, 9.0, 3.0], [-2.0, -3.0, 9.0]])  # the diagonal is not used
    gyro, accel = added(Misalignment(m))
    off = (m - np.diag(np.diag(m))) / 100
    np.testing.assert_allclose(gyro, SMALL[0] @ off.T, atol=1e-16)
    np.testing.assert_array_equal(accel, 0.0)
    turn = np.array([3.0, -2.0, 1.0]) / 100  # skew-symmetric: -turn x what there is, a turn of the whole triad
    np.testing.assert_allclose(gyro, -np.cross(turn, SMALL[0]), atol=1e-16)


def test_g_sensitivity():
    """Standing level, only the third column counts: a constant rate."""
    level = (np.zeros((N, 3)), np.tile([0.0, 0.0, G * DT], (N, 1)))
    gyro, accel = spoiled(GSensitivity([[0, 0, 5.0], [0, 0, -7.0], [8.0, 9.0, 0]]), level)
    np.testing.assert_allclose(gyro, np.tile(np.array([5.0, -7.0, 0.0]) * DEG_H * DT, (N, 1)), atol=1e-18)
    np.testing.assert_array_equal(accel, level[1])
    rows = added(GSensitivity([1.0, 2.0, 3.0]), level)[0]
    np.testing.assert_allclose(rows[0], np.array([1.0, 2.0, 3.0]) * DEG_H * DT, rtol=1e-12)


def test_pulses_lose_nothing():
    """Increments are whole pulses, and sums right to half of one; what has none is left as it is."""
    gyro, accel = spoiled(IncrementQuantisation([300.0, 0.0, 300.0], 40.0))
    for x, old, size in ((gyro[:, ::2], SMALL[0][:, ::2], 300 * DEG / 3600), (accel, SMALL[1], 0.04)):
        np.testing.assert_allclose(x / size, np.round(x / size), atol=1e-9)
        assert np.abs(np.cumsum(x - old, 0)).max() <= 0.5 * size * (1 + 1e-9)
        assert np.abs(x - old).max() > 0.5 * size  # single increments are off by up to one
    np.testing.assert_array_equal(gyro[:, 1], SMALL[0][:, 1])


def test_rounded_rates_lose_it():
    """A slow turn below half a digit is not seen at all."""
    slow = (np.tile([0.4, 0.6, 1.4], (N, 1)) * DEG * DT, SMALL[1])
    gyro, accel = spoiled(RateQuantisation(1.0, 20.0), slow)
    np.testing.assert_allclose(gyro / (DEG * DT), np.tile([0.0, 1.0, 1.0], (N, 1)), atol=1e-12)
    np.testing.assert_allclose(accel, np.round(SMALL[1] / (20 * MG * DT)) * 20 * MG * DT, atol=1e-15)


def test_saturation_clips():
    gyro, accel = spoiled(Saturation(gyro_deg_s=[5.0, 6.0, 7.0]))
    most = np.array([5.0, 6.0, 7.0]) * DEG * DT
    np.testing.assert_allclose(gyro, np.clip(SMALL[0], -most, most), atol=1e-18)
    assert np.any(gyro != SMALL[0])
    np.testing.assert_array_equal(accel, SMALL[1])
    np.testing.assert_allclose(np.abs(spoiled(Saturation(accel_g=1.0))[1]).max(), G * DT)


def test_vibration_is_an_integral():
    """Without a phase the sum is A (1 - cos(w t)) / w, also beyond the rate of the samples; runs differ in phase."""
    for hertz in (3.0, 33.0):
        gyro, accel = added(Vibration(hertz, [2.0, 0.0, 0.0], [0.0, 0.0, 50.0], random_phase=False))
        turned = (1 - np.cos(2 * np.pi * hertz * T)) / (2 * np.pi * hertz)
        np.testing.assert_allclose(np.cumsum(gyro, 0)[:, 0], 2.0 * DEG * turned, atol=1e-14)
        np.testing.assert_allclose(np.cumsum(accel, 0)[:, 2], 50.0 * MG * turned, atol=1e-13)
    one, other = (added(Vibration(3.0, 1.0, 1.0), key=key)[0] for key in (1, 2))
    assert np.abs(one - other).max() > 0.1 * DEG * DT


def test_outages():
    """Hit are samples that end in (start, stop], of the chosen axes."""
    inside = (T > 1.0 + 1e-9) & (T < 1.5 + 1e-9)
    assert inside.sum() == 10
    gyro, accel = spoiled(Zeros(1.0, 1.5, "gyro", "zx"))
    np.testing.assert_array_equal(gyro, np.where(inside[:, None] & np.array([True, False, True]), 0.0, SMALL[0]))
    np.testing.assert_array_equal(accel, SMALL[1])
    gyro, accel = spoiled(Stuck(1.0, 1.5))
    for x, old in ((gyro, SMALL[0]), (accel, SMALL[1])):
        np.testing.assert_array_equal(x[inside], np.tile(old[np.argmax(inside) - 1], (10, 1)))
        np.testing.assert_array_equal(x[~inside], old[~inside])
    gyro, accel = spoiled(Stuck(0.0, 0.5, "accel"))
    np.testing.assert_array_equal(accel[:10], np.tile(SMALL[1][0], (10, 1)))
    np.testing.assert_array_equal(gyro, SMALL[0])


def test_spikes():
    gyro, accel = added(Spikes([0.0, 0.0, 20.0], 0.5, times=[0.0, 0.12, 2.0, 99.0]))
    rows = np.flatnonzero(accel.any(1))
    np.testing.assert_array_equal(rows, [0, 2, 39])  # at 2.0 s the sample that ends there; none beyond the record
    np.testing.assert_allclose(np.abs(accel[rows]), 0.5 * G * DT, rtol=1e-9)
    np.testing.assert_allclose(np.abs(gyro[rows]), [[0.0, 0.0, 20.0 * DEG * DT]] * 3, atol=1e-12)
    hits = sum(np.count_nonzero(added(Spikes(1.0, probability=0.1), key=key)[0][:, 0]) for key in range(20))
    assert_rate(hits, 20 * N, 0.1)


def test_point_samples_hold():
    gyro, accel = spoiled(PointSamples(7))
    for x, old in ((gyro, SMALL[0]), (accel, SMALL[1])):
        for i in range(N):
            np.testing.assert_array_equal(x[i], old[min(7 * (i // 7) + 6, N - 1)])


def test_runs_draw_and_are_those_of_vmap():
    """Pure: runs side by side are the single ones; drawn figures are deviations, each axis its own."""
    faults = (WarmUp(9.0, 5.0, drawn=True), Misalignment(1.0, 1.0, drawn=True), Spikes(9.0, probability=0.2))
    keys = jax.random.split(jax.random.key(3), 600)
    ones = jnp.ones((N, 3))

    @eqx.filter_jit
    @eqx.filter_vmap(in_axes=(None, 0))
    def both(faults, key):
        return [fault(key, jnp.asarray(T), DT, ones, ones) for fault in faults]

    together = both(faults, keys)
    for fault, (gyro, _) in zip(faults, together, strict=True):
        alone = _apply(fault, keys[7], ones, ones)[0]
        np.testing.assert_allclose(gyro[7], alone, rtol=1e-14)
    drawn = (np.asarray(together[0][0])[:, 0] - 1) / (9.0 * -np.expm1(-DT / 9.0) * DEG_H)
    assert_variance(drawn, 5.0)
    assert abs(np.corrcoef(drawn[:, 0], drawn[:, 1])[0, 1]) < 4.5 / np.sqrt(600)
    assert_variance(np.asarray(together[1][1])[:, 0] - 1, 0.01 * np.sqrt(2))  # the parts of two other axes


def test_in_a_scenario():
    """The draws of all else stay as they were; faults act in their order, and stay without noise."""
    made = scenario("dvl-sturn", duration=4.0)
    exact = truth(made)
    spoilt = dataclasses.replace(made, imu_faults=(ScaleFactor(1.0, 0.0), Saturation(accel_g=1.0)))
    plain, log = (simulate(x, 5, truth_of=exact) for x in (made, spoilt))
    np.testing.assert_allclose(log.dtheta, 1.01 * plain.dtheta, rtol=1e-14)
    np.testing.assert_allclose(log.dvel, np.minimum(plain.dvel, G / made.imu_rate), rtol=1e-14)
    np.testing.assert_array_equal(log.aids[0].value, plain.aids[0].value)
    bare = simulate(spoilt, 5, noise=False, truth_of=exact)
    np.testing.assert_allclose(bare.dtheta, 1.01 * np.asarray(exact.dtheta), rtol=1e-14)
    with pytest.raises(UserError, match=r"imu_faults: must be a tuple of faults of the inertial unit, .* SimulatedAid"):
        dataclasses.replace(made, imu_faults=(Gap(1.0, 2.0),))


def test_studies_need_samples():
    made = dataclasses.replace(scenario("dvl-sturn", duration=4.0), imu_faults=(Drift(1.0),))
    exact, key = truth(made), jax.random.key(0)
    with pytest.raises(UserError, match=r"faults of the inertial unit \(imu_faults\) act on .*\(--fidelity samples\)"):
        run(Study(made, ["oba"], runs=2))
    with pytest.raises(UserError, match="fidelity 'samples', or use measure"):
        measure_epochs(intervals_of(exact, made.epoch_samples), made, key)
    with pytest.raises(UserError, match="faults of the inertial unit are measured sample by sample"):
        sample_epochs(exact, made, key, 200)


def test_epochs_of_a_study_have_them():
    """Of many runs at once, which would else skip the samples: of a unit that reads zero nothing is left."""
    made = dataclasses.replace(scenario("dvl-sturn", duration=4.0), imu_faults=(Zeros(0.0, 3.0),))
    key = jax.random.key(0)
    model = run_model(made, EpochsSpec((made.aids[0].aid,), made.epoch_samples), key, "samples")
    rows = eqx.filter_jit(lambda model, keys: model.epochs(keys))(model, run_keys(key, jnp.arange(6))).rows
    for x, still in ((rows.rotation.w, 1.0), (rows.rotation.z, 0.0), (rows.dvel.z, 0.0)):
        np.testing.assert_array_equal(x[:4], still)
        assert np.all(x[4] != still)


FILE = """
base = "dvl-sturn"
duration = 4.0
[[imu_faults]]
kind = "warm-up"
time_constant = 60.0
gyro_deg_h = [1.0, 2.0, 3.0]
drawn = true
[[imu_faults]]
kind = "misalignment"
accel_percent = [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]
[[imu_faults]]
kind = "stuck"
start = 1.0
stop = 2.0
triad = "accel"
axes = "z"
[[imu_faults]]
kind = "point-samples"
every = 5
[[imu_faults]]
kind = "spikes"
accel_g = 3
times = [1.0, 2.0]
"""


def test_from_a_file(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(FILE)
    own = (
        WarmUp(60.0, [1.0, 2.0, 3.0], drawn=True),
        Misalignment(accel_percent=[[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]),
        Stuck(1.0, 2.0, "accel", "z"),
        PointSamples(5),
        Spikes(accel_g=3.0, times=[1.0, 2.0]),
    )
    made = scenario_file(path)
    assert eqx.tree_equal(made.imu_faults, own)
    assert made.imu_faults[2].axes == "z"
    assert len(made.aids) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('"warm-up"', '"warmup"'), r"\[imu_faults 1\] kind: unknown 'warmup'; did you mean 'warm-up'"),
        (("time_constant = 60.0", ""), r"\[imu_faults 1\] time_constant: missing"),
        (("time_constant = 60.0", "time_constant = 0"), r"WarmUp: time_constant: must be at least"),
        (("gyro_deg_h =", "gyro_deg_s ="), r"\[imu_faults 1\] unknown key 'gyro_deg_s'; did you mean 'gyro_deg_h'"),
        (
            ("[1.0, 2.0, 3.0]", "[1.0, 2.0]"),
            r"WarmUp: gyro_deg_h has the shape \(2,\): one number is expected, or three",
        ),
        (("drawn = true", 'drawn = "yes"'), "WarmUp: drawn = 'yes': must be one of False, True"),
        (("gyro_deg_h = [1.0, 2.0, 3.0]", ""), "WarmUp: give gyro_deg_h or accel_ug: without it there is no fault"),
        (('triad = "accel"', 'triad = "acc"'), r"\[imu_faults 3\] Stuck: triad = 'acc'.*did you mean 'accel'"),
        (('axes = "z"', 'axes = "up"'), "Stuck: axes = 'up': some of x, y, z are expected"),
        (("stop = 2.0", "stop = 0.5"), r"Stuck: it ends \(0.5 s\) before it starts \(1.0 s\)"),
        (("every = 5", "every = 5.5"), "PointSamples: every = 5.5: must be a whole number"),
        (("times = [1.0, 2.0]", ""), "Spikes: give either probability"),
        (("[[imu_faults]]", "[imu_faults]"), r"imu_faults: write each as a table \[\[imu_faults\]\]|not a TOML file"),
    ],
)
def test_a_slip(tmp_path, change, message):
    text = FILE.replace(*change)
    assert text != FILE
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=message) as found:
        scenario_file(path)
    assert "own.toml" in str(found.value)
    assert "\n" not in str(found.value)


def test_the_page_has_all():
    """Kinds and their keys, as files have them."""
    rows = dict(re.findall(r"^\| `([\w-]+)` \| (.*?) \|", PAGE, flags=re.M))
    for kind, made in _IMU_FAULTS.items():
        assert set(re.findall(r"`(\w+)`", rows[kind])) == {x.name for x in dataclasses.fields(made)}, kind
