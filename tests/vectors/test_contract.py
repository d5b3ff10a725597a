"""What every recipe must do, whatever it computes. Adding a recipe adds its rows (tests/problems.py)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import EPOCHS, RECIPES, ROWS, epochs_of, log_of, method_of, solver, sparse, velocities

from jaxalign import Aligner, Epochs, Quat, Status, Vec3, align, with_parameters
from jaxalign.metrics import attitude_error_deg

rows = pytest.mark.parametrize(("name", "aid"), ROWS)
moving = pytest.mark.parametrize(("name", "aid"), [row for row in ROWS if row[1] != "static"])
# What is known of single recipes; their docstrings say why.
CLOSURE_DEG = {"rkf_oba": 0.05, "request": 0.1, "vo_tvk": 0.2, "rls_q": 0.03, "rls_quaternion_kf": 0.03}
LOOKS_AT_RESIDUALS = ("roba",)
SEEN_ELSEWHERE = ("velocity_q", "rls_q", "fine", "robust_map")  # or, like the last, costly
# The covariance starts at a radian, and loses 1e-7 of what the fixes say to rounding.
ROUNDING = {"robust_map": 2e-7}
FORGETS = ("request",)
BOUND_TO_THE_AXES = ("rkf_oba", "vo_tvk")
WITHOUT_CORNERS = {"rkf_oba": {"reconstruct.gamma": 100.0}, "roba": {"weight.gamma": 10.0}}  # test_slots.py tests those


# A wide first covariance, or a search, makes much of the last bits.
SENSITIVE = ("rkf_oba", "revising_oba")


def _further_aids_slow(rows, sensitive=()):
    """Where compiling costs most, a recipe's further aids, and recipes of slots seen elsewhere, are slow tests."""

    def marks(name, aid):
        quick = aid == RECIPES[name].aids[0] and name not in SEEN_ELSEWHERE
        return [*([] if quick else [pytest.mark.slow]), *([pytest.mark.exact] if name in sensitive else [])]

    marked = [pytest.param(name, aid, marks=marks(name, aid)) for name, aid in rows]
    return pytest.mark.parametrize(("name", "aid"), marked)


first_aids = _further_aids_slow(ROWS)
first_aids_exact = _further_aids_slow(ROWS, SENSITIVE)
# Their compilation takes a minute each: test_fine.py, and test_robust_map.py, test_tunables.py, test_robust.py.
GRADIENTS_ELSEWHERE = ("fine", "robust_map")
QUICK_GRADIENTS = ("oba", "roba", "gravity_q", "triad", "request")  # the others compile for 15 s each


first_slots = _further_aids_slow([row for row in ROWS if isinstance(method_of(*row), Aligner)], SENSITIVE)


def truth_dcm(aid):
    log = log_of(aid)
    every = len(log.dtheta) // EPOCHS // log.aid_every
    return log.C_nb[::every][: EPOCHS + 1]


def angle(q, p):
    """Rotation between two quaternion arrays, rad."""
    return 2 * np.linalg.norm((Quat.of(q) * Quat.of(p).conjugate()).positive().vector.array, axis=-1)


@rows
def test_noise_free_closure(name, aid):
    """60 epochs of 4-5 s instead of 300 of 1 s: the trapezoid of the velocity is 16-25 times coarser."""
    if name == "triad":
        pytest.skip("needs a base that does not turn: test_closure.py")
    found = solver()(method_of(name, aid), epochs_of(aid, noise=False))
    error = np.linalg.norm(found.C_nb - truth_dcm(aid), axis=(1, 2))
    late = np.asarray(found.time) >= 150
    assert np.rad2deg(error[late].max()) < CLOSURE_DEG.get(name, 0.02 if aid == "body" else 1e-3)


@rows
def test_outputs_are_finite_units_and_flagged(name, aid):
    found = solver()(method_of(name, aid), epochs_of(aid))
    for leaf in jax.tree.leaves(found):
        assert np.isfinite(np.asarray(leaf, float)).all()
    np.testing.assert_allclose(np.linalg.norm(found.q_nb, axis=1), 1.0, atol=1e-14)
    assert (np.asarray(found.q_nb)[:, 0] >= 0).all()
    defined, status = np.asarray(found.defined), np.asarray(found.status)
    assert not defined[0]
    assert defined[3:].all()
    np.testing.assert_array_equal(defined, (status & Status.UNDEFINED) == 0)
    np.testing.assert_array_equal(np.isnan(found.heading_deg), ~defined)
    assert ((np.asarray(found.weight) >= 0) & (np.asarray(found.weight) <= 1)).all()


@first_slots
def test_online_equals_offline(name, aid):
    method, epochs = method_of(name, aid), epochs_of(aid)
    whole = solver()(method, epochs)
    state = method.init(epochs.site, epochs.interval, epochs.aid_sd)
    step = eqx.filter_jit(method.step)
    for k in range(len(epochs)):
        state, row = step(state, jax.tree.map(lambda x, k=k: x[k], epochs.rows))
        gap = float(whole.eigengap[k])
        rounding = 4e-16 / max(gap, 1e-15) if gap > 0 and whole.defined[k] else 0.0
        assert angle(row.q_nb, whole.q_nb[k]) < 1e-12 + rounding
        assert row.status == whole.status[k]


