"""The recursive robust estimator against the bound, and against the sums that it revises."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import EPOCHS, epochs_of, method_of, solver
from statistical import outlying, phi_deg

from jaxalign import Quat, Vec3, align
from jaxalign.bounds import bound
from jaxalign.errors import UserError
from jaxalign.estimate import CentredSums, Held, reweighted
from jaxalign.methods import build
from jaxalign.simulate import intervals_of, measure_epochs, scenario, truth


@eqx.filter_jit
def solved(method, made, intervals, keys, every):
    def one(key):
        return method.solve(measure_epochs(intervals, made, key), every).q_nb

    return jax.lax.map(one, keys, batch_size=64)


def ratios(made, runs, every):
    """Errors over the bound, rows after the first: (runs, rows, 3)."""
    method, exact = build("revising_oba", made.aids[0].aid), truth(made)
    keys = jax.random.split(jax.random.key(5), runs)
    q = solved(method, made, intervals_of(exact, made.epoch_samples), keys, every)[:, 1:]
    rows = np.unique([*range(0, made.epochs + 1, every), made.epochs])[1:]
    return np.abs(phi_deg(q, exact.C_nb[rows])) / np.asarray(bound(made, exact).phi_deg)[rows]


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("share", [0.0, 0.02, 0.1])
def test_near_the_bound(share):
    """300 s with a Doppler log, outliers 300 times too large, the first fix like the others: 1000 runs."""
    heading = ratios(outlying(scenario("dvl-sturn"), share), 1000, 300)[:, -1, 2]
    assert np.sqrt(np.mean(heading**2)) < 1.25
    assert np.quantile(heading, 0.99) < 3.5
    assert heading.max() < 6.0


@pytest.mark.slow
@pytest.mark.long
def test_early_outliers_and_gnss():
    """Every run has a bad first fix, and jumps later on."""
    made = scenario("gps-zigzag", outliers="jump", first="always")
    heading = ratios(made, 500, 125)[:, :, 2]
    assert np.sqrt(np.mean(heading**2, axis=0)).max() < 1.5
    assert heading.max() < 8.0


def test_reweighting_finds_the_good_ones():
    """Forty pairs of a known rotation and offset, a third of them wrong."""
    rng = np.random.default_rng(2)
    beta = rng.normal(size=(40, 3)) * 10
    attitude = Quat.exp(Vec3(*jnp.array([0.4, -1.0, 2.0])))
    offset = Vec3(*jnp.array([3.0, -2.0, 1.0]))
    alpha = (attitude.rotate(Vec3.of(jnp.asarray(beta))) + offset).array + rng.normal(size=(40, 3)) * 1e-3
    wrong = np.arange(40) % 3 == 0
    alpha = alpha + wrong[:, None] * rng.normal(size=(40, 3)) * 5
    held = Held(Vec3.of(alpha), Vec3.of(jnp.asarray(beta)), None, Vec3.zero(), jnp.ones(40, bool))
    found, sums, weight, scale = eqx.filter_jit(reweighted)(
        CentredSums.zero(False), held, Quat.identity(), False, 1e-6, 5.0
    )
    assert (np.asarray(weight)[wrong] == 0).all()
    assert (np.asarray(weight)[~wrong] > 0.1).all()
    np.testing.assert_allclose(scale, 1e-3, rtol=0.5)
    np.testing.assert_allclose((found.attitude * attitude.conjugate()).log().array, 0, atol=1e-3)
    np.testing.assert_allclose(sums.offset(found.attitude, Vec3.zero()).array, offset.array, atol=2e-2)


def test_without_outliers_it_is_centred_oba_but_for_the_weights():
    """60 fixes in 300 s, in the programs of test_contract.py: sqrt(5) times the difference of 300 fixes."""
    both = [
        solver()(method_of(name, "body"), epochs_of("body")).euler_deg[-1] for name in ("centred_oba", "revising_oba")
    ]
    np.testing.assert_allclose(*both, atol=0.15 * np.sqrt(5))


@pytest.mark.slow
def test_memory():
    with pytest.raises(UserError, match="at least 4"):
        build("revising_oba", "body", {"estimate.memory": 3})
    with pytest.raises(UserError, match="leave it at 0"):
        build("revising_oba", "body", {"observe.window": 60.0})
    assert align(build("revising_oba", "body", {"estimate.memory": 8}), epochs_of("body"), every=EPOCHS).defined[-1]
