"""The slots one by one: against closed forms, at their corners, and what they refuse."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from logs import with_velocity
from numeric import assert_derivatives
from problems import epochs_of, method_of, solver

from jaxalign import (
    AbstractWeight,
    Aligner,
    ApparentVelocityFilter,
    BodyVelocityVectors,
    Context,
    GravityVectors,
    Identity,
    KMatrixFilter,
    NavVelocityVectors,
    OptimalRequest,
    Pair,
    QMethod,
    Quat,
    QuaternionFilter,
    Rls,
    Status,
    UserError,
    Vec3,
    align,
    with_parameters,
)
from jaxalign.earth import EARTH_RATE
from jaxalign.methods import build
from jaxalign.metrics import attitude_error_deg
from jaxalign.simulate import simulate

PUBLISHED_PRIOR = 1e10


def context(time, dt=1.0, sd=0.1):
    whole = jnp.asarray(0, jnp.int32)
    return Context(whole, *(jnp.asarray(x) for x in (time, dt)), Quat.identity(), jnp.array(True), jnp.asarray(sd))


def pair(beta, alpha=(0.0, 0.0, 9.8)):
    a, b = (Vec3(*(jnp.asarray(x) for x in v)) for v in (alpha, beta))
    return Pair(a, b, jnp.array(True), a, b, None, Vec3.zero())


def ridge(basis, beta, noise, prior):
    """Least squares with a prior on the coefficients, as one augmented system (QR inside lstsq)."""
    scale = np.sqrt(noise)
    rows = np.vstack([basis / scale, np.diag(1 / np.sqrt(prior))])
    values = np.vstack([beta / scale, np.zeros((basis.shape[1], beta.shape[1]))])
    return np.linalg.lstsq(rows, values, rcond=None)[0]


def run(slot, times, betas, sd=0.1):
    def step(state, row):
        time, beta = row
        state, out = slot.step(state, context(time, sd=sd), pair((beta[0], beta[1], beta[2])))
        return state, out.beta.array

    return jax.jit(lambda t, b: jax.lax.scan(step, slot.init(), (t, b)))(times, betas)[1]


def test_rls_is_least_squares_with_the_published_prior():
    """A wide prior as well as a narrow one, in the basis in which it was published."""
    rng = np.random.default_rng(1)
    times = np.arange(1.0, 121.0)
    w, t = EARTH_RATE, times - 0.5
    basis = np.stack([np.cos(w * t), np.sin(w * t), np.ones_like(t)], axis=1)
    beta = basis @ rng.normal(size=(3, 3)) + rng.normal(size=(120, 3)) * 1e-3
    for prior, tolerance in ((1e4, 1e-9), (1e8, 1e-7)):
        ours = run(Rls(prior_variance=prior), times, beta)
        exact = basis[-1] @ ridge(basis, beta, 1.0, np.full(3, prior))
        np.testing.assert_allclose(ours[-1], exact, atol=tolerance)


def test_apparent_velocity_filter_is_least_squares_where_nothing_is_outlying():
    rng = np.random.default_rng(2)
    t = np.arange(1.0, 201.0)
    w = EARTH_RATE
    basis = np.stack([np.cos(w * t), np.sin(w * t), t, np.ones_like(t)], axis=1)
    beta = np.stack([9.8 * np.cos(0.3 * i) * np.sin(w * t) / w for i in range(3)], axis=1) + rng.normal(size=(200, 3))
    ours = run(ApparentVelocityFilter(threshold=100.0, process_variance=0.0, prior_variance=1e8), t, beta, sd=10.0)
    exact = basis[-1] @ ridge(basis, beta, 100.0, np.full(4, 1e8))
    np.testing.assert_allclose(ours[-1], exact, atol=1e-5)


def test_dropped_constant_goes_through_zero_at_the_start():
    t = np.arange(1.0, 101.0)
    beta = np.stack([9.8 * t + 0.7, 0 * t - 0.4, 0 * t], axis=1)
    kept, dropped = (run(ApparentVelocityFilter(drop_constant=d, threshold=100.0), t, beta, 1.0) for d in (False, True))
    np.testing.assert_allclose(kept[-1] - dropped[-1], [0.7, -0.4, 0.0], atol=0.05)


@pytest.mark.parametrize("name", ["rkf_oba", "roba"])
def test_derivatives_of_robust_weights_away_from_their_corners(name):
    """One measurement, in the quadratic and in the linear part."""
    method = build(name, "body")

    def last(x):
        there = context(20.0)
        if name == "roba":
            return method.weight.step(None, there, pair((x[0], x[1], x[2]), (0.3, 0.1, 9.8)))[1]
        slot = with_parameters(method, {"reconstruct.prior_variance": 1e6}).reconstruct
        state = slot.init()
        for time, scale in ((18.0, 1.0), (19.0, 1.01), (20.0, 1.02)):
            state, out = slot.step(state, context(time), pair((scale * x[0], scale * x[1], x[2])))
        return out.beta.array

    assert_derivatives(last, [[0.31, 0.12, 9.81], [3.0, -1.0, 9.0], [0.2, 0.1, 60.0]], steps=(1e-3, 2e-4), third=1e3)


@pytest.mark.slow
def test_optimal_request_is_the_q_method():
    """Constant R: on unit vectors. Physical R: on the vectors as they are, if beta has the length of alpha."""
    epochs = epochs_of("nav", noise=False)
    oba = solver()(method_of("oba", "nav"), epochs)
    unit = solver()(build("oba", "nav", {"estimate.normalise": True}), epochs)
    physical = solver()(method_of("optimal_request", "nav"), epochs)
    constant = solver()(build("optimal_request", "nav", {"estimate.measurement_noise": "constant"}), epochs)
    np.testing.assert_allclose(constant.q_nb[10:], unit.q_nb[10:], atol=1e-9)
    np.testing.assert_allclose(physical.q_nb[10:], oba.q_nb[10:], atol=1e-7)
    forgetting = build("optimal_request", "nav", {"estimate.process_variance": 1e-3})
    noisy = epochs_of("nav")
    assert not np.allclose(
        solver()(forgetting, noisy).q_nb[-1], solver()(method_of("optimal_request", "nav"), noisy).q_nb[-1], atol=1e-4
    )


@pytest.mark.parametrize("aid", ["nav", pytest.param("body", marks=pytest.mark.slow)])
def test_printed_vo_tvk_is_singular_and_says_so(aid):
    found = solver()(build("vo_tvk_as_published", aid), epochs_of(aid))
    singular = (np.asarray(found.status) & Status.SINGULAR) != 0
    assert not singular[:2].any()
    assert singular[5:].all()
    for leaf in jax.tree.leaves(found):
        assert np.isfinite(np.asarray(leaf, float)).all()
    regular = solver()(method_of("vo_tvk", aid), epochs_of(aid))
    assert not (np.asarray(regular.status) & Status.SINGULAR).any()


@pytest.mark.slow
@pytest.mark.parametrize("aid", ["nav", "body"])
def test_slope_of_the_singular_vo_tvk_is_finite(aid):
    def end(kappa):
        method = with_parameters(method_of("vo_tvk", aid), {"estimate.kappa": kappa})
        return method.solve(epochs_of(aid), 1).q_nb[-1, 3]

    assert np.isfinite(jax.jit(jax.grad(end))(0.0))


@pytest.mark.slow
def test_vo_tvk_depends_on_the_mounting():
    """As its docstring says; the q-method does not."""
    log = simulate("gps-zigzag", 1)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    turned = dataclasses.replace(log, dtheta=log.dtheta @ turn.T, dvel=log.dvel @ turn.T, C_nb=log.C_nb @ turn.T)
    change = {}
    for name in ("oba", "vo_tvk"):
        here, there = (attitude_error_deg(align(build(name, "nav"), x, every=10), x)[-1, 2] for x in (log, turned))
        change[name] = abs(here - there)
    assert change["oba"] < 1e-8
    assert change["vo_tvk"] > 1.0


@pytest.mark.slow
def test_quaternion_filter_averages():
    """Ten epochs to a measurement: between them the attitude in inertial space does not move."""
    epochs = epochs_of("static")
    interval = float(epochs.rows.dt[1])
    each, every_third = (build("quaternion_kf", "static", {"estimate.averaging": a * interval}) for a in (0.0, 3.0))

    def inertial(method):
        state, out = method.init(epochs.site, epochs.aid_sd), []
        step = jax.jit(lambda s, e: method.step(s, e))
        for k in range(13):
            state, _ = step(state, jax.tree.map(lambda x, k=k: x[k], epochs.rows))
            out.append(np.asarray(state.readout.attitude.array))
        return np.array(out)

    moved = np.abs(np.diff(inertial(every_third), axis=0)).max(axis=1) > 0
    np.testing.assert_array_equal(np.flatnonzero(moved) + 1, [6, 9, 12])  # the first two make the start
    assert (np.abs(np.diff(inertial(each), axis=0)).max(axis=1) > 0)[2:].all()


def test_quaternion_filter_starts_where_it_is_told():
    epochs = epochs_of("static", noise=False)
    truth = solver()(method_of("gravity_q", "static"), epochs).q_nb[-1]
    free = solver()(method_of("quaternion_kf", "static"), epochs)
    assert not free.defined[1]
    told = solver()(build("quaternion_kf", "static", {"estimate.start": [0.9, 0.1, 0.1, 0.3]}), epochs)
    assert told.defined[1]
    np.testing.assert_allclose(free.q_nb[-1], truth, atol=1e-6)
    assert np.abs(told.q_nb[-1] - truth).max() < 0.05


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Aligner(BodyVelocityVectors(), Rls(), estimate=QMethod()), "instantaneous"),
        (lambda: Aligner(GravityVectors(), Rls(), estimate=QMethod()), "instantaneous"),
        (lambda: Aligner(NavVelocityVectors(), ApparentVelocityFilter(), estimate=QMethod()), "navigation-frame"),
        (lambda: Aligner(BodyVelocityVectors(window=60.0), ApparentVelocityFilter(), estimate=QMethod()), "window"),
        (
            lambda: Aligner(GravityVectors(vectors="instantaneous"), ApparentVelocityFilter(), estimate=QMethod()),
            "integrated since the start",
        ),
        (lambda: build("rkf_oba", "nav"), "only body, static"),
        (lambda: build("rkf_oba", "body", {"observe.window": 60}), "window"),
        (lambda: build("rls_q", "static", {"observe.vectors": "integrated"}), "instantaneous"),
        (lambda: OptimalRequest(measurement_noise="big"), "estimate.measurement_noise"),
        (lambda: KMatrixFilter(measurement_noise="big"), "estimate.measurement_noise"),
        (lambda: QuaternionFilter(measurement_noise="half"), "estimate.measurement_noise"),
        (lambda: QuaternionFilter(averaging=-1.0), "estimate.averaging"),
        (lambda: QuaternionFilter(start=(1.0, 0.0)), "estimate.start"),
        (lambda: build("quaternion_kf", "static", {"estimate.start": "[1e999, 0, 0, 0]"}), "estimate.start"),
        (lambda: Aligner(GravityVectors(), estimate=OptimalRequest()), "constant"),
        (lambda: Aligner(GravityVectors(), estimate=KMatrixFilter()), "constant"),
        (lambda: align(build("rkf_oba", "body"), epochs_of("body"), aid_sd=0.0), "above 0"),
        (lambda: build("request", "nav", {"estimate.rho": 2.0}), "bounds"),
    ],
)
def test_what_makes_no_sense_is_refused(make, word):
    with pytest.raises(UserError, match=word):
        make()


@pytest.mark.slow
def test_dropped_constant_is_that_of_the_first_velocity():
    """However late it comes."""
    log = simulate("dvl-sturn", 1, noise=False)
    log = with_velocity(log, np.where(np.arange(301)[:, None] < 60, np.nan, log.aids[0].value))
    parameters = {"reconstruct.drop_constant": True, "reconstruct.process_variance": 1e-8}
    solution = align(build("rkf_oba", "body", parameters), log, every=10, aid_sd=0.1)
    assert np.abs(attitude_error_deg(solution, log)[-1]).max() < 0.02


def test_forgetting_does_not_wind_up():
    """Far beyond its memory the covariance stays within the prior."""
    rng = np.random.default_rng(4)
    times = np.arange(1, 60001) * 0.01
    beta = np.array([0.1, 0.2, 9.8]) + rng.normal(size=(60000, 3)) * 0.01
    for forgetting in (0.9, 0.99, 0.9999):
        found = run(Rls(forgetting=forgetting), times, beta)
        assert np.isfinite(found).all()
        assert np.abs(np.asarray(found[1000:]) - [0.1, 0.2, 9.8]).max() < 0.1


def test_a_weight_counts_wherever_it_falls_in_an_average():
    epochs = epochs_of("static")
    averaging = 3.0 * float(epochs.rows.dt[1])

    class Tiny(AbstractWeight):
        weight: float

        def init(self):
            return None

        def step(self, state, context, pair):
            return state, jnp.where(context.index % 3 == 1, self.weight, 1.0)

    spoilt = eqx.tree_at(lambda e: e.rows.dvel.x, epochs, epochs.rows.dvel.x.at[1::3].add(1.0))
    ends = [
        Aligner(
            GravityVectors(vectors="instantaneous"),
            weight=Tiny(jnp.asarray(w)),
            estimate=QuaternionFilter(averaging=averaging),
        )
        .solve(spoilt, 10**6)
        .euler_deg[-1, :2]
        for w in (0.0, 1e-6, 1.0)
    ]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-3)
    assert np.abs(ends[2] - ends[0]).max() > 0.1


def test_reconstructed_pairs_carry_no_moment():
    """The estimator must not correct a fitted vector for its Coriolis term a second time."""
    method = method_of("rkf_oba", "body")
    assert method.observe.coupled
    state = method.init(epochs_of("body").site)
    assert state.pair.displacement is None
    plain = dataclasses.replace(method, reconstruct=Identity())
    assert plain.init(epochs_of("body").site).pair.displacement is not None


def test_status_of_a_singular_filter_reaches_align():
    found = align(build("vo_tvk_as_published"), epochs_of("nav"))
    assert Status(int(found.status[-1])) & Status.SINGULAR
