"""Figures of an inertial unit: units, axes, what is refused."""

import json

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxalign as ja
from jaxalign import AccelErrors, GyroErrors, ImuErrors, UserError, imu_errors, with_parameters
from jaxalign.earth import STANDARD_GRAVITY
from jaxalign.methods import build
from jaxalign.simulate import simulate
from jaxalign.tune import space_of

AXES = ImuErrors(
    GyroErrors([1.0, 2.0, 3.0], 0.1, bias_walk_deg_h_sqrt_h=[6.0, 0.0, 1.0]), AccelErrors(500.0, [80.0, 80.0, 90.0])
)


def test_units():
    gyro, accel = GyroErrors(1.0, 0.6, 2.0, 60.0), AccelErrors(1.0, 100.0, 3.0, 60.0)
    degree, ug = np.pi / 180, STANDARD_GRAVITY * 1e-6
    expected = [degree / 3600, 0.6 * degree / 60, 2 * degree / 3600, degree / 3600]  # 60 per sqrt(h): 1 per sqrt(s)
    np.testing.assert_allclose([gyro.bias, gyro.density, gyro.sample_sd, gyro.bias_walk], expected, rtol=1e-12)
    expected = [ug, 100 * ug, 3 * ug, ug]
    np.testing.assert_allclose([accel.bias, accel.density, accel.sample_sd, accel.bias_walk], expected, rtol=1e-12)
    assert GyroErrors().bias_walk is None


@pytest.mark.parametrize("unit", [ImuErrors(GyroErrors(1.0, [0.1, 0.2, 0.0], 5.0), AccelErrors(0.0, 50.0, 400.0))])
def test_noise_per_sample_as_a_density(unit):
    """The same increments; nothing changes twice, nor inside traced code."""
    rate = 200.0
    found = unit.at_rate(rate)
    for triad, before in ((found.gyro, unit.gyro), (found.accel, unit.accel)):
        np.testing.assert_allclose(triad.increment_sd(1 / rate), before.increment_sd(1 / rate), rtol=1e-12)
        np.testing.assert_allclose(triad.density / np.sqrt(rate), before.increment_sd(1 / rate), rtol=1e-12)
    assert found.at_rate(rate).gyro is found.gyro
    traced = eqx.filter_jit(lambda unit: unit.at_rate(rate))(unit)
    np.testing.assert_allclose(traced.gyro.density, found.gyro.density, rtol=1e-12)
    np.testing.assert_allclose(traced.accel.density, found.accel.density, rtol=1e-12)
    found.check_densities()
    for refused in (build("robust_map").with_imu, build("fine").with_imu):
        with pytest.raises(UserError, match=r"stated per sample.*imu\.at_rate"):
            refused(unit)


def test_a_log_has_the_rate_and_epochs_have_none():
    log = simulate("dvl-sturn", 1, duration=10.0)
    unit = ImuErrors(GyroErrors(2.0, noise_deg_h=60.0), AccelErrors(100.0, noise_ug=100.0))
    chosen = ja.choose(log, unit).method.imu
    np.testing.assert_allclose(chosen.gyro.walk_deg_sqrt_h, 1.0 / np.sqrt(200.0))
    np.testing.assert_allclose(chosen.accel.density_ug_sqrt_hz, 100.0 / np.sqrt(200.0))
    with pytest.raises(UserError, match="stated per sample"):
        ja.assess(build("oba", "body"), build("oba", "body").epochs(log), unit)


def test_over_lanes():
    """Axes first, lanes last; as many axes for all figures, so that few programs serve all units."""
    one, three = imu_errors("tactical").over_lanes(4), AXES.over_lanes(4)
    assert {x.shape for x in jax.tree.leaves(one)} == {(1, 4)}
    assert {x.shape for x in jax.tree.leaves(three)} == {(3, 4)}
    assert len(jax.tree.leaves(one)) == len(jax.tree.leaves(three)) == 8
    np.testing.assert_array_equal(three.gyro.bias_deg_h[:, 2], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(three.accel.bias_walk_ug_sqrt_h, 0.0)
    several = ImuErrors(GyroErrors(np.array([[1.0, 2.0]])))
    np.testing.assert_array_equal(several.over_lanes(2).gyro.bias_deg_h, [[1.0, 2.0]])


@pytest.mark.parametrize("name", ["robust_map", "fine"])
def test_a_method_with_axes_goes_through_a_file(name):
    method = build(name).with_imu(AXES)
    values = json.loads(json.dumps(ja.parameters(method)))
    assert eqx.tree_equal(build(name, parameters=values), method)
    plain = build(name, parameters={path: x for path, x in values.items() if "bias_walk" not in path})
    walk = plain.imu if name == "robust_map" else plain.filter.imu
    assert walk.gyro.bias_walk is None


def test_settings_as_typed():
    made = with_parameters(ImuErrors(), {"gyro.bias_deg_h": "[1, 2, 3]", "accel.bias_walk_ug_sqrt_h": "5"})
    np.testing.assert_array_equal(made.gyro.bias_deg_h, [1, 2, 3])
    assert float(with_parameters(made, {"gyro.bias_deg_h": "4"}).gyro.bias_deg_h) == 4.0
    assert with_parameters(made, {"accel.bias_walk_ug_sqrt_h": "none"}).accel.bias_walk is None


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: GyroErrors([1.0, 2.0]), r"bias_deg_h has the shape \(2,\): one number is expected, or three"),
        (lambda: AccelErrors(noise_ug=[1.0, -1.0, 0.0]), "noise_ug: must be at least 0"),
        (lambda: GyroErrors(bias_walk_deg_h_sqrt_h=-1.0), "bias_walk_deg_h_sqrt_h: must be at least 0"),
        (lambda: GyroErrors("small"), "expected a number or a list of numbers, got 'small'"),
        (lambda: build("robust_map", parameters={"imu.gyro.bias_deg_h": "[1, 2]"}), "a number, or three, one per axis"),
        (lambda: build("robust_map", parameters={"imu.gyro.bias_deg_h": [1, 2, 2e5]}), r"outside its bounds 0 \.\. 1"),
        (lambda: build("robust_map", parameters={"imu.gyro.walk_deg_sqrt_h": None}), "must be a number, or three"),
        (lambda: build("robust_map", parameters={"imu.gyro_bias_deg_h": 1}), r"is now called imu\.gyro\.bias_deg_h"),
        (lambda: build("fine", parameters={"filter.accel_bias_ug": 1}), r"is now called filter\.imu\.accel\.bias_ug"),
        (lambda: build("robust_map", parameters={"imu.gyro.noise_deg_h": 1}), "no parameter 'imu.gyro.noise_deg_h'"),
        (lambda: space_of(build("robust_map").with_imu(AXES), ["imu.gyro.bias_deg_h"]), "holds 1, 2, 3, one per axis"),
        (lambda: space_of(build("fine"), ["filter.imu.gyro.bias_walk_deg_h_sqrt_h"]), "is not set: give it a positive"),
    ],
)
def test_refused_in_one_line(call, message):
    with pytest.raises(UserError, match=message) as found:
        call()
    assert "\n" not in str(found.value)
