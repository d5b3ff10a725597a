"""NumPy on the host gives what JAX gives."""

import jax
import numpy as np
import pytest

from jaxalign import host, rotation


@pytest.fixture(scope="module")
def quats():
    q = np.random.default_rng(0).normal(size=(200, 4))
    q = np.concatenate([q, np.eye(4), -np.eye(4), [[1, 1e-9, 0, 0], [1, 1, 0, 0], [1, -1, 0, 0], [-1e-9, 1, 2, 3]]])
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def test_matrices_angles_and_headings(quats):
    wanted = jax.jit(lambda q: (rotation.dcm_from_quat(q), rotation.euler_from_quat(q)))(quats)
    dcm, euler = host.dcm_from_quat(quats), host.euler_from_quat(quats)
    np.testing.assert_allclose(dcm, wanted[0], atol=1e-14)
    sure = np.abs(np.abs(dcm[:, 2, 1]) - 1.0) > 1e-9  # at a pitch of 90 deg only together are roll and yaw determined
    assert 0 < (~sure).sum() < 5
    turn = np.mod(euler - wanted[1] + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(turn[sure], 0.0, atol=1e-12)
    np.testing.assert_allclose(turn[:, 0], 0.0, atol=1e-7)
    assert host.heading_deg(np.array([1e-20, -np.pi / 2])).tolist() == [0.0, 90.0]


def test_matrices_back_to_quaternions(quats):
    back = host.quat_from_dcm(host.dcm_from_quat(quats))
    np.testing.assert_allclose(np.abs(np.sum(back * quats, axis=1)), 1.0, atol=1e-14)


def test_errors(quats):
    other = np.roll(quats, 1, axis=0)
    wanted = np.asarray(jax.jit(rotation.attitude_error)(quats, other))
    found = host.attitude_error(quats, other)
    half = np.abs(np.linalg.norm(wanted, axis=1) - np.pi) < 1e-6  # either sign
    np.testing.assert_allclose(found[~half], wanted[~half], atol=1e-12)
    np.testing.assert_allclose(np.abs(found[half]), np.abs(wanted[half]), atol=1e-6)
    small = host.attitude_error(quats, quats)
    np.testing.assert_allclose(small, 0.0, atol=1e-15)


def test_covariances_of_angles(quats):
    steep = np.abs(host.dcm_from_quat(quats)[:, 2, 1]) > 1.0 - 1e-6
    q = quats[~steep]
    a = np.random.default_rng(1).normal(size=(len(q), 3, 3))
    covariance = a @ np.swapaxes(a, 1, 2)
    wanted = np.asarray(jax.jit(rotation.euler_covariance)(q, covariance))
    found = host.euler_covariance(q, covariance)
    scale = np.abs(wanted).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(found / scale, wanted / scale, atol=1e-9)
