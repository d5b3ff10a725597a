"""Losses of a search, in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxalign import UserError
from jaxalign.tune import LOSSES, Convergence, LogRmse, Quantile, Rmse, RunErrors


@pytest.fixture(scope="module")
def errors():
    rng = np.random.default_rng(0)
    euler = rng.normal(0, 1, (40, 6, 3)) * np.exp(rng.normal(size=(40, 1, 1)))
    return RunErrors(jnp.asarray(euler), jnp.asarray(euler), jnp.arange(10.0, 61.0, 10.0))


def test_rmse(errors):
    yaw, level = np.asarray(errors.euler[..., 2]), np.asarray(errors.euler[..., :2])
    np.testing.assert_allclose(Rmse()(errors), np.sqrt((yaw**2).mean()))
    np.testing.assert_allclose(Rmse(angle="level")(errors), np.sqrt((level**2).mean()))
    each = np.sqrt((yaw**2).mean(axis=1))
    np.testing.assert_allclose(LogRmse()(errors), np.log(each).mean())
    np.testing.assert_allclose(Quantile(share=0.9)(errors), np.quantile(each, 0.9))


def test_convergence(errors):
    """With a hard edge: the seconds outside."""
    outside = (abs(np.asarray(errors.euler[..., 2])) > 1.0).sum(axis=1) * 10.0
    np.testing.assert_allclose(Convergence(softness=1e-6)(errors), outside.mean())
    np.testing.assert_allclose(Convergence()(errors), outside.mean(), rtol=0.1)


@pytest.mark.parametrize("loss", [Rmse(), LogRmse(), Quantile(), Convergence(), Rmse(angle="level")])
def test_losses_have_finite_derivatives_at_zero(loss, errors):
    nothing = jax.tree.map(jnp.zeros_like, errors)
    slope = jax.grad(lambda x: loss(RunErrors(x, x, errors.time)))(nothing.euler)
    assert np.isfinite(slope).all()


@pytest.mark.parametrize(
    ("loss", "bad"), [("rmse", {"angle": "head"}), ("quantile", {"share": 2.0}), ("convergence", {"softness": 0.0})]
)
def test_bad_losses(loss, bad):
    with pytest.raises(UserError, match=next(iter(bad))):
        LOSSES[loss](**bad)
