"""Components of 3-vectors, quaternions and matrices: laws of the group, series at zero, derivatives."""

from fractions import Fraction
from math import factorial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numeric import EPS, assert_derivatives, skew
from scipy.spatial.transform import Rotation

from jaxalign.vector import Mat3, Quat, Vec3, mean_rotated, where

BATCHES = [(), (3,), (2, 3)]
GRID = st.integers(-1000, 1000).map(lambda k: k / 1000)  # zeros and equal components do come up
ANGLES = np.array([0.0, 1e-200, 1e-12, 1e-8, 0.9999e-3, 1.0001e-3, 1.3e-3, 0.1, 1.0, 2.5, np.pi - 1e-3, np.pi - 1e-9])
AXES = np.array([(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.6, -0.48, 0.64)])
ROTVECS = (ANGLES[:, None, None] * AXES).reshape(-1, 3)
SEAM = 1e-3  # rad: below it, series


@jax.jit
def exp_of(rotvec):
    return Quat.exp(Vec3.of(rotvec)).array


@jax.jit
def log_of(q):
    return Quat.of(q).log().array


@jax.jit
def mean_of(rotvec, v):
    return mean_rotated(Vec3.of(rotvec), Vec3.of(v)).array


@jax.jit
def errors_of_laws(p, q, r, u, v):
    """|left side - right side| of the axioms; the quaternions are made unit first."""
    p, q, r = (Quat.of(x).unit() for x in (p, q, r))
    u, v = Vec3.of(u), Vec3.of(v)
    one, pq = Quat.of(jnp.array([1.0, 0.0, 0.0, 0.0])), p * q
    laws = {
        "associative": ((pq * r).array, (p * (q * r)).array),
        "right identity": ((p * one).array, p.array),
        "left identity": ((one * p).array, p.array),
        "inverse": ((p * p.conjugate()).array, one.array),
        "inverse of a product": (pq.conjugate().array, (q.conjugate() * p.conjugate()).array),
        "norm": (p.norm2(), 1.0),
        "action": (pq.rotate(v).array, p.rotate(q.rotate(v)).array),
        "linear": (p.rotate(u * 2.0 - v).array, (p.rotate(u) * 2.0 - p.rotate(v)).array),
        "cross": (p.rotate(u.cross(v)).array, p.rotate(u).cross(p.rotate(v)).array),
        "dot": (p.rotate(u).dot(p.rotate(v)), u.dot(v)),
        "matrix": (jnp.einsum("...ij,...j->...i", p.matrix.array, v.array), p.rotate(v).array),
        "homomorphism": (p.matrix.array @ q.matrix.array, pq.matrix.array),
        "double cover": ((-p).matrix.array, p.matrix.array),
        "exp after log": (Quat.exp(p.log()).matrix.array, p.matrix.array),
        "angle": (p.log().norm(), 2 * jnp.arctan2(p.vector.norm(), jnp.abs(p.w))),
    }
    return {name: jnp.max(jnp.abs(left - right)) for name, (left, right) in laws.items()}


@pytest.mark.parametrize("batch", BATCHES)
def test_group_axioms(batch):
    quats, vecs = arrays(float, (3, *batch, 4), elements=GRID), arrays(float, (2, *batch, 3), elements=GRID)

    @settings(max_examples=60, deadline=None)
    @given(quats, vecs)
    def check(q, v):
        for name, error in errors_of_laws(*q, *v).items():
            assert error < 60 * EPS, name

    check()


