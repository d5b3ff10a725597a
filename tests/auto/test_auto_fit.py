"""Figures of the unit and of the aids fitted with the attitude, of logs of which nothing is said."""

import dataclasses

import numpy as np
import pytest

from jaxalign import align
from jaxalign.aids import Standing
from jaxalign.batch.auto_fit import AutoFit, fitted_unknowns
from jaxalign.batch.robust_map import RobustMap
from jaxalign.errors import UserError
from jaxalign.inertial_unit import GRADES, AccelErrors, GyroErrors, ImuErrors
from jaxalign.metrics import attitude_error_deg
from jaxalign.rotation import euler_from_dcm
from jaxalign.simulate import scenario, simulate


def chosen(log, calibrate=None, **known):
    """The method for a log."""
    aids = tuple(one.aid for one in log.aids) or (Standing(),)
    return AutoFit(RobustMap(aids=aids, calibrate=fitted_unknowns(aids) if calibrate is None else calibrate), **known)


def of_grade(name, grade, **options):
    """A log of a scenario with a unit of that grade, its biases of one standard deviation and any sign."""
    bias, walk, accel, noise = GRADES[grade]
    made = dataclasses.replace(
        scenario(name, **options), imu=ImuErrors(GyroErrors(bias, walk), AccelErrors(accel, noise))
    )
    return simulate(made, seed=5)


@pytest.mark.slow
@pytest.mark.parametrize("grade", ["navigation", "tactical", "mems"])
def test_figures_are_those_of_the_unit(grade):
    """Within their spread, which is wide; the attitude is within what is said of it, early and late."""
    log = of_grade("dvl-sturn", grade)
    method = chosen(log)
    assert method.estimator.calibrate == ("body.scale", "body.mounting", "body.slow")
    found = align(method, log, every=100)
    error, sd = attitude_error_deg(found, log)[1:], np.rad2deg(found.sd[1:])
    print(error, sd, found.filter.figures[-1])
    assert (np.abs(error) < 3.5 * sd).all()
    figures = dict(zip((name for name, _ in method.figures), found.filter.figures[-1], strict=True))
    _, walk, _, _ = GRADES[grade]
    assert 0.3 < figures["gyro white noise"] / walk < 3.0
    assert 0.7 < figures["noise of body"] / 0.1 < 1.4


@pytest.mark.slow
@pytest.mark.parametrize("grade", ["navigation"])
def test_standing(grade):
    """With gyroscopes of 200 deg/h the Earth's rate is not seen, and the heading is said to be open."""
    log = of_grade("sway", grade, duration=200.0)
    method = chosen(log)
    assert (method.standing, method.estimator.calibrate) == (True, ())
    found = align(method, log, every=20)
    assert bool(found.observable[-1]) == (grade == "navigation")
    truth = np.rad2deg(euler_from_dcm(log.C_nb[-1]))
    print(found.euler_deg[-1] - truth, found.euler_sd_deg[-1], found.filter.figures[-1])
    assert (np.abs(found.euler_deg[-1] - truth)[:2] < 3.5 * found.euler_sd_deg[-1, :2]).all()


def test_bad_input():
    log = simulate("dvl-sturn", seed=1, duration=20.0)
    with pytest.raises(UserError, match="did you mean 'tactical'"):
        chosen(log, grade="tactica")
    with pytest.raises(UserError, match="imu_errors"):
        chosen(log, imu=3.0)
    method = chosen(log, grade="tactical")
    assert [name for name, _ in method.figures][-2:] == ["slow error of body", "noise of body"]
    with pytest.raises(UserError, match="rows"):
        method.solve(method.epochs(log), np.array([99]))
