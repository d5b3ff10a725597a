"""The increments of a log on the host are those of traced code."""

import jax
import numpy as np
import pytest

from jaxalign.preintegration import preintegrate
from jaxalign.preintegration_host import preintegrated


@pytest.mark.parametrize(("every", "at_once"), [(1, 4), (2, 50_000), (7, 50_000), (8, 20), (3, 1)])
def test_equal_to_rounding(every, at_once, monkeypatch):
    monkeypatch.setattr("jaxalign.preintegration_host._AT_ONCE", at_once)
    rng = np.random.default_rng(every)
    dtheta, dvel = rng.normal(scale=0.02, size=(59, 3)), rng.normal([0.0, 0.0, 0.1], 0.1, size=(59, 3))
    wanted = jax.jit(preintegrate, static_argnums=2)(dtheta, dvel, every)
    found = preintegrated(dtheta, dvel, every)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert isinstance(a, np.ndarray)
        np.testing.assert_allclose(a, b, rtol=0, atol=2e-15)