@pytest.mark.parametrize("batch", BATCHES)
def test_vectors_and_matrices_are_those_of_numpy(batch):
    a, b, c = np.random.default_rng(1).normal(size=(3, *batch, 3))
    u, v, w = (Vec3(*np.moveaxis(x, -1, 0)) for x in (a, b, c))
    outer, rows = a[..., :, None] * b[..., None, :], np.stack([a, b, c], axis=-2)
    m, n = u.outer(v), Mat3(u, v, w)
    pairs = [
        (Vec3.of(a).array, a),
        ((u + v).array, a + b),
        ((u - v).array, a - b),
        ((-u).array, -a),
        ((2.0 * u).array, 2 * a),
        (u.dot(v), np.sum(a * b, axis=-1)),
        (u.cross(v).array, np.cross(a, b)),
        (u.norm(), np.linalg.norm(a, axis=-1)),
        (u.unit().array, a / np.linalg.norm(a, axis=-1, keepdims=True)),
        (m.array, outer),
        (m.trace, np.trace(outer, axis1=-2, axis2=-1)),
        ((m + n).array, outer + rows),
        ((m - n * 3.0).array, outer - 3 * rows),
        (n.map_rows(lambda row: row.cross(w)).array, np.cross(rows, c[..., None, :])),
    ]
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=20 * EPS)


def test_constants_are_float64_whatever_surrounds_them():
    for constant in (Vec3.zero(), Mat3.zero(), Quat.identity()):
        assert constant.array.dtype == jnp.float64
    assert not np.any(Mat3.zero().array)
    np.testing.assert_array_equal(Quat.identity().matrix.array, np.eye(3))


def test_an_array_times_a_vector_scales_it():
    # NumPy must not take the product over and spread the vector over its elements
    scaled = np.arange(3.0) * Vec3(1.0, 2.0, 3.0)
    np.testing.assert_array_equal(scaled.array, np.arange(3.0)[:, None] * [1.0, 2.0, 3.0])


def test_where_chooses_whole_pytrees():
    chosen = where(jnp.array([True, False]), Vec3.of(jnp.ones((2, 3))), Vec3.of(jnp.zeros((2, 3))))
    np.testing.assert_array_equal(chosen.array, [[1.0] * 3, [0.0] * 3])


def test_exp_and_log_undo_each_other():
    q = exp_of(ROTVECS)
    half, axes = np.repeat(ANGLES / 2, len(AXES))[:, None], np.tile(AXES, (len(ANGLES), 1))
    np.testing.assert_allclose(q, np.concatenate([np.cos(half), np.sin(half) * axes], 1), rtol=0, atol=2 * EPS)
    for found in (log_of(q), log_of(-q)):
        assert np.all(np.abs(found - ROTVECS) <= 4 * EPS * 2 * half)


def test_log_at_pi_is_one_of_the_two():
    q = np.concatenate([np.zeros((len(AXES), 1)), AXES], axis=1)
    np.testing.assert_allclose(log_of(q), np.pi * AXES, rtol=0, atol=4 * EPS)


def test_log_is_exact_through_its_series():
    """Against the series of atan in rational arithmetic, on both sides of sin(angle / 2) = 1e-3."""
    tangents = [1e-5, 0.999e-3, 1.001e-3, 1.5e-3]
    exact = [2 * sum(Fraction((-1) ** k, 2 * k + 1) * Fraction(t) ** (2 * k + 1) for k in range(8)) for t in tangents]
    q = np.array([[1.0, t, 0.0, 0.0] / np.sqrt(1 + t**2) for t in tangents])
    np.testing.assert_allclose(log_of(q)[:, 0], np.array(exact, float), rtol=4 * EPS)


def _exact_mean_rotated(rotvec, v):
    """The power series in rational arithmetic: exact up to the last rounding for small angles."""
    r, x = [Fraction(c) for c in rotvec], [Fraction(c) for c in v]
    a2 = sum(c * c for c in r)
    first = sum((-a2) ** k / factorial(2 * k + 2) for k in range(6))
    second = sum((-a2) ** k / factorial(2 * k + 3) for k in range(6))

    def cross(a, b):
        return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]

    turned = cross(r, x)
    twice = cross(r, turned)
    return [float(x[i] + first * turned[i] + second * twice[i]) for i in range(3)]


