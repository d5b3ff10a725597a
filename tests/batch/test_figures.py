"""Figures that are fitted: what is believed of them, and the step of scoring against a filter with dense matrices."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxalign as ja
from jaxalign.alignment import epochs_for
from jaxalign.batch import figures, scoring, solver
from jaxalign.batch.figures import Layout
from jaxalign.batch.fit import Start, counted, usual_starts
from jaxalign.batch.fit_on_host import fit_on_host, rows_on_host
from jaxalign.batch.fit_traced import fit_traced, rows_traced
from jaxalign.batch.growth import extend, window_ends
from jaxalign.batch.iterate import begin_search
from jaxalign.batch.problem import Problem
from jaxalign.batch.smoother import propagate
from jaxalign.batch.trajectory import VELOCITY, mechanize
from jaxalign.raw_noise import FLOORS, white_densities
from jaxalign.simulate import simulate
from jaxalign.units import DEG_H, DEG_SQRT_H, UG

EPOCHS = 31
CALIBRATED = ("scale", "mounting", "slow")


def model_of(aids, calibrate):
    method = ja.RobustMap(aids=aids, calibrate=calibrate)
    return dataclasses.replace(method.model, aid_noise="held")


@pytest.mark.parametrize(("rate", "filtered"), [(100.0, False), (200.0, True)])
def test_white_noise_of_a_record(rate, filtered):
    """Motion does not count for noise; behind a low-pass filter a quarter of it is missed."""
    rng = np.random.default_rng(3)
    count, dt = 20000, 1.0 / rate
    gyro, accel = 0.3 * DEG_SQRT_H, 200.0 * UG
    t = np.arange(count)[:, None] * dt
    motion = 0.3 * np.sin(0.4 * t + np.arange(3)) * dt
    noise = rng.normal(size=(2, count, 3)) * np.sqrt(dt)
    if filtered:
        noise[:, 1:] = 0.5 * (noise[:, 1:] + noise[:, :-1])
    found = white_densities(motion + gyro * noise[0], 9.8 * motion + accel * noise[1], dt)
    share = 0.76 if filtered else 1.0
    np.testing.assert_allclose(found, [share * gyro, share * accel], rtol=0.1)
    np.testing.assert_allclose(white_densities(motion, motion, dt), FLOORS)
    assert white_densities(motion[:30], motion[:30], dt) is None


def test_belief():
    """Gradient and curvature are those of its value; the figures become those of the unit."""
    model = model_of((ja.BodyVelocity(), ja.Heading()), CALIBRATED)
    layout = Layout.of(model)
    assert layout == ((6, None), (7, 8), 9)
    stated = jnp.asarray([[0.01, 0.01], [0.02, 0.02]])
    of_rate = {"rate": jnp.full((3, 2), 1e-3), "rate_sd": jnp.full(2, 1e-4)}
    belief = figures.beliefs(model, stated, np.array([0.2 * DEG_SQRT_H, 90.0 * UG]), **of_rate)
    theta = figures.on_the_line(belief, large=False).at[7:].add(jnp.array([[0.3, -0.02], [-0.04, 0.5]]))
    value, slope, curve = figures.log_prior(belief, layout, theta)
    by_hand = jax.grad(lambda t: figures.log_prior(belief, layout, t)[0].sum())(theta)
    np.testing.assert_allclose(slope, by_hand, rtol=1e-9, atol=1e-9)
    without = dataclasses.replace(belief, rate=None)
    bent = jax.jacfwd(jax.grad(lambda t: figures.log_prior(without, layout, t)[0].sum()))(theta)
    flat = np.asarray(figures.log_prior(without, layout, theta)[2])
    for lane in range(2):
        np.testing.assert_allclose(-bent[:, lane, :, lane], flat[:, :, lane], rtol=1e-9, atol=1e-9)
        assert np.linalg.eigvalsh(np.asarray(curve)[:, :, lane]).min() > 0
    assert np.isfinite(value).all()

    model = figures.applied(model, without, theta)
    np.testing.assert_allclose(model.imu.gyro.density[0], np.exp(theta[1]) * DEG_SQRT_H)
    np.testing.assert_allclose(model.imu.gyro.bias[0], np.exp(theta[0]) * DEG_H)
    np.testing.assert_allclose(model.imu.accel.bias_walk[0], np.exp(theta[5]) * UG)
    np.testing.assert_allclose(model.sd[4:7], np.exp(np.asarray(theta)[[6, 6, 6]]))


def test_stated_figures_stay():
    model = model_of((ja.BodyVelocity(),), CALIBRATED)
    unit = ja.ImuErrors(ja.GyroErrors(3.0, 0.07), ja.AccelErrors(800.0, 60.0))
    belief = figures.beliefs(model, jnp.full((1, 1), 0.01), imu=unit)
    for large in (False, True):
        told = np.exp(figures.on_the_line(belief, large)[:4, 0])
        np.testing.assert_allclose(told, [3.0, 0.07, 800.0, 60.0])
    assert (figures.least_figures(belief, Layout.of(model))[:6] == -np.inf).all()


def test_windows_grow():
    time = np.arange(0.0, 301.0)
    ends = window_ends(time, np.ones(301, bool), 300)
    assert (ends[0], ends[-1], len(ends)) == (4, 300, 10)
    assert (np.diff(ends) > 0).all()
    late = window_ends(time, time > 50, 300)
    assert late[0] == 53  # three fixes
    assert window_ends(time, np.ones(301, bool), 5).max() == 5


@pytest.fixture(scope="module")
def searched():
    """A trajectory of a sailing vehicle by the attitude that needs no guess, two lanes with different figures."""
    log = simulate("dvl-sturn", seed=2, duration=float(EPOCHS - 1))
    model = model_of((ja.BodyVelocity(),), CALIBRATED)
    epochs = ja.epochs_from_log(log)
    belief = figures.beliefs(model, jnp.full((1, 2), float(epochs.sd[0])), epochs.raw_noise)
    theta = figures.on_the_line(belief, large=False).at[:, 1].add(jnp.array([3.0, 0.6, 0.6, 0.7, 9.0, 3.0, 0.9, 1.0]))
    rows = jax.tree.map(lambda x: x[:, None], epochs.rows)
    problem = Problem(rows, epochs.site, epochs.sd, jnp.full(2, EPOCHS - 1))
    state, _, _ = eqx.filter_jit(begin_search)(figures.applied(model, belief, theta), problem)
    state = scoring.held_noise(state, Layout.of(model), theta)
    return model, belief, theta, problem, state


def dense_innovations(linear, lane):
    """Independent innovations and their variances, component by component, with dense matrices."""
    one = jax.tree.map(lambda x: np.asarray(x)[..., [lane]], linear)
    n = len(one.prior.mean)
    x, p = one.prior.mean[:, 0], np.diag(one.prior.variance[:, 0])
    step = jax.jit(lambda interval, fade: jnp.stack([propagate(interval, fade, e[:, None])[:, 0] for e in jnp.eye(n)]))
    out = []
    for k in range(len(one.gap)):
        interval, process = (jax.tree.map(lambda a, k=k: a[k], tree) for tree in (one.intervals, one.process))
        f = np.asarray(step(interval, process.fade)).T
        q = np.zeros((n, n))
        q[:6, :6] = process.motion[..., 0]
        q[6:, 6:] = np.diag(process.others[:, 0])
        x, p = f @ x, f @ p @ f.T + q
        x[:12] += interval.defect[:, 0]
        for gap, h, r in zip(one.gap[k, :, 0], one.slope[k, :, :, 0], one.variance[k, :, 0], strict=True):
            s, e = h @ p @ h + r, gap - h @ x
            gain = p @ h / s
            x, p = x + gain * e, p - np.outer(gain, h @ p)
            out.append((e, s))
    return np.array(out).T


def test_scoring_against_differences(searched):
    """Gradient and expected curvature by innovations and variances at figures a little off, at two step sizes."""
    model, belief, theta, problem, state = searched
    layout = Layout.of(model)

    @jax.jit
    def linear_of(theta):
        own = scoring.held_noise(state, layout, theta)
        return solver.linearize_problem(figures.applied(model, belief, theta), problem, own)

    linear = linear_of(theta)
    slopes = scoring.noise_slopes(model, belief, problem, state, linear, layout, theta)
    found = jax.jit(scoring.score_of_innovations)(linear, slopes)
    free = linear.prior.variance[VELOCITY]

    def innovations(j, step, lane):
        moved = linear_of(theta.at[j].add(step))
        held = dataclasses.replace(
            linear,
            process=moved.process,
            variance=moved.variance,
            prior=dataclasses.replace(moved.prior, variance=moved.prior.variance.at[VELOCITY].set(free)),
        )
        return dense_innovations(held, lane)

    e, s = dense_innovations(linear, 1)
    for step in (1e-3, 3e-4):
        de, ds = [], []
        for j in range(layout.size):
            up, down = innovations(j, step, 1), innovations(j, -step, 1)
            de.append((up[0] - down[0]) / (2 * step))
            ds.append((up[1] - down[1]) / (2 * step))
        de, ds = np.array(de), np.array(ds)
        slope = (-e * de / s + 0.5 * (e**2 / s - 1) * ds / s).sum(axis=1)
        curve = (de / s) @ de.T + 0.5 * (ds / s**2) @ ds.T
        scale = np.sqrt(np.diag(curve))
        np.testing.assert_allclose(found.slope[:, 1] / scale, slope / scale, rtol=1e-3, atol=1e-3)
        both = np.outer(scale, scale)
        np.testing.assert_allclose(found.curve[:, :, 1] / both, curve / both, atol=1e-3)


def test_a_trajectory_goes_on_from_its_window(searched):
    """Beyond the window it has no defects; within it it stays."""
    _, _, _, problem, state = searched
    after = jnp.array([4, 10])
    longer = jax.jit(extend)(problem, state, after)
    intervals = jax.jit(mechanize)(problem.rows, problem.site, longer.at, longer.q_n0n, problem.on)
    beyond = np.arange(EPOCHS)[:, None] > np.asarray(after)
    defect = np.abs(np.asarray(intervals.defect)).max(axis=1)
    assert defect[beyond].max() < 1e-7  # m/s: the turn of n by the velocity half way
    assert defect[~beyond].max() < 1e-2
    for a, b in zip(jax.tree.leaves(longer.at), jax.tree.leaves(state.at), strict=True):
        np.testing.assert_array_equal(np.asarray(a)[~beyond], np.asarray(b)[~beyond])
    assert (np.asarray(longer.noise[0].weight)[beyond] == 1.0).all()


def test_starts():
    body, nav = usual_starts((ja.BodyVelocity(),)), usual_starts((ja.NavVelocity(),))
    assert len(body) == len(nav) == 8
    assert {one.slow for one in body} == {1.0}
    assert {one.slow for one in nav} == {1.0, 30.0}
    assert all(len(set(some)) == 8 for some in (body, nav))
    assert Start(False, 0.0) in body


def test_what_counts():
    """Within belief first; if nothing is, all that is finite."""
    level = jnp.array([[1.0, 3.0, jnp.nan], [1.0, 3.0, 2.0]])
    found = counted(level, jnp.array([[True, False, True], [False, False, False]]))
    np.testing.assert_array_equal(found, [[1.0, -np.inf, -np.inf], [1.0, 3.0, 2.0]])


@pytest.fixture(scope="module")
def fitted():
    """A log aligned with figures that are fitted, on the host."""
    log = simulate("dvl-sturn", seed=5, duration=200.0)
    method = ja.RobustMap(aids=(ja.BodyVelocity(),), calibrate=CALIBRATED)
    epochs, model = epochs_for(method, log), model_of(method.aids, CALIBRATED)
    starts, numbers = usual_starts(method.aids), np.array([60, 150, 200])
    fit = fit_on_host(model, epochs, starts)
    return log, model, epochs, starts, numbers, fit, rows_on_host(model, fit, numbers)


@pytest.mark.slow
def test_a_fit_without_grades(fitted):
    """Most starts lead to one solution, whose errors are within what is stated, late and early."""
    log, model, _, _, numbers, fit, found = fitted
    assert (np.abs(fit.level - fit.level[fit.best]) < 10.0).sum() >= 4
    phi = ja.rotation.attitude_error(jnp.asarray(found.read.q_nb.T), ja.rotation.quat_from_dcm(log.C_nb[numbers]))
    sd = np.sqrt(np.stack([found.read.tilt[i, i] for i in range(3)], axis=-1))
    print(np.rad2deg(phi), np.rad2deg(sd), np.exp(np.asarray(fit.fitted.theta)[:, fit.best]))
    assert (np.abs(phi) < 4.0 * sd).all()
    assert np.rad2deg(sd[-1, 2]) < 1.5
    assert (np.asarray(fit.fitted.theta) >= np.asarray(figures.least_figures(fit.belief, Layout.of(model)))).all()


@pytest.mark.slow
def test_a_fit_inside_traced_code(fitted):
    """The same as on the host, but for what further steps would change."""
    _, model, epochs, starts, numbers, fit, found = fitted

    @eqx.filter_jit
    def traced(model, epochs):
        whole = fit_traced(model, epochs, starts)
        return whole, rows_traced(model, epochs, whole, numbers, 12)

    whole, rows = traced(model, epochs)
    np.testing.assert_allclose(whole.level, fit.level, atol=0.01)
    np.testing.assert_allclose(whole.fitted.theta[:, whole.best], fit.fitted.theta[:, fit.best], atol=1e-3)
    sd = np.sqrt(found.read.tilt[2, 2])
    phi = ja.rotation.attitude_error(rows.read.q_nb.T, jnp.asarray(found.read.q_nb.T))
    np.testing.assert_array_less(np.abs(phi).max(axis=1), 0.01 * sd)
    np.testing.assert_allclose(np.sqrt(rows.read.tilt[2, 2]), sd, rtol=0.01)
