"""Rotations as arrays: conventions against SciPy, every branch, derivatives at and away from zero."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numeric import EPS, assert_derivatives, skew
from scipy.spatial.transform import Rotation

from jaxalign import rotation

rot = SimpleNamespace(**{name: jax.jit(getattr(rotation, name)) for name in rotation.__all__})
RNG = np.random.default_rng(5)
RANDOM = Rotation.random(200, rng=np.random.default_rng(6))
TURNS = {  # about an axis, by angles that put w, x, y or z in front; ties of two and of all four
    "w": [0.3, -0.4, 0.5],
    "x": [3.0, 0.2, -0.1],
    "y": [0.3, -2.9, 0.2],
    "z": [-0.2, 0.1, 3.1],
    "half turn about x": [np.pi, 0, 0],
    "half turn about y": [0, np.pi, 0],
    "half turn about z": [0, 0, np.pi],
    "half turn, x = y": [np.pi / np.sqrt(2), np.pi / np.sqrt(2), 0],
    "third of a turn": [2 * np.pi / np.sqrt(27)] * 3,
    "none": [0.0, 0.0, 0.0],
}


def scalar_first(rotation: Rotation) -> np.ndarray:
    return np.roll(rotation.as_quat(), 1, axis=-1)


def same_rotation(p, q):
    """The larger of the two signs' distances is 2, the smaller is what counts."""
    p, q = np.asarray(p), np.asarray(q)
    return np.minimum(np.max(np.abs(p - q), axis=-1), np.max(np.abs(p + q), axis=-1))


def test_everything_agrees_with_scipy():
    a, b = RANDOM[:100], RANDOM[100:]
    p, q, v = scalar_first(a), scalar_first(b), RNG.normal(size=(100, 3))
    rotvec = RNG.normal(size=(100, 3))
    assert np.max(same_rotation(rot.quat_multiply(p, q), scalar_first(a * b))) < 8 * EPS
    assert np.max(same_rotation(rot.quat_conjugate(p), scalar_first(a.inv()))) < EPS
    np.testing.assert_allclose(rot.quat_rotate(p, v), a.apply(v), rtol=0, atol=40 * EPS)
    np.testing.assert_allclose(rot.dcm_from_quat(p), a.as_matrix(), rtol=0, atol=8 * EPS)
    exp = rot.quat_from_rotvec(rotvec)
    assert np.max(same_rotation(exp, scalar_first(Rotation.from_rotvec(rotvec)))) < 4 * EPS
    np.testing.assert_allclose(rot.rotvec_from_quat(p), a.as_rotvec(), rtol=0, atol=1e-14)
    assert np.max(same_rotation(rot.quat_from_dcm(a.as_matrix()), p)) < 8 * EPS


def test_euler_angles_are_yaw_pitch_roll_about_turned_axes():
    """C_nb = Rz(yaw) Rx(pitch) Ry(roll) is SciPy's intrinsic ZXY."""
    pitch, roll, yaw = RNG.uniform([[-1.5], [-3.1], [-3.1]], [[1.5], [3.1], [3.1]], size=(3, 200))
    euler = np.stack([pitch, roll, yaw], axis=-1)
    theirs = Rotation.from_euler("ZXY", np.stack([yaw, pitch, roll], axis=-1))
    np.testing.assert_allclose(rot.dcm_from_euler(euler), theirs.as_matrix(), rtol=0, atol=8 * EPS)
    assert np.max(same_rotation(rot.quat_from_euler(euler), scalar_first(theirs))) < 4 * EPS
    # the angles lose digits as 1 / cos(pitch) towards the vertical
    lost = np.cos(pitch)[:, None]
    for found in (rot.euler_from_dcm(theirs.as_matrix()), rot.euler_from_quat(scalar_first(theirs))):
        np.testing.assert_allclose(found * lost, euler * lost, rtol=0, atol=20 * EPS)


