"""Vondrak's smoothing: frozen 60-digit results, exact gain, preserved moments, another solver, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import cho_solve_banded, cholesky_banded

from jaxalign import UserError, parameters, with_parameters
from jaxalign.prefilter import Vondrak, cutoff_from_theta, factor, gain, smooth, solve, theta_from_cutoff, vondrak

run = jax.jit(smooth)


@pytest.mark.parametrize("name", ["eq200_fc5", "eq200_theta_lo", "uneq400_fc2", "n5", "grav4000_fc0p5"])
def test_frozen(shared, name):
    with np.load(shared / "cases" / "disturbed_vondrak.npz") as z:
        assert name in z["names"]
        t, y, p, theta, out, err = (z[f"{name}_{key}"] for key in ("t", "y", "p", "theta", "out", "qr64_err"))
    found = run(t, y, p, jnp.asarray(float(theta)))
    assert np.abs(found - out).max() < max(1e-8, 10 * float(err))


@pytest.mark.parametrize("cutoff", [5.0, 0.5, 0.05])
def test_gain_measured_with_sines(cutoff):
    """In the middle of 300 s at 200 Hz, where the ends do not reach."""
    t = np.arange(60000) * 0.005
    theta = theta_from_cutoff(cutoff)
    problem = jax.jit(factor)(t, np.ones_like(t), theta)
    middle = slice(25000, 35000)
    for frequency in (0.3, 0.5, 1.0, 5.0):
        out = np.asarray(jax.jit(solve)(problem, np.sin(2 * np.pi * frequency * t)))[middle]
        angle = 2 * np.pi * frequency * t[middle]
        both = np.linalg.lstsq(np.stack([np.sin(angle), np.cos(angle)], axis=1), out, rcond=None)[0]
        np.testing.assert_allclose(both, [gain(frequency, 0.005, theta), 0.0], atol=1e-6)


def test_gain_at_the_cutoff():
    theta = theta_from_cutoff(0.5)
    assert theta == pytest.approx(np.pi**6)
    assert cutoff_from_theta(theta) == pytest.approx(0.5)
    assert gain(0.5, 1e-4, theta) == pytest.approx(0.5, rel=1e-6)
    assert cutoff_from_theta(theta_from_cutoff(0.7, 0.3), 0.3) == pytest.approx(0.7)


@pytest.mark.parametrize("cutoff", [0.5, 0.05, 0.005])
def test_quadratics_pass(cutoff):
    """The paper's setting and two decades beyond: rounding is all that is lost."""
    t = np.arange(60000) * 0.005
    y = 9.8 + 0.3 * (t / 300) - 0.7 * (t / 300) ** 2
    np.testing.assert_allclose(run(t, y, np.ones_like(t), theta_from_cutoff(cutoff)), y, rtol=1e-10)


def uneven(n=400, seed=1):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 4, n))
    p = np.where(np.arange(n) % 7 == 0, 0.0, rng.uniform(0.5, 2.0, n))
    return t, rng.normal(size=n) + 9.8, p


def test_weighted_moments_are_preserved():
    """Sums of p y, p t y, p t^2 y, whatever theta: a mean of filtered data is the mean of the data."""
    t, y, p = uneven()
    for cutoff in (0.1, 2.0, 50.0):
        s = np.asarray(run(t, y, p, theta_from_cutoff(cutoff)))
        for power in range(3):
            np.testing.assert_allclose((p * t**power * s).sum(), (p * t**power * y).sum(), rtol=1e-10)


def test_missing_samples_have_no_influence():
    t, y, p = uneven()
    theta = theta_from_cutoff(2.0)
    spoilt = np.where(p == 0, 1e6, y)
    np.testing.assert_allclose(run(t, spoilt, p, theta), run(t, y, p, theta), atol=1e-12)


def test_limits():
    """No smoothing, and the weighted quadratic."""
    t, y, p = uneven()
    p = np.maximum(p, 0.5)
    np.testing.assert_allclose(run(t, y, p, 1e40), y, atol=1e-9)
    basis = np.stack([np.ones_like(t), t, t * t], axis=1)
    fit = np.linalg.lstsq(basis * np.sqrt(p)[:, None], y * np.sqrt(p), rcond=None)[0]
    np.testing.assert_allclose(run(t, y, p, 1e-9), basis @ fit, atol=1e-6)


