"""The algebra of the batch estimator: the recursion against a dense solution, its model against mechanization."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxalign import Quat, Vec3, epochs_from_log, rotation
from jaxalign.aids import BodyVelocity, NavVelocity
from jaxalign.batch import measurement, smoother, solver, trajectory
from jaxalign.batch.problem import AidNoise, Model, Problem, State
from jaxalign.batch.reweight import lower_median, steady_velocities
from jaxalign.batch.smoother import Prior, propagate, propagate_transposed
from jaxalign.batch.solve import solve_linear
from jaxalign.batch.trajectory import ACCEL, GYRO, STATES, TILT, VELOCITY, NominalTrajectory
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors
from jaxalign.simulate import simulate
from jaxalign.units import DEG_H, UG

EPOCHS = 13
ALL = ("scale", "mounting", "latency", "lever", "slow")
SIZES = {name: unknown.size for name, unknown in BodyVelocity().known_unknowns.items()}
UNIT = ImuErrors(
    GyroErrors([10.0, 20.0, 5.0], [2.0, 1.0, 4.0], bias_walk_deg_h_sqrt_h=[400.0, 100.0, 0.0]),
    AccelErrors(500.0, 3000.0, bias_walk_ug_sqrt_h=200.0),
)
# One program instead of one for each of their operations.
filter_forward, linearize_problem, mechanize, linearize = (
    eqx.filter_jit(f)
    for f in (smoother.filter_forward, solver.linearize_problem, trajectory.mechanize, measurement.linearize)
)


@pytest.fixture(scope="module")
def short():
    """Twelve epochs of a swaying vessel, and a trajectory with defects a little off the true one; two lanes."""
    log = simulate("dvl-sway", seed=3, noise=False, duration=12.0)
    epochs = epochs_from_log(log)
    rng = np.random.default_rng(1)

    def lanes(size):
        return Vec3(*(jnp.asarray(size * rng.normal(size=(EPOCHS, 2))) for _ in range(3)))

    turn = np.linspace(0, 12 * 7.292115e-5 * np.cos(log.lat), EPOCHS)[:, None]
    q_n0n = Quat.exp(Vec3(0.0 * turn, turn, np.tan(log.lat) * turn))
    q_nb = jax.tree.map(lambda x: x[:, None], Quat.of(rotation.quat_from_dcm(log.C_nb)))
    q_n0n = jax.tree.map(lambda x: jnp.broadcast_to(x, (EPOCHS, 2)), q_n0n)
    attitude = (Quat.exp(lanes(1e-4)) * q_n0n * q_nb).unit()
    velocity = jax.tree.map(lambda x: x[:, None], Vec3.of(log.aids[0].value))
    velocity = attitude.rotate(velocity) + lanes(0.02)
    at = NominalTrajectory(attitude, velocity, lanes(1e-5), lanes(1e-3))
    return epochs, at, q_n0n, jax.tree.map(lambda x: x[:, None], epochs.rows)


@pytest.fixture(scope="module")
def problem(short):
    """Of each set of unknowns once."""
    return functools.cache(lambda unknown=(): made(short, unknown))


def made(short, unknown):
    """With the second lane ending three epochs earlier, a fix missing, and axes of their own."""
    epochs, at, q_n0n, rows = short
    sizes = [SIZES[name] for name in unknown]
    sd = jnp.linspace(0.01, 0.3, sum(sizes))
    fade = jnp.asarray([20.0 if name == "slow" else jnp.inf for name in unknown for _ in range(SIZES[name])])
    imu = UNIT
    model = Model(
        imu, jnp.asarray(0.05), jnp.asarray(30.0), sd, fade, jnp.asarray(1e-5), (unknown,), "stated", epochs.aids
    )
    rows = rows.with_velocity(rows.velocity, rows.valid.at[4].set(False))
    some = Problem(rows, epochs.site, (jnp.asarray(0.1),), jnp.asarray([EPOCHS - 1, EPOCHS - 4]))
    weight = jnp.linspace(0.05, 1.0, 2 * EPOCHS).reshape(EPOCHS, 2)
    unknowns = 0.01 * jnp.arange(1.0, 1 + 2 * sum(sizes)).reshape(-1, 2)
    yes = jnp.ones(2, bool)
    noise = (AidNoise(weight, jnp.asarray([0.01, 0.02]), jnp.ones(2)),)
    state = State(at, q_n0n, unknowns, noise, None, yes, yes)
    linear = linearize_problem(model, some, state)
    variance = linear.prior.variance.at[3:6].set(1.0)
    return dataclasses.replace(linear, prior=Prior(linear.prior.mean, variance))


@jax.jit
@jax.vmap
def transitions(row, fade):
    """The matrix that each interval multiplies the errors with: one lane is a column."""
    return propagate(row, fade, jnp.eye(STATES + len(fade)))


def dense(linear, lane):
    """All unknowns in one normal matrix: the start, and the noise of each interval and state.

    Returns:
        Their solution and covariance, the whole history (K, n, unknowns) with its inputs (K, n), and the density of
        the measurements but for a constant.
    """
    take = jax.tree.map(lambda x: np.asarray(x)[..., lane : lane + 1] if x.shape[-1] > 1 else np.asarray(x), linear)
    n = len(take.prior.mean)
    count = len(take.gap)
    size = n * count
    whole, inputs = np.zeros((n, size)), np.zeros((n, 1))
    whole[:, :n] = np.eye(n)
    covariance = np.zeros((size, size))
    covariance[:n, :n] = np.diag(take.prior.variance[:, 0])
    mean = np.zeros(size)
    mean[:n] = take.prior.mean[:, 0]
    transition = np.asarray(transitions(take.intervals, take.process.fade))
    history, h, y, r = [], [], [], []
    for k in range(count):
        if k:
            whole, inputs = transition[k] @ whole, transition[k] @ inputs
            inputs[:STATES] += take.intervals.defect[k]
            here = slice(n * k, n * (k + 1))
            whole[:, here] += np.eye(n)
            noise = np.diag(np.concatenate([np.zeros(6), take.process.others[k, :, 0]]))
            noise[:6, :6] += take.process.motion[k, :, :, 0]
            covariance[here, here] = noise
        history.append((whole.copy(), inputs[:, 0].copy()))
        if take.used[k, 0, 0]:
            slope = take.slope[k, :, :, 0]
            h.append(slope @ whole)
            y.append(take.gap[k, :, 0] - slope @ inputs[:, 0])
            r.append(take.variance[k, :, 0])
    h, y, r = np.concatenate(h), np.concatenate(y), np.concatenate(r)
    spread = h @ covariance @ h.T + np.diag(r)
    off = y - h @ mean
    gain = np.linalg.solve(spread, h @ covariance).T
    density = -0.5 * (off @ np.linalg.solve(spread, off) + np.linalg.slogdet(spread)[1])
    return mean + gain @ off, covariance - gain @ h @ covariance, history, density


def test_figures_of_the_axes(short, problem):
    """Prior and process noise against white noise that is added up in a thousand parts of an interval."""
    linear = problem()
    intervals, process = jax.tree.map(np.asarray, (linear.intervals, linear.process))
    for part, sd in ((GYRO, np.array([10.0, 20.0, 5.0]) * DEG_H), (ACCEL, 500.0 * UG)):
        expected = np.broadcast_to(np.reshape(sd, (-1, 1)) ** 2, (3, 2))
        np.testing.assert_allclose(linear.prior.variance[part], expected, rtol=1e-9)
    parts, walk = 1000, np.deg2rad([2.0, 1.0, 4.0]) / 60
    for k, lane in ((3, 0), (7, 1), (11, 1)):
        dt = intervals.dt[k, lane]
        assert dt == (0.0 if lane and k > EPOCHS - 4 else 1.0)
        step = np.array([400.0, 100.0, 0.0]) * DEG_H / 60, np.full(3, 200.0) * UG / 60
        np.testing.assert_allclose(process.others[k, :, lane], np.concatenate(step) ** 2 * dt, rtol=1e-12)
        if dt == 0:
            np.testing.assert_array_equal(process.motion[k, ..., lane], 0.0)
            continue
        c, force = intervals.turned[k, :, :, lane] / dt, intervals.gained[k, :, lane] / dt
        cross = np.array([[0, -force[2], force[1]], [force[2], 0, -force[0]], [-force[1], force[0], 0]])
        h = dt / parts
        pass_on = np.eye(6)
        pass_on[3:, :3] = -cross * h
        noise = np.zeros((6, 6))
        noise[:3, :3] = c @ np.diag(walk**2) @ c.T * h
        noise[3:, 3:] = (3000.0 * UG) ** 2 * h * np.eye(3)
        total = np.zeros((6, 6))
        for _ in range(parts):
            total = pass_on @ total @ pass_on.T + noise
        scale = np.sqrt(np.diag(total))
        np.testing.assert_allclose((process.motion[k, ..., lane] - total) / np.outer(scale, scale), 0.0, atol=3e-3)


@pytest.mark.parametrize("unknown", [pytest.param((), marks=pytest.mark.slow), ALL])
def test_smoother_is_the_dense_solution(problem, unknown):
    linear = problem(unknown)
    found = filter_forward(linear)
    _, error, noise = jax.jit(solve_linear)(linear)
    used, gap, slope = (np.asarray(x) for x in (linear.used, linear.gap, linear.slope))
    for lane in range(2):
        solution, covariance, history, density = dense(linear, lane)
        whole, inputs = history[-1]
        np.testing.assert_allclose(found.mean[:, lane], whole @ solution + inputs, rtol=1e-6, atol=1e-9)
        last = whole @ covariance @ whole.T
        np.testing.assert_allclose(found.covariance[..., lane], last, atol=1e-6 * np.abs(last).max())
        np.testing.assert_allclose(found.log_likelihood[lane], density, rtol=1e-8)
        for k, (whole, inputs) in enumerate(history):
            x = whole @ solution + inputs
            np.testing.assert_allclose(error[k, :, lane], x, rtol=1e-6, atol=1e-9)
            if used[k, 0, lane]:
                expected = gap[k, :, lane] - slope[k, :, :, lane] @ x
                np.testing.assert_allclose(noise[k, :, lane], expected, rtol=1e-6, atol=1e-9)


def test_all_epochs_are_kept_where_that_is_wished(problem):
    linear = problem()
    kept, last = filter_forward(linear, keep=True), filter_forward(linear)
    np.testing.assert_allclose(kept.mean[-1], last.mean, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(kept.covariance[-1], last.covariance, rtol=1e-9, atol=1e-18)
    assert kept.covariance.shape == (EPOCHS, STATES, STATES, 2)


@pytest.mark.slow
def test_the_transpose(problem):
    linear = problem(ALL)
    row, fade = jax.tree.map(lambda x: x[5], (linear.intervals, linear.process.fade))
    x, r = np.random.default_rng(0).normal(size=(2, STATES + 11, 2))
    there, back = jax.jit(lambda *of: (propagate(*of, x), propagate_transposed(*of, r)))(row, fade)
    np.testing.assert_allclose(np.sum(r * there, axis=0), np.sum(x * back, axis=0), rtol=1e-12)


@jax.jit
def propagated(intervals, error):
    """Errors after the intervals (the first has none) from those before them, (K - 1, n, L)."""
    rows = jax.tree.map(lambda x: x[1:], intervals)
    return jax.vmap(lambda row, x: propagate(row, jnp.zeros((0, 1)), x))(rows, error)


moved_by = jax.jit(NominalTrajectory.moved)


@pytest.mark.parametrize(("kind", "size"), [(0, 1e-6), (1, 1e-5), (2, 1e-8), (3, 1e-6)])
def test_errors_pass_on_as_mechanization_has_them(short, kind, size):
    """Move the states before the intervals by little: the defects change as the model says, to 1 % of the largest."""
    epochs, at, q_n0n, rows = short
    on = jnp.ones((EPOCHS, 2), bool)
    base = mechanize(rows, epochs.site, at, q_n0n, on)
    changes, said = [], []
    for axis in range(3):
        error = np.zeros((EPOCHS, STATES, 2))
        error[::2, 3 * kind + axis] = size
        moved = mechanize(rows, epochs.site, moved_by(at, error), q_n0n, on)
        changes.append((np.asarray(moved.defect) - base.defect)[1:])
        said.append(np.asarray(propagated(base, error[:-1])) - error[1:])
    changes, said = np.array(changes), np.array(said)
    for part in (TILT, VELOCITY, GYRO, ACCEL):
        most = np.abs(said[:, :, part]).max()
        np.testing.assert_allclose(changes[:, :, part], said[:, :, part], rtol=0, atol=1e-2 * most + 1e-12)


def test_turned_about_the_vertical_nothing_but_the_heading_changes(short, problem):
    """Velocities and attitudes turned together: a body aid sees no change, the defects keep their size, to first order.

    That is what keeps noise from telling a heading: the change of the errors is an exact solution of the linear
    problem but for the Earth's rotation.
    """
    linear = problem()
    _, at, _, _ = short
    v = np.stack([at.velocity.x, at.velocity.y, at.velocity.z], axis=1)
    error = np.zeros((EPOCHS, STATES, 2))
    error[:, 2], error[:, 3], error[:, 4] = 1.0, -v[:, 1], v[:, 0]
    still = dataclasses.replace(linear.intervals, spin=0.0 * linear.intervals.spin)
    there = np.array(propagated(still, error[:-1]))
    fallen = v[1:] - v[:-1] - np.asarray(still.gained)[1:]  # gravity and Coriolis' term, which do not turn
    there[:, 3] -= fallen[:, 1]
    there[:, 4] += fallen[:, 0]
    np.testing.assert_allclose(there, error[1:], atol=1e-9)
    seen = np.einsum("kmnl,knl->kml", linear.slope, error)
    np.testing.assert_allclose(seen, 0.0, atol=1e-9)


@pytest.mark.parametrize("unknown", ["latency", "lever", "slow"])
def test_slopes_of_the_aids_unknowns(short, unknown):
    """The gap changes as the slope says, exactly: all are linear."""
    epochs, at, q_n0n, rows = short
    intervals = mechanize(rows, epochs.site, at, q_n0n, jnp.ones((EPOCHS, 2), bool))
    value = np.arange(1.0, 1.0 + SIZES[unknown])[:, None] / 3 * np.ones(2)

    def gap(x):
        on, aids = jnp.ones((EPOCHS, 2), bool), (NavVelocity(),)
        return linearize(aids, ((unknown,),), rows.fixes, at, intervals.q_n0n, intervals.dt, on, x * value)

    zero, there = gap(0.0), gap(1.0)
    slope = np.einsum("kmcl,cl->kml", np.asarray(zero.slope)[:, :, STATES:], value)
    if unknown == "slow":  # it is no part of the trajectory
        np.testing.assert_allclose(np.linalg.norm(slope, axis=1), np.linalg.norm(value[:, 0]), rtol=1e-12)
    else:
        np.testing.assert_allclose(np.asarray(zero.gap) - there.gap, slope, atol=1e-13)
    assert np.abs(slope).max() > 1e-4


def test_a_bias_that_is_not_known_leaves_its_prior(problem):
    """Nothing used: the filter hands on what it was given."""
    linear = problem()
    nothing = dataclasses.replace(linear, slope=0.0 * linear.slope, gap=0.0 * linear.gap)
    found = filter_forward(nothing)
    defects = np.sum(linear.intervals.defect, axis=0)
    np.testing.assert_allclose(found.mean[GYRO], linear.prior.mean[GYRO] + defects[GYRO])
    assert (np.asarray(found.gain) == 0).all()


def test_settled_velocities_and_their_derivatives():
    """Changes within three times their variance are noise; a single fix has none."""
    x = jnp.asarray([[1.0], [5.0], [3.01], [3.0]])
    velocity, left = Vec3(x, 0.0 * x, 0.0 * x), jnp.full((4, 1), 0.25)
    used = jnp.asarray([[True], [True], [False], [False]])
    found = steady_velocities(velocity, left, jnp.ones((4, 1)), used).x
    np.testing.assert_allclose(found[:, 0], [3 - np.sqrt(4 - 0.75), 3 + np.sqrt(4 - 0.75), 3, 3], atol=1e-12)
    alone = used & (jnp.arange(4) == 0)[:, None]
    slope = jax.grad(lambda v: jnp.sum(steady_velocities(Vec3(v, 0 * v, 0 * v), left, jnp.ones((4, 1)), alone).x))(x)
    assert np.isfinite(slope).all()


def test_median():
    rng = np.random.default_rng(0)
    x, used = rng.random((101, 4)) ** 3, rng.random((101, 4)) < 0.5
    used[:, 3] = False
    found = jax.jit(lower_median)(x, used)
    for lane in range(3):
        ordered = np.sort(x[used[:, lane], lane])
        np.testing.assert_allclose(found[lane], ordered[(len(ordered) - 1) // 2], rtol=1e-7)
    assert found[3] == 0


@pytest.mark.slow
@pytest.mark.parametrize("unknown", [(), ALL])
def test_derivatives_of_the_solution_are_those_through_the_filter(problem, unknown):
    """Every number of the system moved at once: the response against differentiating filter and smoother."""
    linear = problem(unknown)
    rng = np.random.default_rng(2)

    def some(x):
        if x.dtype == bool:
            return np.zeros(x.shape, jax.dtypes.float0)
        return 0.1 * np.abs(np.asarray(x)) * rng.normal(size=x.shape)

    moved = jax.tree.map(some, linear)
    motion = moved.process.motion + np.swapaxes(moved.process.motion, 1, 2)
    moved = dataclasses.replace(moved, process=dataclasses.replace(moved.process, motion=motion))

    def plain(linear):
        at = smoother.smooth_backward(linear, smoother.filter_forward(linear))
        return at.error, linear.variance * at.pull

    said, through = jax.jit(lambda a, b: [jax.jvp(f, (a,), (b,))[1] for f in (lambda x: solve_linear(x)[1:], plain)])(
        linear, moved
    )
    for ours, theirs in zip(said, through, strict=True):
        ours, theirs = np.asarray(ours), np.asarray(theirs)
        scale = np.abs(theirs).max(axis=(0, 2), keepdims=True)
        np.testing.assert_allclose(ours / scale, theirs / scale, atol=1e-7)