def test_each_euler_angle_turns_the_right_way():
    """Nose up is positive pitch, right side down positive roll, nose to the west positive yaw."""
    small = 0.1
    nose, right = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    pitch, roll, yaw = rot.dcm_from_euler(small * np.eye(3))
    np.testing.assert_allclose(pitch @ nose, [0, np.cos(small), np.sin(small)], atol=EPS)
    np.testing.assert_allclose(roll @ right, [np.cos(small), 0, -np.sin(small)], atol=EPS)
    np.testing.assert_allclose(yaw @ nose, [-np.sin(small), np.cos(small), 0], atol=EPS)
    assert rot.heading_deg(jnp.deg2rad(90.0)) == pytest.approx(270.0)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-9, 1e-7 - np.pi / 2])
def test_euler_angles_give_the_attitude_back_with_the_nose_straight_up(pitch):
    """Roll and yaw are not separable there, but together they must still describe the attitude."""
    for roll, yaw in ((0.3, 0.4), (-2.5, 1.0), (0.0, 3.0)):
        dcm = rot.dcm_from_euler(jnp.array([pitch, roll, yaw]))
        euler = rot.euler_from_dcm(dcm)
        assert euler[0] == pytest.approx(pitch, abs=3e-8)  # a cosine near one is blind to 1.5e-8
        np.testing.assert_allclose(rot.dcm_from_euler(euler), dcm, rtol=0, atol=1e-14)
    exact = jnp.array([[0.6, 0.0, 0.8], [0.8, 0.0, -0.6], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(rot.dcm_from_euler(rot.euler_from_dcm(exact)), exact, rtol=0, atol=1e-15)
    for mode in (jax.jacfwd, jax.jacrev):
        assert np.all(np.isfinite(mode(rot.euler_from_dcm)(exact)))


def test_derivatives_of_the_euler_angles():
    points = np.array([[0.0, 0.0, 0.0], [0.1, -0.2, 3.0], [-1.2, 2.9, -0.4]])
    assert_derivatives(rot.quat_from_euler, points)
    round_trip = assert_derivatives(lambda e: rot.euler_from_quat(rot.quat_from_euler(e)), points, third=30.0)
    np.testing.assert_allclose(round_trip, np.tile(np.eye(3), (3, 1, 1)), rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", TURNS)
def test_quaternion_of_a_dcm_in_every_branch(name):
    turn = Rotation.from_rotvec(TURNS[name])
    dcm, expected = turn.as_matrix(), scalar_first(turn)
    q = np.asarray(rot.quat_from_dcm(dcm))
    assert same_rotation(q, expected) < 4 * EPS
    assert q[0] >= 0
    assert abs(q @ q - 1) < 4 * EPS


def test_derivatives_of_the_quaternion_of_a_dcm():
    """q(exp([phi x]) C) has the derivative (0, phi) q / 2, whichever branch is taken."""
    turns = np.array([TURNS[name] for name in ("w", "x", "y", "z", "third of a turn", "none")])
    points = np.concatenate([np.zeros_like(turns), turns], axis=1)

    def f(x):
        return rot.quat_from_dcm(
            rot.dcm_from_quat(rot.quat_from_rotvec(x[:3])) @ rot.dcm_from_quat(rot.quat_from_rotvec(x[3:]))
        )

    jacobian = assert_derivatives(f, points, steps=(1e-3, 1e-4), third=10.0)[:, :, :3]
    q = np.asarray(jax.vmap(f)(points))
    expected = 0.5 * np.concatenate([-q[:, None, 1:], q[:, :1, None] * np.eye(3) - skew(q[:, 1:])], axis=1)
    np.testing.assert_allclose(jacobian, expected, rtol=0, atol=1e-14)


def test_batches_keep_their_shape():
    euler = RNG.uniform(-1, 1, size=(2, 3, 3))
    q, dcm = rot.quat_from_euler(euler), rot.dcm_from_euler(euler)
    assert q.shape == (2, 3, 4)
    assert dcm.shape == (2, 3, 3, 3)
    one_by_one = [[rot.quat_from_dcm(dcm[i, j]) for j in range(3)] for i in range(2)]
    np.testing.assert_allclose(rot.quat_from_dcm(dcm), one_by_one, rtol=0, atol=EPS)
    one_by_one = [[rot.euler_from_dcm(dcm[i, j]) for j in range(3)] for i in range(2)]
    np.testing.assert_allclose(rot.euler_from_dcm(dcm), one_by_one, rtol=0, atol=2 * EPS)
    np.testing.assert_allclose(rot.rotvec_from_quat(q)[1, 2], rot.rotvec_from_quat(q[1, 2]), rtol=0, atol=EPS)


@pytest.mark.parametrize(
    ("yaw", "heading"),
    [
        (0.0, 0.0),
        (-0.0, 0.0),
        (1e-20, 0.0),
        (-1e-20, 0.0),
        (-np.pi / 2, 90.0),
        (np.pi / 2, 270.0),
        (np.pi, 180.0),
        (-np.pi, 180.0),
        (-1e-3, np.rad2deg(1e-3)),
        (1e-3, 360 - np.rad2deg(1e-3)),
        (-4 * np.pi, 0.0),
    ],
)
def test_heading(yaw, heading):
    found = float(rot.heading_deg(yaw))
    assert 0 <= found < 360
    assert found == pytest.approx(heading, abs=1e-18 if heading == 0.0 and abs(yaw) < 1 else 1e-12)


@settings(max_examples=200, deadline=None)
@given(st.floats(-100, 100))
def test_heading_stays_in_its_range_and_on_its_direction(yaw):
    heading = float(rot.heading_deg(yaw))
    assert 0 <= heading < 360
    assert abs(np.exp(-1j * np.deg2rad(heading)) - np.exp(1j * yaw)) < 1e-13


def test_heading_passes_nan_on():
    assert np.isnan(rot.heading_deg(jnp.nan))


@settings(max_examples=50, deadline=None)
@given(arrays(float, 3, elements=st.floats(-1.75, 1.75)), arrays(float, 3, elements=st.floats(-3, 3)))
def test_attitude_error_is_exact_at_any_angle(phi, euler):
    """C_est = exp(-[phi x]) C_true, built by SciPy; |phi| up to 3.03 rad."""
    true = Rotation.from_euler("ZXY", euler)
    estimate = Rotation.from_rotvec(-phi) * true
    found = rot.attitude_error(scalar_first(estimate), scalar_first(true))
    # near a half turn the logarithm inherits the rounding of q times 1 / cos(|phi| / 2), at most 20
    np.testing.assert_allclose(found, phi, rtol=0, atol=2e-14)


def test_attitude_error_has_the_sign_of_the_literature():
    phi = 1e-6 * np.array([1.0, -2.0, 3.0])
    true = RANDOM[0].as_matrix()
    estimate = (np.eye(3) - skew(phi)) @ true
    found = rot.attitude_error(rot.quat_from_dcm(estimate), rot.quat_from_dcm(true))
    np.testing.assert_allclose(found, phi, rtol=0, atol=2e-11)  # second order: |phi|^2
    # an estimate turned too far to the west (yaw too large) has a negative error about up
    too_far = rot.attitude_error(
        rot.quat_from_euler(jnp.array([0.1, 0.2, 1.01])), rot.quat_from_euler(jnp.array([0.1, 0.2, 1.0]))
    )
    np.testing.assert_allclose(too_far, [0, 0, -0.01], rtol=0, atol=1e-15)


def test_derivatives_of_the_attitude_error():
    """d phi / d (rotation of the estimate by -x) is the identity where the error is zero."""
    q = scalar_first(RANDOM[1])

    def f(x):
        return rot.attitude_error(rot.quat_multiply(rot.quat_from_rotvec(-x), q), q)

    points = np.array([[0.0, 0.0, 0.0], [1e-12, 0.0, 0.0], [0.5, -1.0, 0.7]])
    jacobians = assert_derivatives(f, points, third=10.0, noise=30.0)
    np.testing.assert_allclose(jacobians, np.tile(np.eye(3), (3, 1, 1)), rtol=0, atol=1e-14)
