"""The Earth at rest, and the course under way, against the gyroscopes."""

import dataclasses

import numpy as np
import pytest

from jaxalign.log import Log
from jaxalign.measurements import Measurements
from jaxalign.plausibility import rotations
from jaxalign.trust import log_findings, stretches
from jaxalign.wgs84 import EARTH_RATE

DT, LAT = 0.05, 0.56
EARTH = EARTH_RATE * np.array([0.0, np.cos(LAT), np.sin(LAT)])


def standing(seconds=120, bias=(0, 0, 0), noise=1e-7, lat=LAT, aid=None, moving=()):
    """Level, forward to 40 deg; `moving`: seconds in which it shakes."""
    n, draw = round(seconds / DT), np.random.default_rng(0)
    turn = rotations(np.array([[0.0, 0.0, 0.7]]))[0]
    w = turn @ (EARTH_RATE * np.array([0.0, np.cos(lat), np.sin(lat)])) + np.asarray(bias) / 206264.8
    dtheta = w * DT + draw.normal(0, noise, (n, 3))
    dvel = np.array([0, 0, 9.8]) * DT + draw.normal(0, 1e-4, (n, 3))
    for start, stop in moving:
        rows = slice(round(start / DT), round(stop / DT))
        dvel[rows] += draw.normal(0, 3e-3, dvel[rows].shape)
        dtheta[rows] += draw.normal(0, 1e-4, dvel[rows].shape)
    return Log(dtheta, dvel, DT, 20, lat, aids=() if aid is None else (aid,))


def swaying(sign=1.0, seconds=600, lat=LAT):
    """Tilts and turns by 10 deg with periods of 5 to 8 s, at a place of an east-north-up frame that turns."""
    t = np.arange(round(seconds / DT) + 1) * DT
    angles = np.deg2rad([10, 12, 6])[:, None] * np.sin(2 * np.pi * t / np.array([[5.0], [8.0], [6.7]]))
    east, north, up = np.eye(3)
    c = np.eye(3)[None]
    for axis, angle in ((up, angles[2]), (east, angles[0]), (north, angles[1])):
        c = c @ rotations(angle[:, None] * axis)
    earth = rotations(t[:, None] * EARTH_RATE * np.array([0.0, np.cos(lat), np.sin(lat)]))
    inertial = earth @ c
    step = np.swapaxes(inertial[:-1], 1, 2) @ inertial[1:]
    vector = 0.5 * np.stack(
        [step[:, 2, 1] - step[:, 1, 2], step[:, 0, 2] - step[:, 2, 0], step[:, 1, 0] - step[:, 0, 1]], 1
    )
    sine = np.linalg.norm(vector, axis=1, keepdims=True)
    dtheta = vector * np.arcsin(sine) / sine
    middle = c[:-1] @ rotations(0.5 * dtheta)
    dvel = 9.8 * DT * middle[:, 2, :]
    draw = np.random.default_rng(0)
    return Log(sign * dtheta + draw.normal(0, 1e-8, dtheta.shape), dvel + draw.normal(0, 3e-5, dvel.shape), DT, 20, lat)


@pytest.mark.parametrize("make", [standing, swaying])
@pytest.mark.parametrize("lat", [LAT, -LAT])
def test_the_earth_turns_the_wrong_way(make, lat):
    log = make(lat=lat)
    assert not log_findings(log)
    for wrong in (dataclasses.replace(log, dtheta=-log.dtheta), dataclasses.replace(log, lat=-lat)):
        (found,) = log_findings(wrong)
        assert found.name == "Earth's rotation"
        assert not found.trusted
        assert found.value == pytest.approx(np.degrees(-wrong.lat), abs=1.0)
        assert "gyro signs are inverted, or the latitude has the wrong sign" in found.text


@pytest.mark.parametrize("change", [{"bias": (100, -50, 30)}, {"noise": 1e-4}, {"lat": 0.05}, {"seconds": 8}])
def test_who_cannot_tell_is_silent(change):
    """A coarse or noisy gyroscope (deg/h, rad), a place near the equator, seconds."""
    log = standing(**change)
    assert not log_findings(dataclasses.replace(log, dtheta=-log.dtheta))


def test_random_biases_of_any_size_give_no_finding():
    draw = np.random.default_rng(0)
    for sd in (1.0, 5.0, 50.0, 500.0):
        for _ in range(25):
            assert not log_findings(standing(seconds=30, bias=draw.normal(0, sd, 3)))


