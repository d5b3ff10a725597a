"""Derivatives of every recipe by its data: forward = reverse = central differences at two step sizes."""

import numpy as np
import pytest
from problems import OWN, RECIPES, contract_of, velocities
from slopes import Slopes

# Their compilation takes a minute each: test_fine.py, test_auto.py, and test_robust_map.py, test_tunables.py,
# test_robust.py.
GRADIENTS_ELSEWHERE = ("fine", "robust_map", "auto")
# The aid is the business of one slot, which this recipe shows with each of them.
EVERY_AID = ("oba",)
# A whole record of a standing vehicle. The others are slow tests; their slots have tests of their own (test_slots.py);
# a recursion with a weight: test_tunables.py.
QUICK = ("triad",)
rows = pytest.mark.parametrize(
    ("name", "aid"),
    [
        pytest.param(name, aid, marks=() if name in QUICK and aid == RECIPES[name].aids[0].kind else pytest.mark.slow)
        for name, aid in OWN
        if name not in GRADIENTS_ELSEWHERE and (aid == RECIPES[name].aids[0].kind or name in EVERY_AID)
    ],
)


@rows
def test_gradients(name, aid):
    """Aid velocities (all at once) and latitude.

    What stands in a missing sample reaches neither values nor gradients.
    """
    contract = contract_of(name)
    slopes = Slopes(name, aid, dict(contract.smooth))  # test_slots.py has the corners
    at = slopes.zero + np.where(np.arange(len(slopes.zero)) == 2, 123.0, 0.0)
    value, slope, by_velocity, gap = slopes.reverse(at)
    # Each part as large as the others, so that each is compared as strictly.
    towards = np.array([1.0, -0.6, 0.3, *np.zeros(len(at) - 3)]) / np.where(np.abs(slope) > 1e-6, np.abs(slope), 1.0)
    np.testing.assert_allclose(slopes.forward(at, towards), slope @ towards, rtol=0, atol=contract.slope_rounding)
    terms = np.linalg.norm(by_velocity * slopes.direction)  # of which the first is the sum: they nearly cancel
    last_bits = np.finfo(float).eps / gap if gap > 0 and contract.small_gap else 0.0
    for i, steps in enumerate((contract.velocity_steps, contract.latitude_steps)):
        for h in steps:
            atol = 2e-7 + 1e-4 * terms * (i == 0) + last_bits / h * (i == 1)
            np.testing.assert_allclose(slope[i], slopes.difference(i, h), rtol=1e-4, atol=atol)
    if aid != "static":
        assert abs(slope[0]) > 1e-6
    assert (abs(slope[1]) > 1e-6) == contract.uses_latitude
    assert slope[2] == 0
    at[2] = -7.0
    assert slopes.reverse(at)[0] == value


@pytest.mark.parametrize(
    ("name", "aid"),
    [
        pytest.param(name, aid, marks=() if name in QUICK else pytest.mark.slow)
        for name, aid in OWN
        if aid != "static" and name != "auto" and (aid == RECIPES[name].aids[0].kind or name == "robust_map")
    ],
)
def test_gradients_stay_finite_with_outliers_and_gaps(name, aid):
    """In the velocities (all of them) and in every tunable, with outliers of every kind among 60 epochs."""
    velocity = velocities(aid).copy()
    velocity[1] += 1e3
    velocity[7:9] *= 300.0
    velocity[15, 0] += 30.0
    velocity[30:33] = np.nan
    velocity[40] = velocity[41] = 0.0
    slopes = Slopes(name, aid, {}, "defined", velocity)
    value, slope, by_velocity, _ = slopes.reverse(slopes.zero)
    assert np.isfinite(value)
    assert np.isfinite(slope).all()
    assert np.isfinite(by_velocity).all()
    assert (by_velocity[30:33] == 0).all()