def test_another_solver():
    """Banded Cholesky of the normal matrix with refinement, at 0.5 Hz and 200 Hz."""
    n, dt = 4000, 0.005
    t = np.arange(n) * dt
    y = np.random.default_rng(7).normal(size=n)
    kappa = 1.0 / (float(theta_from_cutoff(0.5)) * dt**6)
    third = np.array([-1.0, 3.0, -3.0, 1.0])

    def penalty(x):
        d = sum(c * x[i : n - 3 + i] for i, c in enumerate(third))
        return sum(np.pad(c * d, (i, 3 - i)) for i, c in enumerate(third))

    # Columns 0 to 3 below the diagonal of D'D: correlations of the stencil, cut at the ends.
    band = np.zeros((4, n))
    for j in range(4):
        for i in range(4 - j):
            band[j, i : i + n - 3] += third[i] * third[i + j]
    band *= kappa
    band[0] += 1.0
    chol = cholesky_banded(band, lower=True)
    x = cho_solve_banded((chol, True), y)
    for _ in range(4):
        x = x + cho_solve_banded((chol, True), (y - x) - kappa * penalty(x))
    np.testing.assert_allclose(run(t, y, np.ones(n), theta_from_cutoff(0.5)), x, atol=1e-8)


@pytest.mark.slow
def test_derivatives():
    t, y, p = uneven()
    w = np.random.default_rng(3).normal(size=len(t))
    theta = theta_from_cutoff(2.0)

    def loss(log_theta, y, p):
        return jnp.dot(w, smooth(jnp.asarray(t), y, p, theta * jnp.exp(log_theta)))

    at = (jnp.zeros(()), jnp.asarray(y), jnp.asarray(p))
    reverse = jax.jit(jax.grad(loss, (0, 1, 2)))(*at)
    forward = jax.jit(jax.jacfwd(loss, (0, 1, 2)))(*at)
    value = jax.jit(loss)
    direction = np.random.default_rng(5).normal(size=len(t))
    moves = (1.0, direction, np.where(p > 0, 0.1 * direction, 0.0))
    for i, move in enumerate(moves):
        np.testing.assert_allclose(reverse[i], forward[i], rtol=1e-8, atol=1e-9 * np.abs(forward[i]).max())
        for step in (1e-3, 1e-4):
            ahead, behind = (
                value(*(x + sign * step * move if i == j else x for j, x in enumerate(at))) for sign in (1, -1)
            )
            np.testing.assert_allclose(jnp.sum(reverse[i] * move), (ahead - behind) / (2 * step), rtol=1e-4)
    assert np.isfinite(reverse[2]).all()


def test_columns_share_a_factor():
    t, y, p = uneven()
    problem = jax.jit(factor)(t, p, theta_from_cutoff(1.0))
    columns = np.stack([y, 2 * y + 1, -y])
    together = jax.jit(jax.vmap(solve, (None, 0)))(problem, columns)
    for alone, one in zip(together, columns, strict=True):
        np.testing.assert_allclose(alone, run(t, one, p, theta_from_cutoff(1.0)), atol=1e-10)


