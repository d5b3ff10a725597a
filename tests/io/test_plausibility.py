import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from logs import DT, EVERY, GOOD, LAT, fields, log_of, message, static

from jaxalign.earth import EARTH_RATE
from jaxalign.errors import UserError
from jaxalign.io import read

UNITS = {
    "in g": (1 / 9.80665, "in g?"),
    "rates given as increments": (1 / DT, "rates (m/s^2) given as increments"),
    "increments given as rates": (DT, "increments (m/s) given as rates"),
    "rates in g": (1 / DT / 9.80665, "rates in g given as increments"),
    "mg": (1e3 / 9.80665, "in mg?"),
    "feet": (1 / 0.3048, "ft/s^2"),
    "half": (0.5, "check unit and scale"),
    "nothing": (0.0, "check unit and scale"),
}


@pytest.mark.parametrize("case", UNITS)
def test_accelerations_in_a_wrong_unit_are_refused(case):
    factor, part = UNITS[case]
    text = message(dvel=GOOD["dvel"] * factor)
    assert part in text
    assert f"|f| = {9.8 * factor:.4g} m/s^2, expected about 9.8" in text


AXES = {
    "-z": (np.diag([1.0, 1.0, -1.0]), "along -z: forward-right-down"),
    "+x": (np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0.0]]), "along +x"),
    "-y": (np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]]), "along -y"),
}


@pytest.mark.parametrize("case", AXES)
def test_swapped_axes_are_a_warning(case):
    turn, part = AXES[case]
    log = log_of(**fields(dtheta=GOOD["dtheta"] @ turn.T, dvel=GOOD["dvel"] @ turn.T))
    assert len(log.warnings) == 1
    assert part in log.warnings[0]


def test_scale_of_the_accelerometers_is_a_warning():
    assert "+10 % off gravity" in log_of(**fields(dvel=GOOD["dvel"] * (1.1 * 9.80665 / 9.8))).warnings[0]


# --- gyroscopes in a wrong unit ---


