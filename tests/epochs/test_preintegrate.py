"""Preintegration against a loop in NumPy, closed forms, and motions whose drift is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numeric import EPS, assert_derivatives, skew
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from jaxalign.preintegration import Increment, preintegrate
from jaxalign.published.preintegration import interval, interval_plain, pairs_series
from jaxalign.vector import Quat, Vec3, mean_rotated

PAPERS = {x.__name__: x for x in (interval, interval_plain, pairs_series)}
SCHEMES = ["pairs", "pairs_series", "lookback", "interval", "interval_plain"]
compiled = jax.jit(preintegrate, static_argnames=("every", "scheme"))


def run(th, dv, every, scheme="pairs"):
    """(rotations, velocity increments) as SciPy and NumPy hold them."""
    found = compiled(th, dv, every=every, scheme=PAPERS.get(scheme, scheme))
    return Rotation.from_quat(np.roll(found.rotation.array, -1, axis=-1)), np.asarray(found.dvel.array)


def record(samples, seed=15, angle=0.05):
    rng = np.random.default_rng(seed)
    return angle * rng.normal(size=(samples, 3)), 0.1 * rng.normal(size=(samples, 3)) + [0, 0, 0.05]


def turn_matrix(th):
    """V(th): the mean of exp([s th x]) over s from 0 to 1, from the exponential of an augmented matrix."""
    augmented = np.zeros((6, 6))
    augmented[:3, :3], augmented[:3, 3:] = skew(th), np.eye(3)
    return expm(augmented)[:3, 3:]


def series_matrix(th):
    return np.eye(3) + skew(th) / 2 + skew(th) @ skew(th) / 6


def plain_matrix(th):
    return np.eye(3) + skew(th) / 2


def two_samples(th1, dv1, th2, dv2, mean, coning=2 / 3):
    phi = th1 + th2 + coning * np.cross(th1, th2)
    return phi, mean(th1 + th2) @ (dv1 + dv2) + 2 / 3 * (np.cross(th1, dv2) + np.cross(dv1, th2))


def with_look_back(th_, dv_, th, dv):
    return th + np.cross(th_, th) / 12, turn_matrix(th) @ dv + (np.cross(th_, dv) + np.cross(dv_, th)) / 12


def loop(th, dv, every, scheme):
    """The formulas of the module's docstring, sample by sample."""
    rotations, velocities = [], []
    for start in range(0, len(th) // every * every, every):
        stop, k, steps = start + every, start, []
        if scheme in ("interval", "interval_plain"):
            middle = start + every // 2
            th1, dv1 = th[start:middle].sum(axis=0), dv[start:middle].sum(axis=0)
            th2, dv2 = th[middle:stop].sum(axis=0), dv[middle:stop].sum(axis=0)
            how = (turn_matrix, 2 / 3) if scheme == "interval" else (plain_matrix, 0.0)
            steps = [two_samples(th1, dv1, th2, dv2, *how)]
            k = stop
        mean = series_matrix if scheme == "pairs_series" else turn_matrix
        while k < stop:
            if scheme.startswith("pairs") and k + 1 < stop:
                steps.append(two_samples(th[k], dv[k], th[k + 1], dv[k + 1], mean))
                k += 2
            else:
                before = (th[k - 1], dv[k - 1]) if k else (np.zeros(3), np.zeros(3))
                steps.append(with_look_back(*before, th[k], dv[k]))
                k += 1
        c, v = Rotation.identity(), np.zeros(3)
        for phi, increment in steps:
            v = v + c.apply(increment)
            c = c * Rotation.from_rotvec(phi)
        rotations.append(c)
        velocities.append(v)
    return Rotation.concatenate(rotations), np.array(velocities)


def assert_same(found, expected, tolerance):
    (c, v), (c_, v_) = found, expected
    assert len(c) == len(c_)
    assert np.max(np.abs(c.as_matrix() - c_.as_matrix())) < tolerance
    assert np.max(np.abs(v - v_)) < tolerance


@pytest.mark.parametrize("every", [1, 4, 5])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_schemes_against_a_loop(scheme, every):
    """22 samples: the remainder at the end is left out, and lookback reaches over the borders of the intervals."""
    th, dv = record(22)
    if scheme.startswith("interval") and every % 2:
        with pytest.raises(ValueError, match=f"{every} samples cannot be halved"):
            run(th, dv, every, scheme)
        return
    if scheme == "pairs_series" and every == 1:
        with pytest.raises(ValueError, match="no pair"):
            run(th, dv, every, scheme)
        return
    found = run(th, dv, every, scheme)
    assert_same(found, loop(th, dv, every, scheme), 40 * EPS)
    assert len(found[1]) == 22 // every


def test_unknown_scheme_is_named():
    with pytest.raises(ValueError, match="unknown scheme 'pair': one of pairs, "):
        preintegrate(jnp.zeros((4, 3)), jnp.zeros((4, 3)), 2, "pair")  # pyright: ignore[reportArgumentType]


def test_results_are_float64_components_with_unit_quaternions():
    found = compiled(*record(40), every=8, scheme="pairs")
    for leaf in jax.tree.leaves(found):
        assert leaf.shape == (5,)
        assert leaf.dtype == jnp.float64
    np.testing.assert_allclose(found.rotation.norm2(), 1.0, rtol=0, atol=4 * EPS)


def test_composition_over_sub_intervals():
    """One interval is its parts one after the other."""
    th, dv = record(24)
    parts, whole = compiled(th, dv, every=4, scheme="pairs"), compiled(th, dv, every=24, scheme="pairs")
    total = jax.tree.map(lambda x: x[0], parts)
    for i in range(1, 6):
        total = total @ jax.tree.map(lambda x, i=i: x[i], parts)
    np.testing.assert_allclose(total.rotation.array, whole.rotation.array[0], rtol=0, atol=8 * EPS)
    np.testing.assert_allclose(total.dvel.array, whole.dvel.array[0], rtol=0, atol=8 * EPS)


def test_composition_is_associative():
    a, b, c = (Increment(Quat.exp(Vec3(*r)), Vec3(*v)) for r, v in np.random.default_rng(16).normal(size=(3, 2, 3)))
    left, right = (a @ b) @ c, a @ (b @ c)
    np.testing.assert_allclose(left.rotation.array, right.rotation.array, rtol=0, atol=8 * EPS)
    np.testing.assert_allclose(left.dvel.array, right.dvel.array, rtol=0, atol=16 * EPS)


@pytest.mark.parametrize(
    ("scheme", "every"), [("pairs", 6), ("pairs", 5), ("pairs", 1), ("lookback", 6), ("interval", 6)]
)
def test_constant_rate_and_force_are_exact(scheme, every):
    """Any angle: the rotation is exp(T w), the velocity its mean times T f."""
    w, f, dt = np.array([2.0, -3.0, 1.5]), np.array([0.4, -0.2, 9.8]), 0.1
    found = compiled(np.tile(w * dt, (12, 1)), np.tile(f * dt, (12, 1)), every=every, scheme=PAPERS.get(scheme, scheme))
    length = every * dt
    rotation = Rotation.from_rotvec(w * length).as_matrix()
    dvel = mean_rotated(Vec3(*w * length), Vec3(*f * length)).array
    np.testing.assert_allclose(dvel, turn_matrix(w * length) @ f * length, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.rotation.matrix.array, np.tile(rotation, (12 // every, 1, 1)), rtol=0, atol=2e-15)
    np.testing.assert_allclose(found.dvel.array, np.tile(dvel, (12 // every, 1)), rtol=0, atol=2e-14)


CONE, SAMPLES = 1e-3, 40  # half angle (rad); samples per turn


def coning_drift(scheme, samples_per_turn):
    """Rotation about the axis of the cone that is left after whole turns, per sample, over the square of the angle.

    Body axes at q(t) = [cos(a/2), sin(a/2) cos(wt), sin(a/2) sin(wt), 0]: the attitude comes back every turn, the
    rates are w_x = -w sin(a) sin(wt), w_y = w sin(a) cos(wt), w_z = -2 w sin(a/2)^2.
    """
    turns = 20 * SAMPLES // samples_per_turn  # as many samples in all
    edges = 2 * np.pi * np.arange(samples_per_turn * turns + 1) / samples_per_turn
    th = np.stack([np.sin(CONE) * np.diff(np.cos(edges)), np.sin(CONE) * np.diff(np.sin(edges))])
    th = np.concatenate([th, -2 * np.sin(CONE / 2) ** 2 * np.diff(edges)[None]]).T
    # lookback needs a predecessor of its first sample; the others do not mind
    th = np.concatenate([th[-SAMPLES:], th])
    every = 2 if scheme.startswith("interval") else SAMPLES
    rotations, _ = run(th, np.zeros_like(th), every, scheme)
    total = Rotation.identity()
    for step in rotations[SAMPLES // every :]:
        total = total * step
    return total.as_rotvec()[2] / (samples_per_turn * turns) / CONE**2


@pytest.mark.parametrize(
    ("scheme", "theory"),
    [
        # area swept by the chord, less what th1 x th2 makes of it; x = angle of the cone in a sample
        ("interval_plain", lambda x: (2 * x - np.sin(2 * x)) / 4),
        ("pairs", lambda x: (x + np.sin(2 * x) / 6 - 4 / 3 * np.sin(x)) / 2),
        ("interval", lambda x: (x + np.sin(2 * x) / 6 - 4 / 3 * np.sin(x)) / 2),
        ("lookback", lambda x: (x - np.sin(x)) / 2 - (1 - np.cos(x)) * np.sin(x) / 6),
    ],
)
def test_drift_under_coning(scheme, theory):
    """The drift that is left is the one of the algorithm's theory: order 3 in x if uncompensated, 5 otherwise."""
    drifts = [coning_drift(scheme, samples) for samples in (SAMPLES, 2 * SAMPLES)]
    for drift, samples in zip(drifts, (SAMPLES, 2 * SAMPLES), strict=True):
        expected = theory(2 * np.pi / samples)
        # fourth order in the angle of the cone is neglected; rounding of th over its square
        assert abs(abs(drift) / expected - 1) < 1e-4 + 1e-10 / expected
    order = np.log2(drifts[0] / drifts[1])
    assert order == pytest.approx(3 if scheme == "interval_plain" else 5, abs=0.05)


def test_pairs_beat_the_plain_sum_under_coning():
    assert abs(coning_drift("pairs", SAMPLES)) < 0.01 * abs(coning_drift("interval_plain", SAMPLES))


def _smooth_motion(length, samples):
    """Increments of smooth rates and forces over so many seconds, and the exact result of integrating them."""

    def rate(t):
        return np.array([0.8 + 1.1 * t, -0.5 + 2.0 * t - t**2, 1.2 - 0.9 * t])

    def force(t):
        return np.array([0.5 - 3.0 * t, 2.0 * t**2 - 0.4, 9.8 + 1.5 * t])

    def slopes(t, y):
        c = y[:9].reshape(3, 3)
        return np.concatenate([(c @ skew(rate(t))).ravel(), c @ force(t)])

    exact = solve_ivp(slopes, (0, length), [*np.eye(3).ravel(), 0, 0, 0], method="DOP853", rtol=1e-13, atol=1e-15).y[
        :, -1
    ]
    nodes, weights = np.polynomial.legendre.leggauss(4)
    dt = length / samples
    at = (np.arange(samples)[:, None] + (nodes + 1) / 2) * dt
    th, dv = (np.einsum("ckn,n->kc", g(at), weights) * dt / 2 for g in (rate, force))
    return th, dv, exact[:9].reshape(3, 3), exact[9:]


@pytest.mark.parametrize(("scheme", "rotation_order", "velocity_order"), [("pairs", 4, 3), ("interval_plain", 2, 2)])
def test_order_of_the_error_in_a_smooth_motion(scheme, rotation_order, velocity_order):
    """Per interval of fixed length, halving the sampling interval gains at least 2 to these powers."""
    errors = []
    for samples in (32, 64):
        th, dv, c, v = _smooth_motion(0.8, samples)
        every = 2 if scheme == "interval_plain" else samples
        parts = compiled(th, dv, every=every, scheme=PAPERS.get(scheme, scheme))
        total = jax.tree.map(lambda x: x[0], parts)
        for i in range(1, samples // every):
            total = total @ jax.tree.map(lambda x, i=i: x[i], parts)
        errors.append([np.abs(total.rotation.matrix.array - c).max(), np.abs(total.dvel.array - v).max()])
    orders = np.log2(np.array(errors[0]) / np.array(errors[1]))
    assert orders[0] > rotation_order - 0.2
    assert orders[1] > velocity_order - 0.2


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "every"), [("pairs", 3), ("lookback", 2)])
def test_derivatives(scheme, every):
    """With respect to every increment; at zero rotation all series are at their zero."""
    th, dv = record(4)
    points = np.stack([[np.zeros((4, 3)), dv], [th, dv]])

    def f(x):
        found = preintegrate(x[0], x[1], every, scheme)
        return jnp.concatenate([found.rotation.array[0], found.dvel.array[0]])

    jacobian = assert_derivatives(f, points, third=3.0)[0]
    for sample in range(4):
        used = np.eye(3) * (sample < every)
        np.testing.assert_allclose(jacobian[1:4, 0, sample], used / 2, rtol=0, atol=EPS)
        np.testing.assert_allclose(jacobian[4:, 1, sample], used, rtol=0, atol=EPS)


def test_vmap_is_a_loop():
    runs = [record(9, seed) for seed in range(3)]
    th, dv = (np.stack(x) for x in zip(*runs, strict=True))
    together = jax.jit(jax.vmap(lambda a, b: preintegrate(a, b, 3)))(th, dv)
    for i in range(3):
        alone = compiled(th[i], dv[i], every=3, scheme="pairs")
        for x, y in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(x[i], y, rtol=0, atol=4 * EPS)