def velocities(seconds, v, noise=0.01, frame="nav"):
    t = np.arange(seconds + 1.0)
    draw = np.random.default_rng(1)
    return Measurements(frame, t, np.broadcast_to(v, (len(t), 3)) + draw.normal(0, noise, (len(t), 3)))


def test_stretches_at_rest():
    assert [(x.first, x.stop) for x in stretches(standing())] == [(0, 2400)]
    (whole,) = stretches(standing(aid=velocities(120, [0, 0, 0])))
    assert (whole.first, whole.stop, whole.still) == (0, 2400, False)


def test_what_moves_is_not_at_rest():
    assert not stretches(standing(aid=velocities(120, [0, 0.3, 0]))), "a glide"
    assert not stretches(standing(aid=velocities(120, [0.012, 0, 0]))), "one as slow as the noise"
    v = np.zeros((121, 3))
    v[40:80, 1] = 2.0
    log = standing(aid=velocities(120, v), moving=[(38, 81)])
    found = stretches(log)
    assert sum(x.stop - x.first for x in found) * DT > 50
    assert all(x.still and (x.stop * DT <= 40 or x.first * DT >= 79) for x in found)
    (wrong,) = log_findings(dataclasses.replace(log, dtheta=-log.dtheta))
    assert wrong.name == "Earth's rotation"


def driving(seconds=120, noise=0.1, late=0.0, slip=0.0, bias=0.0, speed=8.0, straight=False):
    """Turns of both senses; `slip`: the part of the turning that the course does not follow."""
    t = np.arange(round(seconds / DT) + 1) * DT
    yaw = 0.0 * t if straight else 1.2 * np.sin(0.2 * t) + 0.4 * np.sin(0.47 * t)
    draw = np.random.default_rng(0)
    dtheta = np.column_stack([0 * t[1:], 0 * t[1:], np.diff(yaw) + bias * DT]) + draw.normal(0, 1e-5, (len(t) - 1, 3))
    dvel = np.array([0, 0, 9.8]) * DT + draw.normal(0, 1e-3, dtheta.shape)
    at = np.arange(seconds + 1.0)
    course = (1 - slip) * np.interp(at - late, t, yaw) + 0.3
    v = speed * np.column_stack([np.cos(course), np.sin(course), 0 * at]) + draw.normal(0, noise, (len(at), 3))
    return Log(dtheta, dvel, DT, 20, LAT, aids=(Measurements("nav", at, v),))


def with_velocity(log, turn):
    one = log.aids[0]
    return log.with_aid(dataclasses.replace(one, value=one.value @ np.asarray(turn, float).T))


SOUND = [{}, {"noise": 0.8}, {"late": 1.0}, {"slip": 0.3}, {"bias": 0.05}, {"straight": True}, {"speed": 0.2}]


@pytest.mark.parametrize("change", SOUND)
def test_a_course_that_follows_is_sound(change):
    assert not log_findings(driving(**change))


@pytest.mark.parametrize("change", [{}, {"noise": 0.8}, {"late": 1.0}, {"bias": 0.05}])
def test_a_mirrored_course_is_found(change):
    log = driving(**change)
    wrong = [
        with_velocity(log, [[0, 1, 0], [1, 0, 0], [0, 0, -1]]),
        with_velocity(log, [[0, 1, 0], [1, 0, 0], [0, 0, 1]]),
        dataclasses.replace(log, dtheta=log.dtheta * [1, 1, -1]),
    ]
    for one in wrong:
        (found,) = log_findings(one)
        assert found.name == "turning"
        assert not found.trusted
        assert found.value == pytest.approx(-1.0, abs=0.2)
        assert "NED velocities given as ENU" in found.text


def test_the_sense_of_a_velocity_does_not_show():
    assert not log_findings(with_velocity(driving(), -np.eye(3)))


def test_another_size_is_a_note():
    log = driving()
    (found,) = log_findings(dataclasses.replace(log, dtheta=0.3 * log.dtheta))
    assert found.name == "turning"
    assert found.trusted


def test_one_turn_against_the_course_decides_nothing():
    """What flies sideways may turn once against its course."""
    log = driving(straight=True)
    dtheta, t = log.dtheta.copy(), np.arange(121.0)
    dtheta[1200:1280, 2] += 0.02
    course = 0.3 - np.clip(0.4 * (t - 60), 0, 1.6)
    v = 8 * np.column_stack([np.cos(course), np.sin(course), 0 * t])
    one = dataclasses.replace(log.aids[0], value=v + np.random.default_rng(0).normal(0, 0.1, v.shape))
    assert not log_findings(dataclasses.replace(log, dtheta=dtheta).with_aid(one))
