"""Faults of samples and of the values of aids: found where they are, and nothing in sound logs of any quantum."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxalign.errors import UserError
from jaxalign.io import read_csv
from jaxalign.log import Log
from jaxalign.measurements import Measurements
from jaxalign.trust import log_findings
from jaxalign.trust.chance import most_events, run_gap, tail_gap

DT, SECONDS, LAT = 0.01, 60, 0.7
N = round(SECONDS / DT)


def record(seed=0, gyro=1e-5, force=1e-3, moving=1.0):
    """(N, 3) increments of a vehicle that turns and tilts slowly, with white noise (rad, m/s)."""
    draw = np.random.default_rng(seed)
    t = (np.arange(N) + 0.5) * DT
    w = moving * np.column_stack([0.02 * np.sin(0.7 * t), 0.03 * np.cos(0.9 * t), 0.2 * np.sin(0.25 * t)])
    f = np.column_stack([moving * 0.5 * np.sin(0.25 * t), moving * 0.3 * np.cos(0.4 * t), 9.8 + 0 * t])
    return w * DT + draw.normal(0, gyro, (N, 3)), f * DT + draw.normal(0, force, (N, 3))


def log_of(dtheta, dvel, *aids):
    return Log(dtheta, dvel, DT, 100, LAT, aids=aids)


def velocity(noise=0.05, seed=1):
    """A velocity in b at 1 Hz."""
    t = np.arange(SECONDS + 1.0)
    v = np.column_stack([0.1 * np.sin(0.3 * t), 5 + 0.5 * np.sin(0.1 * t), 0.1 * np.cos(0.2 * t)])
    return Measurements("body", t, v + np.random.default_rng(seed).normal(0, noise, v.shape))


def names(log, trusted=None):
    return {one.name for one in log_findings(log) if trusted is None or one.trusted == trusted}


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    gyro=st.sampled_from([1e-8, 1e-6, 1e-4]),
    steps=st.tuples(st.sampled_from([0.0, 1e-6, 2e-5, 1e-3]), st.sampled_from([0.0, 1e-4, 1e-3, 0.1])),
    moving=st.sampled_from([0.0, 1.0]),
)
def test_a_sound_log_of_any_quantum_has_no_finding(seed, gyro, steps, moving):
    """Rounding to less than the noise, or to so much that a unit at rest says the same for minutes."""
    both = record(seed, gyro, 10 * gyro, moving)
    dtheta, dvel = (np.round(x / q) * q if q else x for x, q in zip(both, steps, strict=True))
    if not dvel.any():
        return
    assert not log_findings(log_of(dtheta, dvel))


def test_a_unit_that_rests_below_its_quantum_and_then_moves_is_sound():
    dtheta, dvel = record()
    still, _ = record(moving=0.0, gyro=1e-6)
    dtheta[: N // 3] = still[: N // 3]
    assert not log_findings(log_of(np.round(dtheta / 1e-4) * 1e-4, dvel))


def test_noise_free_simulations_are_sound():
    dtheta, dvel = record(gyro=0.0, force=0.0)
    dtheta[: N // 2], dvel[: N // 2] = [0, 0, 1e-6], [0, 0, 9.8 * DT]
    steady = Measurements("body", np.arange(SECONDS + 1.0), np.tile([0.0, 5.0, 0.0], (SECONDS + 1, 1)))
    assert not log_findings(log_of(dtheta, dvel, steady))


@pytest.mark.parametrize("step", [0.0, 1e-6])
@pytest.mark.parametrize(
    ("columns", "value", "seconds", "name", "says"),
    [
        (range(6), 0.0, 0.5, "zeros", "all six channels are exactly zero in 50 samples, first at 20 s"),
        (range(3), 0.0, 0.5, "zeros", "gyro x, y, z is exactly zero for 0.5 s from 20 s"),
        ([2], None, 1.0, "stuck samples", "gyro z stays at one value for 1 s from 20 s"),
        (range(6), None, 1.0, "stuck samples", "gyro x, y, z stays"),
        ([3], None, 1.0, "stuck samples", "accelerometer x stays"),
        ([0], 0.0, SECONDS, "dead channel", "gyro x never changes"),
    ],
)
def test_samples_that_stay(columns, value, seconds, name, says, step):
    data = np.hstack(record())
    data = np.round(data / step) * step if step else data
    first = 2000 if seconds < SECONDS else 0
    where = slice(first, first + round(seconds / DT))
    for i in columns:
        data[where, i] = data[where, i][0] if value is None else value
    found = [one for one in log_findings(log_of(data[:, :3], data[:, 3:])) if one.name == name]
    assert found
    assert not found[0].trusted
    assert says in found[0].text


def test_saturation_names_the_range():
    dtheta, dvel = record()
    dtheta[:, 2] = np.clip(dtheta[:, 2], -1.2e-3, 1.2e-3)
    found = [one for one in log_findings(log_of(dtheta, dvel)) if one.name == "saturation"]
    assert "choose a larger range" in found[0].text
    assert not found[0].trusted


def test_zeros_in_a_file_survive_its_reader(tmp_path):
    """Increments are differences of sums there, so zeros are not exact."""
    dtheta, dvel = record()
    data = np.column_stack([np.arange(N) * DT, dtheta / DT, dvel / DT, np.full(N, 40.0)])
    data[2000:2050, 1:7] = 0.0
    head = "time,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,lat_deg"
    np.savetxt(tmp_path / "log.csv", data, delimiter=",", header=head, comments="")
    assert "zeros" in names(read_csv(tmp_path / "log.csv"), trusted=False)


def test_what_little_is_lost_is_a_note():
    """0.2 s of a channel at rest is as good as its noise."""
    dtheta, dvel = record(moving=0.0)
    dtheta[2000:2020, 2] = dtheta[2000, 2]
    (found,) = log_findings(log_of(dtheta, dvel))
    assert found.name == "stuck samples"
    assert found.trusted


@pytest.mark.parametrize(("column", "size", "trusted"), [(4, 100.0, False), (4, 0.5, True), (2, 0.02, False)])
def test_one_wild_sample(column, size, trusted):
    data = np.hstack(record())
    data[3000, column] += size
    (found,) = log_findings(log_of(data[:, :3], data[:, 3:]))
    assert found.name == "spike"
    assert found.trusted == trusted
    assert found.value > found.limit
    assert "in the one sample at 30 s" in found.text


def test_an_absurd_sample_is_refused_before():
    data = np.hstack(record())
    data[3000, 4] = 1e200
    with pytest.raises(UserError, match="no vehicle does"):
        log_of(data[:, :3], data[:, 3:])


def test_blows_and_steps_are_no_spikes():
    """A turn that begins at once, and blows whose sizes have the tail of a Cauchy distribution."""
    dtheta, dvel = record()
    dtheta[3000:, 2] += 0.5 * DT
    dvel[::40, 0] += 0.01 * np.random.default_rng(0).standard_cauchy(len(dvel[::40])).clip(-50, 50)
    assert not names(log_of(dtheta, dvel)) & {"spike"}


@pytest.mark.parametrize("every", [2, 5])
def test_rows_repeated(every):
    rows = np.arange(N) // every * every
    dtheta, dvel = record()
    assert names(log_of(dtheta[rows], dvel[rows])) == {"repeated samples"}
    assert names(log_of(dtheta, dvel[rows])) == {"repeated samples"}


def test_values_of_an_aid_that_are_repeated_held_or_zero():
    dtheta, dvel = record()
    one = velocity()

    def found(rows, value, trusted=True):
        changed = one.value.copy()
        changed[rows] = value
        return names(log_of(dtheta, dvel, dataclasses.replace(one, value=changed)), trusted)

    assert not log_findings(log_of(dtheta, dvel, one))
    assert found(slice(20, 35), one.value[20]) == {"aid stuck"}
    assert found(slice(20, 55), one.value[20], trusted=False) == {"aid stuck"}
    assert found(slice(20, 25), 0.0) == {"aid zeros"}
    assert found(slice(0, 61), one.value[np.arange(61) // 3 * 3]) == {"aid repeated"}


def test_wheels_that_stand_say_zero():
    """A vehicle that stops smoothly, with noise only while it moves."""
    dtheta, dvel = record()
    t = np.arange(0, SECONDS, 0.1)
    draw = np.random.default_rng(0)
    v = np.column_stack([0 * t, np.maximum(np.sin(0.2 * t), 0) * (1 + draw.normal(0, 0.05, len(t))), 0 * t])
    assert not names(log_of(dtheta, dvel, Measurements("body", t, v)), trusted=False)


def test_limits_of_chance():
    """Against draws: the Poisson limit is seldom passed; a Gaussian tail has no gap."""
    draw = np.random.default_rng(0)
    assert draw.poisson(20.0, 10**5).max() <= most_events(20.0)
    assert all(tail_gap(np.abs(draw.normal(size=5000)), 0.0)[0] == 0 for _ in range(200))
    assert all(tail_gap(np.abs(draw.standard_t(3, size=5000)), 0.0)[0] == 0 for _ in range(200))
    wild = np.abs(draw.normal(size=5000))
    wild[:2] = 1e3
    assert tail_gap(wild, 0.0)[0] == 2
    lengths = draw.geometric(0.6, 3000)
    assert run_gap(lengths) > lengths.max()
    assert run_gap(np.append(lengths, 100)) == 100
