"""What every recipe must do, whatever it computes. Adding a recipe adds its rows (tests/problems.py)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import EPOCHS, RECIPES, ROWS, contract_of, epochs_of, log_of, method_of, solver, velocities

from jaxalign import Aligner, Epochs, Quat, Status, UserError, Vec3, align
from jaxalign.metrics import attitude_error_deg

# What single recipes are held to stands beside them (jaxalign/recipes.py, Contract); here is what is quick.

# One of every kind: what batches, sparse rows and single steps have of their own depends on the kind of recursion.
# (roba among many runs: test_study.py.)
KINDS = ("dual_vector", "oba", "rkf_oba", "request", "quaternion_kf")
# The aid is the business of one slot, which this recipe shows with each of them; others with a further aid are slow
# (robust_map with each: test_robust_map.py).
EVERY_AID = ("oba",)
# Their filter and solver: tests/filters/test_fine.py, tests/batch, tests/auto.
TESTED_ELSEWHERE = ("fine", "robust_map", "auto")


def _slow(every_aid=(), kinds=tuple(RECIPES), alike=False):
    """Rows, slow with a further aid (but of some recipes), and where another recipe is of the same kind.

    Args:
        alike: whether two programs are compared.
    """

    def marks(name, aid):
        recipe = RECIPES[name]
        quick = (aid == recipe.aids[0].kind or name in every_aid) and name in kinds and name not in TESTED_ELSEWHERE
        slow, exact = recipe.published or not quick, alike and recipe.contract.sensitive
        return [*([pytest.mark.slow] if slow else []), *([pytest.mark.exact] if exact else [])]

    def parametrize(rows):
        marked = [pytest.param(name, aid, marks=marks(name, aid)) for name, aid in rows]
        return pytest.mark.parametrize(("name", "aid"), marked)

    return parametrize


rows = _slow(EVERY_AID)(ROWS)
moving = _slow(EVERY_AID)([row for row in ROWS if row[1] != "static"])
cheap = _slow(EVERY_AID, [name for name in RECIPES if not method_of(name, RECIPES[name].aids[0].kind).rows_are_costly])(
    ROWS
)
# These compile programs of their own, in which the aid is nothing special.
FIRST = [(name, aid) for name, aid in ROWS if aid == RECIPES[name].aids[0].kind or name in EVERY_AID]
first_aids = _slow((), ("oba", "quaternion_kf"))(FIRST)
first_recursion = _slow((), ("oba",), alike=True)(FIRST)
first_slots = _slow((), KINDS, alike=True)([row for row in FIRST if isinstance(method_of(*row), Aligner)])
kinds = _slow((), ())([(name, RECIPES[name].aids[0].kind) for name in KINDS])


def truth_dcm(aid):
    log = log_of(aid)
    every = len(log.dtheta) // EPOCHS // log.epoch_samples
    return log.C_nb[::every][: EPOCHS + 1]


def angle(q, p):
    """Rotation between two quaternion arrays, rad."""
    (q0, q), (p0, p) = ((x[..., :1], x[..., 1:]) for x in (np.asarray(q), np.asarray(p)))
    return 2 * np.linalg.norm(p0 * q - q0 * p - np.cross(q, p), axis=-1)


def rounding_of(found):
    """What the last bits do to an attitude, rad: they turn an eigenvector by themselves over the eigengap.

    Of 60 turns of the body frame, 7e-16 over it at most.
    """
    gap = np.asarray(found.eigengap)
    return np.where((gap > 0) & np.asarray(found.defined), 1e-15 / np.maximum(gap, 1e-15), 0.0)


def rounding_of_slopes(name, epochs):
    """What the last bits of slopes do to an attitude of a filter that begins with all of it open, rad.

    A radian is gravity times the interval in velocity; rounding takes its part of the square of that over a fix. Of 60
    turns of a standing vehicle twice that at most.
    """
    if not contract_of(name).free:
        return 0.0
    sd = np.min([np.min(x) for x in epochs.sd])
    return 4 * np.finfo(float).eps * (9.8 * epochs.interval / sd) ** 2


@rows
def test_noise_free_closure(name, aid):
    """60 epochs of 4-5 s instead of 300 of 1 s: the trapezoid of the velocity is 16-25 times coarser."""
    most = contract_of(name).closure_deg
    if most == np.inf:
        pytest.skip("not on this problem: test_closure.py")
    found = solver()(method_of(name, aid), epochs_of(aid, noise=False))
    error = np.linalg.norm(found.C_nb - truth_dcm(aid), axis=(1, 2))
    late = np.asarray(found.time) >= 150
    assert np.rad2deg(error[late].max()) < (most or (0.02 if aid == "body" else 1e-3))


@cheap
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
    state = method.init(epochs.site, epochs.aid_sd)
    step, rows, out = eqx.filter_jit(method.step), jax.tree.map(np.asarray, epochs.rows), []
    for k in range(len(epochs)):
        state, row = step(state, jax.tree.map(lambda x, k=k: x[k], rows))
        out.append(row)
    assert np.all(angle(np.stack([row.q_nb for row in out]), whole.q_nb) < 1e-12 + rounding_of(whole))
    np.testing.assert_array_equal([row.status for row in out], whole.status)


@first_recursion
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
        most = np.maximum(max(contract_of(name).rounding, 1e-8), rounding_of(alone))
        assert np.all((angle(alone.q_nb, together.q_nb[i]) < most)[late])
        np.testing.assert_array_equal(alone.status, together.status[i])


@first_aids
def test_sparse_readout(name, aid):
    """Rows at 0, every, 2 every, ... and the last epoch; the same attitudes, but for the feedback's age."""
    assert_sparse_readout(name, aid, 6)


