"""The Cramer-Rao bound: figures of others, closed forms, and what must make it larger or smaller."""

import dataclasses

import numpy as np
import pytest
from frozen import case
from logs import with_noise

from jaxalign import UserError
from jaxalign.bounds import bound
from jaxalign.cli.main import main
from jaxalign.earth import Site
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors
from jaxalign.simulate import Drift, Scenario, noiseless, scenario, static_base

EARTH_RATE, GRAVITY = 7.292115e-5, 9.795


def heading(found, *times):
    return [float(found.phi_deg[np.argmin(np.abs(found.time - t)), 2]) for t in times]


@pytest.mark.parametrize(
    ("name", "times", "known"),
    [
        ("dvl-sturn", (100, 200, 300), (2.67, 0.472, 0.205)),
        pytest.param("dvl-accturn", (100, 200, 300), (0.663, 0.283, 0.054), marks=pytest.mark.slow),
        pytest.param("gps-zigzag", (50, 100, 150, 200, 250), (3.37, 1.59, 1.43, 0.807, 0.743), marks=pytest.mark.slow),
    ],
)
def test_figures(name, times, known):
    """Computed by others from a batch information matrix and from a Riccati recursion."""
    np.testing.assert_allclose(heading(bound(scenario(name)), *times), known, rtol=0.02)


@pytest.mark.parametrize(
    ("name", "frozen"),
    [("dvl-sturn", "dvl_sturn_clean"), pytest.param("dvl-accturn", "dvl_accturn_clean", marks=pytest.mark.slow)],
)
def test_frozen_curves(shared, name, frozen):
    """East, north and up, wherever the bound is small against a radian; theirs has no measurement at epoch 0."""
    theirs = case(shared, frozen)[0]["crlb_deg"]
    found = bound(scenario(name))
    late = (np.asarray(found.time) >= 50) & (theirs.max(axis=1) < 10)
    np.testing.assert_allclose(found.phi_deg[late], theirs[late], rtol=0.05)


def test_closed_form_for_white_noise_of_the_aid():
    """A perfect inertial unit, first velocity unknown: sd sqrt(180 dt / T) / (g w_ie cos(lat) T^2 / 2)."""
    made = scenario("dvl-sturn")
    made = with_noise(noiseless(made), made.aids[0].sd)
    found = bound(made)
    for t in (200.0, 300.0):
        a = 0.5 * GRAVITY * EARTH_RATE * np.cos(float(made.site.lat)) * t**2
        np.testing.assert_allclose(heading(found, t)[0], np.rad2deg(0.1 * np.sqrt(180 / t) / a), rtol=0.03)


def test_faults_of_the_unit_are_left_out():
    made = scenario("dvl-sturn")
    spoilt = dataclasses.replace(made, imu_faults=(Drift(100.0),))
    np.testing.assert_array_equal(bound(spoilt).euler_deg, bound(made).euler_deg)


@pytest.mark.slow
def test_gyro_bias_bounds_a_vehicle_at_rest():
    """The east gyro's bias over the horizontal Earth rate, whatever the time."""
    made = scenario("sway", duration=300.0)
    drift = np.rad2deg(float(made.imu.gyro.bias) / (EARTH_RATE * np.cos(float(made.site.lat))))
    np.testing.assert_allclose(heading(bound(made), 300.0), drift, rtol=0.03)


def test_the_axis_that_points_east_bounds_a_vehicle_at_rest():
    """Its gyroscope alone: 0.02 deg/h of x or y among 5 deg/h of the others, or the other way round."""
    imu = ImuErrors(GyroErrors([0.02, 5.0, 5.0], 1e-5), AccelErrors(1.0, 1.0))
    for yaw, drift in ((0.0, 0.02), (90.0, 5.0)):
        made = Scenario(static_base(yaw_deg=yaw), Site(0.5), imu=imu, duration=300.0, imu_rate=20.0, epoch_samples=20)
        expected = drift * np.deg2rad(1) / 3600 / (EARTH_RATE * np.cos(0.5))
        np.testing.assert_allclose(np.deg2rad(heading(bound(made), 300.0)), expected, rtol=0.03)


@pytest.mark.slow
def test_more_noise_and_fewer_fixes_are_worse():
    made = scenario("dvl-sturn")
    usual = bound(made)
    noisier = bound(with_noise(made, 2 * made.aids[0].sd))
    holed = bound(scenario("dvl-sturn", gaps=[[40, 60]]))
    longer = np.asarray(usual.time) > 61
    for worse in (noisier, holed):
        assert (np.asarray(worse.phi_deg)[longer] > np.asarray(usual.phi_deg)[longer]).all()
    outliers = bound(scenario("dvl-sturn", outliers="fixed"))
    np.testing.assert_array_equal(outliers.phi_deg, usual.phi_deg)
    assert np.isfinite([usual.phi_deg, usual.euler_deg]).all()
    assert 100 < heading(usual, 0.0)[0] < 104  # nothing is known yet


def test_disturbed_base_is_refused():
    with pytest.raises(UserError, match="not white noise"):
        bound(scenario("disturbed"))


def test_command(tmp_path, capsys):
    table, picture = tmp_path / "bound.csv", tmp_path / "bound.png"
    command = ["bound", "dvl-sturn", "--set", "outliers=fixed", "--every", "100"]
    assert main([*command, "--output", str(table), "--plot", str(picture)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[2:5]] == ["100", "200", "300"]
    rows = np.genfromtxt(table, delimiter=",", names=True)
    assert len(rows) == 301
    np.testing.assert_allclose(rows["yaw_deg"][300], float(lines[4].split()[3]), rtol=1e-3)
    assert picture.stat().st_size > 10_000
    for arguments, said in (
        (["bound", "dvl-stur"], "did you mean 'dvl-sturn'"),
        (["bound", "disturbed"], "not white noise"),
        (["bound", "dvl-sturn", "--every", "0"], "every = 0"),
        (["bound", "dvl-sturn", "--plot", "bound.xyz"], "must end in"),
    ):
        assert main(arguments) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