def test_mean_rotated_is_exact_through_its_series():
    rotvecs = ROTVECS[np.linalg.norm(ROTVECS, axis=1) < 0.2]
    for v in np.random.default_rng(2).normal(size=(3, 3)):
        exact = [_exact_mean_rotated(r, v) for r in rotvecs]
        atol = 3 * EPS * np.linalg.norm(v)
        np.testing.assert_allclose(mean_of(rotvecs, np.tile(v, (len(rotvecs), 1))), exact, rtol=0, atol=atol)


def test_mean_rotated_is_the_mean():
    nodes, weights = np.polynomial.legendre.leggauss(24)
    rotvecs = np.concatenate([ROTVECS, np.pi * AXES])
    rotvecs = rotvecs[np.linalg.norm(rotvecs, axis=1) < np.pi + 1e-9]  # as far as its series go
    v = np.random.default_rng(3).normal(size=rotvecs.shape)
    means = [
        weights @ Rotation.from_rotvec(np.outer((nodes + 1) / 2, r)).apply(x) / 2
        for r, x in zip(rotvecs, v, strict=True)
    ]
    np.testing.assert_allclose(mean_of(rotvecs, v), means, rtol=0, atol=20 * EPS)


def test_turn_is_exp():
    """By series alone; with few terms for slow turns."""
    sizes = np.linalg.norm(ROTVECS, axis=1)
    for slow, most in ((False, 2 * np.pi + 1e-9), (True, 0.05)):
        rotvecs = ROTVECS[sizes <= most]
        assert len(rotvecs) > 10
        turned = np.asarray(Quat.turn(Vec3.of(rotvecs), slow=slow).array)
        np.testing.assert_allclose(turned, exp_of(rotvecs), rtol=0, atol=6 * EPS)
    for h in (1e-5, 1e-6):  # differentiable at zero, where exp needs a branch
        slope = jax.jacfwd(lambda x: Quat.turn(Vec3.of(x)).array)(jnp.zeros(3))
        numeric = [(np.asarray(Quat.turn(Vec3.of(h * e)).array) - [1, 0, 0, 0]) / h for e in np.eye(3)]
        np.testing.assert_allclose(slope, np.transpose(numeric), atol=h)


def test_values_and_derivatives_do_not_jump_where_the_series_end():
    v = jnp.array([0.3, -0.5, 0.8])
    below, above = (jnp.asarray(AXES[2] * SEAM * (1 + d)) for d in (-1e-14, 1e-14))
    for f in (
        lambda r: mean_of(r, v),
        exp_of,
        lambda x: log_of(jnp.concatenate([jnp.sqrt(1 - x @ x)[None], x])),
    ):
        both = jax.jit(lambda x, f=f: (f(x), jax.jacfwd(f)(x)))
        (value, slope), (other_value, other_slope) = both(below), both(above)
        np.testing.assert_allclose(other_value, value, rtol=0, atol=6 * EPS)
        np.testing.assert_allclose(other_slope, slope, rtol=0, atol=1e-12)


SCALES = np.array([0.0, 1e-12, 0.9999e-3, 1.0001e-3, 0.5, 2.0])
POINTS = SCALES[:, None] * AXES[2]


def test_derivatives_of_exp():
    jacobians = assert_derivatives(lambda r: Quat.exp(Vec3.of(r)).array, POINTS)
    at_zero = np.concatenate([np.zeros((1, 3)), np.eye(3) / 2])
    np.testing.assert_allclose(jacobians[0], at_zero, rtol=0, atol=EPS)
    np.testing.assert_allclose(jacobians[1], at_zero, rtol=0, atol=1e-12)