def swaying(seconds=120.0, arm=0.0, hz=0.1, sensed=1.0, amplitude=0.1, seed=0):
    """Roll about the forward axis, angle a(t); an arm puts the accelerometers off the axis.

    `sensed` is the share of the tilt that accelerometers see: 1 on a ship, about 0 at the bob of a pendulum.
    """
    t = np.arange(0, seconds + DT / 2, DT)
    angle = amplitude * np.sin(2 * np.pi * hz * t)
    middle = 0.5 * (angle[1:] + angle[:-1])
    n = len(middle)
    rng = np.random.default_rng(seed)
    dtheta = np.zeros((n, 3))
    dtheta[:, 1] = np.diff(angle)
    dtheta += EARTH_RATE * DT * np.array([0.0, np.cos(LAT), np.sin(LAT)])
    side = -9.8 * np.sin(sensed * middle) - arm * (2 * np.pi * hz) ** 2 * middle
    f = np.column_stack([side, np.zeros(n), 9.8 * np.cos(middle)])
    f += 0.02 * rng.standard_normal((n, 3))
    return {"dtheta": dtheta, "dvel": f * DT, "velocity": np.zeros((n // EVERY + 1, 3)), "C_nb": None}


@pytest.mark.parametrize("kind", ["static", "body", "nav"])
@pytest.mark.parametrize(("factor", "part"), [(57.29578, "too large"), (1 / 57.29578, "too small")])
def test_a_swaying_vehicle_shows_gyros_in_a_wrong_unit(kind, factor, part):
    motion = swaying()
    aid = {"aid": kind} | ({"velocity": None} if kind == "static" else {})
    assert log_of(**fields(**(motion | aid))).warnings == ()
    text = message(**(motion | aid | {"dtheta": motion["dtheta"] * factor}))
    assert f"about 57.3 times {part}" in text


@pytest.mark.parametrize(("factor", "part"), [(57.29578, "too large"), (1 / 57.29578, "too small")])
def test_a_standing_vehicle_shows_gyros_in_a_wrong_unit(factor, part):
    changes = {key: np.tile(GOOD[key], (2, 1)) for key in ("dtheta", "dvel")} | {"C_nb": None}
    assert log_of(**static(**changes)).warnings == ()
    changes["dtheta"] = changes["dtheta"] * factor
    with pytest.raises(UserError, match=rf"57\.3 times {part} for the Earth's rotation"):
        log_of(**static(**changes))
    # the same numbers from a vehicle that may be turning prove nothing
    moving = fields(**changes, velocity=np.ones((41, 3)))
    assert log_of(**moving).warnings == ()


@pytest.mark.parametrize(("factor", "part"), [(57.29578, "too large"), (1 / 57.29578, "too small")])
def test_a_turning_car_shows_gyros_in_a_wrong_unit(factor, part):
    t = np.arange(0, 80 + DT / 2, DT)
    course = 0.5 * np.sin(2 * np.pi * t / 30)
    dtheta = np.zeros((len(t) - 1, 3))
    dtheta[:, 2] = np.diff(course)
    velocity = 10 * np.column_stack([-np.sin(course), np.cos(course), 0 * course])[::EVERY]
    dvel = np.tile([0, 0, 9.8 * DT], (len(dtheta), 1))  # flat: no witness in the accelerometers
    car = {"dtheta": dtheta, "dvel": dvel, "aid": "nav", "velocity": velocity, "C_nb": None}
    assert log_of(**fields(**car)).warnings == ()
    assert f"57.3 times {part} for the change of course" in message(**(car | {"dtheta": dtheta * factor}))


def test_gyros_against_the_accelerometers_are_a_warning():
    motion = swaying()
    log = log_of(**fields(**(motion | {"dtheta": -motion["dtheta"]})))
    assert ["turn against" in text for text in log.warnings] == [True]


@pytest.mark.parametrize(
    "motion",
    [
        {"hz": 5.0, "arm": 0.57, "amplitude": 0.01},  # omega^2 arm / g = 57
        {"hz": 3.0, "arm": 1.6, "amplitude": 0.01},
        {"hz": 0.2, "sensed": 1 / 57.3, "amplitude": 0.2},  # near the bob of a pendulum
        {"hz": 0.2, "sensed": 0.0, "amplitude": 0.2},
        {"amplitude": 0.0},
    ],
)
def test_where_it_cannot_be_known_nothing_is_said(motion):
    assert log_of(**fields(**swaying(**motion))).warnings == ()


@settings(max_examples=30, deadline=None)
@given(
    bias=st.lists(st.floats(-0.02, 0.02), min_size=3, max_size=3),
    noise=st.floats(0, 1e-3),
    push=st.floats(0, 3.0),
    seed=st.integers(0, 1000),
)
def test_bias_noise_and_pushes_raise_no_unit_alarm(bias, noise, push, seed):
    motion = swaying(seed=seed)
    rng = np.random.default_rng(seed)
    n = len(motion["dtheta"])
    slow = np.repeat(rng.standard_normal((n // 500, 3)), 500, axis=0) * push * DT
    motion["dtheta"] = motion["dtheta"] + np.array(bias) * DT + noise * rng.standard_normal((n, 3))
    motion["dvel"] = motion["dvel"] + slow
    assert log_of(**fields(**motion)).epochs == 120


def logs(shared):
    paths = [*sorted((shared / "data").glob("*/*.npz")), *sorted((shared / "data").glob("*/*.imu"))]
    assert len(paths) >= 12
    return [read(path) for path in paths]


def test_real_logs_are_taken_without_a_false_alarm(shared):
    for log in logs(shared):
        assert log.warnings == (), log.name
        # and so is every part of them
        for length in (45.0, 90.0):
            for start in np.arange(0, log.duration - length, length):
                assert log.crop(start, start + length).warnings == (), (log.name, start, length)


def test_wrong_units_and_axes_are_found_on_every_real_log(shared):
    for log in logs(shared):
        with pytest.raises(UserError, match=r"57\.3 times too large .* deg/s given as rad/s"):
            dataclasses.replace(log, dtheta=np.degrees(log.dtheta))
        with pytest.raises(UserError, match=r"57\.3 times too small"):
            dataclasses.replace(log, dtheta=np.radians(log.dtheta))
        with pytest.raises(UserError, match=r"in g\? multiply by 9.80665"):
            dataclasses.replace(log, dvel=log.dvel / 9.80665)
        with pytest.raises(UserError, match=r"rates \(m/s\^2\) given as increments"):
            dataclasses.replace(log, dvel=log.dvel / log.dt)
        for order, signs, part in (
            ([1, 0, 2], [1, 1, -1], "along -z"),
            ([2, 0, 1], [1, 1, 1], "along +x"),
            ([0, 2, 1], [1, -1, 1], "along -y"),
        ):
            turned = dataclasses.replace(log, dtheta=log.dtheta[:, order] * signs, dvel=log.dvel[:, order] * signs)
            assert [part in text for text in turned.warnings] == [True], (log.name, part)