def state_space(t, y, p, theta):
    """The same problem as a diffuse random walk of divided differences: Kalman filter and RTS smoother, in NumPy.

    State (y, DD1, DD2) of Newton's form at point i; unknown start as three regressors, found by generalised least
    squares from the innovations; the smoother then starts from them with certainty. Exact, also for uneven spacing.
    """
    n = len(t)
    kappa = (n - 3) / (theta * (t[-2] - t[1]))
    h = t[1:] - t[:-1]

    def move(i):
        """From the state at i to that at i + 1: noise enters DD2 (from i = 2 on), then DD1, then y."""
        f, g = np.eye(3), np.zeros(3)
        dd1, y1 = (t[i + 1] - t[i - 1] if i >= 1 else h[i]), h[i]
        f[1, 2] = dd1 if i >= 1 else 0.0
        f[0] = [1.0, y1, y1 * f[1, 2]]
        if i >= 2:
            e2 = t[i + 1] - t[i - 2]
            g = np.array([y1 * dd1 * e2, dd1 * e2, e2])
        return f, g

    # Before three points are seen DD1, DD2 belong to the first ones: start at point 2 with a general state.
    steps = [move(i) for i in range(2, n - 1)]
    quiet = [1.0 / (36.0 * kappa * h[i - 1]) for i in range(2, n - 1)]
    row = np.array([1.0, 0.0, 0.0])
    # y at points 0 and 1 from the state at 2: y1 = y2 - h1 DD1, y0 = y1 - h0 (DD1 - (t2 - t0) DD2).
    early = np.array([[1.0, -h[1] - h[0], h[0] * (t[2] - t[0])], [1.0, -h[1], 0.0]])
    rows = [early[0], early[1], row]
    # Regressors: what the filter makes of unit starts; information in square-root form.
    x, cov = np.zeros((3, 4)), np.zeros((3, 3))  # columns: unit starts, then the data
    x[:, :3] = np.eye(3)
    whitened = [np.sqrt(p[k]) * np.append(rows[k], y[k]) for k in range(3) if p[k] > 0]
    history = []
    for i, ((f, g), q) in enumerate(zip(steps, quiet, strict=True)):
        predicted, pc = f @ x, f @ cov @ f.T + q * np.outer(g, g)
        k = i + 3
        x, cov = predicted, pc
        if p[k] > 0:
            s = pc[0, 0] + 1.0 / p[k]
            innovation = np.append(-predicted[0, :3], y[k] - predicted[0, 3])
            whitened.append(np.append(predicted[0, :3], y[k] - predicted[0, 3]) / np.sqrt(s))
            x = predicted + np.outer(pc[:, 0] / s, innovation)
            cov = pc - np.outer(pc[:, 0], pc[0]) / s
        history.append((predicted, pc, x, cov, f))
    whitened = np.array(whitened)
    start = np.linalg.lstsq(whitened[:, :3], whitened[:, 3], rcond=None)[0]
    combine = np.append(start, 1.0)
    out = np.zeros(n)
    smoothed = history[-1][2] @ combine
    out[-1] = smoothed[0]
    for i in range(len(history) - 1, 0, -1):
        predicted, pc, _, _, f = history[i]
        _, _, filtered, cov, _ = history[i - 1]
        gain_ = np.linalg.lstsq(pc, f @ cov, rcond=None)[0].T
        smoothed = filtered @ combine + gain_ @ (smoothed - predicted @ combine)
        out[i + 2] = smoothed[0]
    out[:3] = [r @ start for r in rows]
    return out


def test_state_space_solver():
    """An independent solver with exact diffuse start: equal at 0.5 Hz and 200 Hz, and for uneven spacing."""
    t = np.arange(4000) * 0.005
    y = 9.8 + 0.1 * np.random.default_rng(7).normal(size=4000)
    theta = float(theta_from_cutoff(0.5))
    np.testing.assert_allclose(run(t, y, np.ones(4000), theta), state_space(t, y, np.ones(4000), theta), atol=1e-8)
    t, y, p = uneven()
    theta = float(theta_from_cutoff(2.0))
    np.testing.assert_allclose(run(t, y, p, theta), state_space(t, y, p, theta), atol=1e-8)


@pytest.mark.slow
def test_ends_are_hardly_filtered():
    """What the docstring says of a sine at twice the cut-off."""
    t = np.arange(60000) * 0.005
    response = [0.0, 0.0]
    for i, phase in enumerate((0.0, np.pi / 2)):
        response[i] = np.asarray(Vondrak()(jnp.asarray(np.sin(2 * np.pi * t + phase))[:, None], 0.005))[:, 0]
    size = np.hypot(*response)
    assert size[0] == pytest.approx(0.99, abs=0.01)
    assert size[100] == pytest.approx(0.14, abs=0.01)
    assert size[30000] == pytest.approx(0.0154, abs=1e-4)