@kinds
@pytest.mark.parametrize("every", [7, 10**6])
def test_sparse_readout_with_a_rest(name, aid, every):
    """Which rows there are is the same for all recipes of a kind."""
    assert_sparse_readout(name, aid, every)


@_slow((), ("dual_vector",))(FIRST)
@pytest.mark.parametrize("numbers", [(6, 30, 60), (12, 48)])
def test_rows_by_number(name, aid, numbers):
    """The numbers of the epochs to read out, in place of a stride: the rows of that stride."""
    method, epochs = method_of(name, aid), epochs_of(aid)
    found, stride = (solver(rows)(method, epochs) for rows in (np.array(numbers), np.gcd.reduce(numbers)))
    rows = np.searchsorted(stride.time, found.time - 1e-6)
    np.testing.assert_array_equal(np.round(found.time / epochs.interval), numbers)
    np.testing.assert_allclose(found.q_nb, np.asarray(stride.q_nb)[rows], atol=max(contract_of(name).rounding, 1e-9))
    with pytest.raises(UserError, match="whole numbers from 0 to 60"):
        method.solve(epochs, np.array([3, 61]))


def assert_sparse_readout(name, aid, every):
    method, epochs = method_of(name, aid), epochs_of(aid)
    full, sparse = solver()(method, epochs), solver(every)(method, epochs)
    index = np.unique([*range(0, EPOCHS + 1, min(every, EPOCHS)), EPOCHS])
    np.testing.assert_allclose(sparse.time, full.time[index])
    weight = vars(method).get("weight")
    if aid == "body" or (weight and weight.looks_at_attitude):  # the transport rate, or a residual, has an older one
        most = (0.5 if contract_of(name).forgets else 0.1) if aid == "body" else 2.0
        assert np.rad2deg(angle(full.q_nb[-1], sparse.q_nb[-1])) < most
    else:
        late = np.asarray(sparse.time) > 20
        assert angle(full.q_nb[index], sparse.q_nb)[late].max() < max(contract_of(name).rounding, 1e-9)


@moving
def test_missing_aid_is_skipped(name, aid):
    """A gap, single losses and a lost first fix: finite everywhere, flagged, near the undisturbed result."""
    method = method_of(name, aid)
    velocity = velocities(aid).copy()
    gone = np.zeros(len(velocity), bool)
    gone[[0, 1, 9, 25, 26, 27, 40]] = True
    velocity[gone, slice(None) if method.takes_components else 1] = np.nan  # of a whole velocity one axis is enough
    whole, holed = (solver()(method, epochs_of(aid, velocity=v)) for v in (velocities(aid), velocity))
    np.testing.assert_array_equal((np.asarray(holed.status) & Status.AID_MISSING) != 0, gone)
    assert np.isfinite(np.asarray(holed.q_nb)).all()
    assert (np.asarray(holed.weight)[gone] == 0).all()
    assert not np.asarray(holed.defined)[:2].any()
    truth = jnp.asarray(truth_dcm(aid)[-1])
    before, after = (np.rad2deg(np.linalg.norm(s.C_nb[-1] - truth)) for s in (whole, holed))
    # Another first fix: another error of its size. REQUEST starts with a whole vector and then forgets slowly.
    most = 30.0 if contract_of(name).forgets else 1.0 if aid == "body" else 8.0
    assert after < 2 * before + most


@cheap
@settings(max_examples=5, deadline=None)
@given(vector=st.tuples(*[st.floats(-2, 2)] * 3))
def test_turning_the_body_frame_turns_the_answer(name, aid, vector):
    """Data in b' = R b: C_nb' = C_nb R^T, but of a method that looks at the axes of b one by one."""
    method, epochs = method_of(name, aid), epochs_of(aid)
    r = Quat.exp(Vec3(*map(jnp.asarray, vector)))
    rows = epochs.rows
    turned = eqx.tree_at(lambda x: (x.rotation, x.dvel), rows, (r * rows.rotation * r.conjugate(), r.rotate(rows.dvel)))
    if aid == "body":
        turned = turned.with_velocity(r.rotate(rows.velocity))
    there = solver()(method, epochs)
    here = solver()(method, eqx.tree_at(lambda e: e.rows, epochs, turned))
    late = np.asarray(there.time) > 20
    back = (Quat.of(here.q_nb) * r).array
    differences = angle(back, there.q_nb)
    contract = contract_of(name)
    assert np.isfinite(differences).all()
    if contract.mounting:
        assert differences[-1] < contract.mounting  # infinite: test_slots.py has how much
    else:
        most = max(contract.rounding, 1e-8, rounding_of_slopes(name, epochs))
        assert (differences < np.maximum(most, rounding_of(there)))[late].all()


@first_aids
@pytest.mark.uncached
def test_no_recompilation_for_other_data(name, aid, caplog):
    method = method_of(name, aid)
    align(method, epochs_of(aid, 1))
    with jax.log_compiles(), caplog.at_level("WARNING"):
        other = epochs_of(aid, 2)
        other = eqx.tree_at(lambda e: e.site.lat, other, other.site.lat + 0.01).with_sd(other.aid_sd * 2)
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