@first_aids_exact
def test_vmap_over_logs_and_tunables_equals_loop(name, aid):
    """Three logs, each with other values of every tunable."""
    method, batch = method_of(name, aid), [epochs_of(aid, seed) for seed in (1, 2, 3)]
    numbers, rest = eqx.partition(method, eqx.is_array)
    variants = [jax.tree.map(lambda x, f=f: x * f, numbers) for f in (1.0, 0.999, 0.995)]
    stacked, tuned = (jax.tree.map(lambda *x: jnp.stack(x), *some) for some in (batch, variants))
    together = jax.jit(jax.vmap(lambda n, epochs: eqx.combine(n, rest).solve(epochs, 1)))(tuned, stacked)
    for i, one in enumerate(batch):
        alone = solver()(eqx.combine(variants[i], rest), one)
        late = np.asarray(alone.time) > 20  # before, rounding over the eigengap
        gap = np.asarray(alone.eigengap)
        rounding = np.where(gap > 0, 4e-16 / np.where(gap > 0, gap, 1.0), 0.0)  # as in the test above
        assert np.all((angle(alone.q_nb, together.q_nb[i]) < np.maximum(ROUNDING.get(name, 1e-8), rounding))[late])
        np.testing.assert_array_equal(alone.status, together.status[i])


@first_aids
@pytest.mark.parametrize("every", [7, pytest.param(10**6, marks=pytest.mark.slow)])
def test_sparse_readout(name, aid, every):
    """Rows at 0, every, 2 every, ... and the last epoch; the same attitudes, but for the feedback's age."""
    method, epochs = method_of(name, aid), epochs_of(aid)
    full, sparse = solver()(method, epochs), solver(every)(method, epochs)
    index = np.unique([*range(0, EPOCHS + 1, min(every, EPOCHS)), EPOCHS])
    np.testing.assert_allclose(sparse.time, full.time[index])
    if aid == "body" or name in LOOKS_AT_RESIDUALS:  # the transport rate, or the residual, has an older attitude
        most = 0.1 if aid == "body" and name not in FORGETS else 0.5 if aid == "body" else 2.0
        assert np.rad2deg(angle(full.q_nb[-1], sparse.q_nb[-1])) < most
    else:
        late = np.asarray(sparse.time) > 20
        assert angle(full.q_nb[index], sparse.q_nb)[late].max() < max(ROUNDING.get(name, 0.0), 1e-9)


@moving
def test_missing_aid_is_skipped(name, aid):
    """A gap, single losses and a lost first fix: finite everywhere, flagged, near the undisturbed result."""
    method = method_of(name, aid)
    velocity = velocities(aid).copy()
    gone = np.zeros(len(velocity), bool)
    gone[[0, 1, 9, 25, 26, 27, 40]] = True
    velocity[gone, 1] = np.nan  # one axis is enough
    whole, holed = (solver()(method, epochs_of(aid, velocity=v)) for v in (velocities(aid), velocity))
    np.testing.assert_array_equal((np.asarray(holed.status) & Status.AID_MISSING) != 0, gone)
    assert np.isfinite(np.asarray(holed.q_nb)).all()
    assert (np.asarray(holed.weight)[gone] == 0).all()
    assert not np.asarray(holed.defined)[:2].any()
    truth = jnp.asarray(truth_dcm(aid)[-1])
    before, after = (np.rad2deg(np.linalg.norm(s.C_nb[-1] - truth)) for s in (whole, holed))
    # Another first fix: another error of its size. REQUEST starts with a whole vector and then forgets slowly.
    most = 30.0 if name in FORGETS else 1.0 if aid == "body" else 8.0
    assert after < 2 * before + most