@pytest.mark.slow
def test_record_of_the_user():
    """NaN: weight zero, for all axes; columns by themselves; theta instead of a cut-off."""
    t, y, p = uneven()
    y = np.stack([y, -y], axis=1)
    holed = y.copy()
    holed[50, 1] = np.nan
    weights = np.where(np.arange(len(t)) == 50, 0.0, p)
    found = vondrak(t, holed, 2.0, weights=p)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, vondrak(t, y, theta=theta_from_cutoff(2.0), weights=weights), atol=1e-12)
    np.testing.assert_allclose(found[:, 1], -found[:, 0], atol=1e-12)
    inside = jax.jit(lambda y: vondrak(t, y, 2.0, weights=p))(holed)
    np.testing.assert_allclose(inside, found, atol=1e-12)
    slope = jax.jit(jax.grad(lambda y: jnp.sum(vondrak(t, y, 2.0, weights=p) ** 2)))(holed)
    assert np.isfinite(slope).all()
    assert (slope[50] == 0).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: {"t": a["t"][:3], "y": a["y"][:3]}, "3 samples: third derivatives need at least four"),
        (lambda a: {"weights": np.where(np.arange(9) < 2, 1.0, 0.0)}, "only 2 samples have a weight"),
        (lambda a: {"y": np.where(np.arange(9) < 2, 1.0, np.nan)}, "only 2 samples have a weight"),
        (lambda a: {"t": a["t"][::-1]}, "times must increase, but number 1"),
        (lambda a: {"t": np.repeat(a["t"], 2)[:9]}, "merge samples of one time"),
        (lambda a: {"t": np.where(np.arange(9) == 4, np.nan, a["t"])}, "time number 4 is not finite"),
        (lambda a: {"theta": 0.0}, r"theta = 0.0: must be one positive, finite number \(s\^-6\)"),
        (lambda a: {"cutoff": -1.0}, r"cutoff = -1.0: must be one positive, finite number \(Hz\)"),
        (lambda a: {"cutoff": np.ones(2)}, "must be one positive"),
        (lambda a: {"weights": -np.ones(9)}, "weight number 0 is -1.0"),
        (lambda a: {"y": np.where(np.arange(9) == 3, np.inf, 1.0)}, "sample number 3 is infinite"),
        (lambda a: {"y": np.ones(8)}, "give .n,. times"),
        (lambda a: {"y": np.ones(9, np.float32)}, "float32"),
    ],
)
def test_bad_input(change, words):
    good = {"t": np.arange(9.0), "y": np.ones(9), "cutoff": 0.1}
    vondrak(**good)
    with pytest.raises(UserError, match=words):
        vondrak(**{**good, **change(good)})


def test_too_few_weights_inside_traced_code_stay_finite():
    """Where nothing can be raised: finite values and gradients."""
    t = jnp.arange(9.0)

    @jax.jit
    @jax.value_and_grad
    def total(p):
        return jnp.sum(vondrak(t, t, 0.1, weights=p) ** 2)

    for p in (jnp.zeros(9), jnp.zeros(9).at[4].set(1.0)):
        value, slope = total(p)
        assert np.isfinite(value)
        assert np.isfinite(slope).all()


@pytest.mark.slow
def test_vmapped_over_records_and_cutoffs():
    t, y, p = uneven()
    records = np.stack([y, 2 * y, y - 9])
    cutoffs = jnp.array([0.5, 1.0, 2.0])
    together = jax.jit(jax.vmap(lambda y, c: vondrak(t, y, c, weights=p)))(records, cutoffs)
    for one, record, cutoff in zip(together, records, cutoffs, strict=True):
        np.testing.assert_allclose(one, vondrak(t, record, cutoff, weights=p), atol=1e-9)


def test_the_filter_is_a_method_parameter():
    assert parameters(Vondrak()) == {"cutoff": 0.5, "frame": "inertial"}
    assert float(with_parameters(Vondrak(), {"cutoff": "0.7"}).theta) == pytest.approx(float(theta_from_cutoff(0.7)))
    with pytest.raises(UserError, match="outside its bounds"):
        with_parameters(Vondrak(), {"cutoff": 0})