def test_derivatives_of_mean_rotated():
    v = np.array([0.3, -0.5, 0.8])
    points = np.concatenate([POINTS, np.tile(v, (len(POINTS), 1))], axis=1)
    jacobians = assert_derivatives(lambda x: mean_rotated(Vec3.of(x[:3]), Vec3.of(x[3:])).array, points)
    at_zero = np.concatenate([-skew(v) / 2, np.eye(3)], axis=1)
    np.testing.assert_allclose(jacobians[0], at_zero, rtol=0, atol=EPS)
    np.testing.assert_allclose(jacobians[1], at_zero, rtol=0, atol=1e-12)


def test_derivatives_of_log():
    """The derivative of log(exp(r) exp(x)) at x = 0 is the inverse right Jacobian, which has a closed form."""
    angles = np.array([0.0, 1e-12, 0.9999e-3, 1.0001e-3, 1.0, 3.1])
    points = np.concatenate([angles[:, None] * AXES[2], np.zeros((6, 3))], axis=1)
    jacobians = assert_derivatives(
        lambda x: (Quat.exp(Vec3.of(x[:3])) * Quat.exp(Vec3.of(x[3:]))).log().array,
        points,
        third=50.0,
        steps=(1e-4, 1e-5),
    )
    m = skew(points[:, :3])
    safe = np.maximum(angles, 1e-2)  # 1/12 + O(angle^2) below
    second = np.where(angles < 1e-2, 1 / 12, 1 / safe**2 - 1 / (2 * safe * np.tan(safe / 2)))
    expected = np.eye(3) + m / 2 + second[:, None, None] * m @ m
    np.testing.assert_allclose(jacobians[:, :, 3:], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_derivatives_of_norm_and_unit(scale):
    a = np.array([0.3, -0.5, 0.8]) * scale
    length, direction = np.linalg.norm(a), a / np.linalg.norm(a)
    jacobian = assert_derivatives(
        lambda x: jnp.stack([Vec3.of(x).norm(), *(Vec3.of(x).unit() * scale).array]),
        a[None],
        third=20 / scale**2,
        steps=(1e-3 * scale, 1e-4 * scale),
    )[0]
    np.testing.assert_allclose(jacobian[0], direction, atol=4 * EPS)
    expected = (np.eye(3) - np.outer(direction, direction)) / length * scale
    np.testing.assert_allclose(jacobian[1:], expected, atol=8 * EPS)


def test_null_vector_and_null_quaternion():
    def f(x):
        return jnp.stack([Vec3.of(x).norm(), *Vec3.of(x).unit().array])

    def g(x):
        return Quat.of(x).unit().array

    assert not np.any(f(jnp.zeros(3)))
    np.testing.assert_array_equal(g(jnp.zeros(4)), [1, 0, 0, 0])
    for mode in (jax.jacfwd, jax.jacrev):
        assert not np.any(jax.jit(mode(f))(jnp.zeros(3)))
        assert np.all(np.isfinite(jax.jit(mode(g))(jnp.zeros(4))))
    assert np.all(np.isfinite(jax.jit(jax.jacfwd(jax.jacrev(f)))(jnp.zeros(3))))


def test_renormalised_takes_out_rounding():
    rng = np.random.default_rng(4)
    q = rng.normal(size=(100, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    renewed = Quat.of(jnp.asarray(q * (1 + 1e-9 * rng.normal(size=(100, 1))))).renormalised()
    # Newton squares the error: 1.5e-18 of it is left
    np.testing.assert_allclose(renewed.norm2(), 1.0, rtol=0, atol=4 * EPS)
    np.testing.assert_allclose(renewed.array, q, rtol=0, atol=4 * EPS)


def test_positive_keeps_the_rotation():
    q = Quat.of(jnp.asarray([[-0.5, 0.5, 0.5, 0.5], [0.5, -0.5, 0.5, 0.5], [0.0, 1.0, 0.0, 0.0]]))
    np.testing.assert_array_equal(
        q.positive().array, [[0.5, -0.5, -0.5, -0.5], [0.5, -0.5, 0.5, 0.5], [0.0, 1.0, 0.0, 0.0]]
    )