@pytest.mark.parametrize(
    ("name", "aid"),
    [
        pytest.param(
            *row, marks=() if row[0] in QUICK_GRADIENTS and row[1] == RECIPES[row[0]].aids[0] else pytest.mark.slow
        )
        for row in ROWS
        if row[0] not in GRADIENTS_ELSEWHERE
    ],
)
def test_gradients(name, aid):
    """Forward = reverse = central differences at two step sizes: aid velocities (all at once) and latitude.

    What stands in a missing sample reaches neither values nor gradients.
    """
    method = with_parameters(method_of(name, aid), WITHOUT_CORNERS.get(name, {}))
    direction = np.random.default_rng(5).normal(size=(EPOCHS + 1, 3)) * (0 if aid == "static" else 1)
    direction[20] = 0.0
    weights = jnp.array([0.3, -0.5, 1.0])
    base = velocities(aid) if aid != "static" else np.zeros((EPOCHS + 1, 3))

    def epochs_at(s):
        velocity = None if aid == "static" else base + s[0] * direction
        epochs = epochs_of(aid, velocity=velocity, lat=log_of(aid).lat + s[1])
        if aid == "static":
            return epochs
        rows = eqx.tree_at(lambda r: (r.valid, r.velocity.x), epochs.rows, _at_20(epochs.rows, s[2]))
        return eqx.tree_at(lambda e: e.rows, epochs, rows)

    every = sparse(name)
    reference = Quat.of(solver(every)(method, epochs_at(np.zeros(3))).q_nb[-1]).conjugate()

    def loss(s):
        q = Quat.of(method.solve(epochs_at(s), every).q_nb[-1]) * reference
        return jnp.dot(weights, q.log().array)

    at = jnp.array([0.0, 0.0, 123.0])
    both = jax.jit(jax.value_and_grad(loss))  # one program for the reverse mode and for the differences
    forward, reverse = jax.jit(jax.jacfwd(loss))(at), both(at)[1]
    rounding = 1e-7 if name == "vo_tvk" else 1e-8  # it begins with a relative gap of 2e-12
    np.testing.assert_allclose(forward, reverse, rtol=rounding, atol=1e-12)
    # m/s, rad: larger steps meet the corners of robust weights, smaller ones the rounding of an early eigenproblem
    # (vo_tvk has no corners).
    for i, steps in enumerate(((1e-3, 2e-4), (2e-3, 1e-3) if name == "vo_tvk" else (5e-5, 2e-5))):
        for h in steps:
            e = jnp.zeros(3).at[i].set(h)
            numeric = (both(at + e)[0] - both(at - e)[0]) / (2 * h)
            np.testing.assert_allclose(forward[i], numeric, rtol=1e-4, atol=2e-7)
    if aid != "static":
        assert abs(forward[0]) > 1e-6
    assert (abs(forward[1]) > 1e-6) == (name != "triad")  # up and east need no latitude
    assert forward[2] == 0
    assert both(at.at[2].set(-7.0))[0] == both(at)[0]


def _at_20(rows, x):
    return rows.valid.at[20].set(False), rows.velocity.x.at[20].set(x)


@first_aids
@settings(max_examples=5, deadline=None)
@given(vector=st.tuples(*[st.floats(-2, 2)] * 3))
def test_turning_the_body_frame_turns_the_answer(name, aid, vector):
    """Data in b' = R b: C_nb' = C_nb R^T. Two methods look at the axes of b one by one and differ: by less than one
    thousandth of a radian at the end (rkf_oba), or by degrees (vo_tvk: its nine elements do not turn as a whole).
    """
    method, epochs = method_of(name, aid), epochs_of(aid)
    r = Quat.exp(Vec3(*map(jnp.asarray, vector)))
    rows = epochs.rows
    turned = eqx.tree_at(
        lambda x: (x.rotation, x.dvel, x.velocity),
        rows,
        (
            r * rows.rotation * r.conjugate(),
            r.rotate(rows.dvel),
            r.rotate(rows.velocity) if aid == "body" else rows.velocity,
        ),
    )
    there = solver()(method, epochs)
    here = solver()(method, eqx.tree_at(lambda e: e.rows, epochs, turned))
    late = np.asarray(there.time) > 20
    back = (Quat.of(here.q_nb) * r).array
    differences = angle(back, there.q_nb)
    if name not in BOUND_TO_THE_AXES:
        assert differences[late].max() < ROUNDING.get(name, 1e-8)
    elif name == "rkf_oba":
        assert differences[-1] < 1e-3
    else:  # test_slots.py has how much
        assert np.isfinite(differences).all()


@rows
def test_no_recompilation_for_other_data(name, aid, caplog):
    method = method_of(name, aid)
    align(method, epochs_of(aid, 1))
    with jax.log_compiles(), caplog.at_level("WARNING"):
        other = epochs_of(aid, 2)
        other = eqx.tree_at(lambda e: (e.site.lat, e.aid_sd), other, (other.site.lat + 0.01, other.aid_sd * 2))
        caplog.clear()
        align(method, other)
    assert not [record for record in caplog.records if "Finished XLA compilation" in record.getMessage()]


@rows
def test_observable_is_a_latch_in_practice(name, aid):
    found = solver()(method_of(name, aid), epochs_of(aid))
    seen = np.asarray(found.observable)
    assert not seen[0]
    assert seen[-1]
    assert (np.diff(seen.astype(int)) >= 0).all()


def test_epochs_are_a_plain_pytree():
    epochs = epochs_of("body")
    assert isinstance(jax.tree.map(lambda x: x, epochs), Epochs)
    assert len(epochs) == EPOCHS + 1


def test_heading_error_has_the_sign_of_the_heading():
    log = log_of("body")
    found = align(method_of("oba", "body"), log)
    from jaxalign.rotation import euler_from_dcm

    true = np.mod(-np.rad2deg(np.asarray(euler_from_dcm(log.C_nb)))[:, 2], 360)
    expected = np.mod(found.heading_deg - true + 180, 360) - 180
    np.testing.assert_allclose(attitude_error_deg(found, log)[-50:, 2], expected[-50:], atol=2e-3)
