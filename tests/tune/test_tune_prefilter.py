"""Tuning the prefilter: by the spectrum of the force, and by the attitude behind it."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxalign.methods import build
from jaxalign.simulate import scenario
from jaxalign.tune import Misfit, Tune, engine, run
from jaxalign.tune.objective import loss_and_slope


@pytest.mark.parametrize("start", [0.015, pytest.param(50.0, marks=pytest.mark.slow)])
def test_prefilter_by_its_spectrum(start):
    """The analytic optimum for white noise is 0.489 Hz; from far below and far above."""
    made = scenario("disturbed", condition=1, duration=60.0)
    method = build("fine", prefilter="vondrak", parameters={"front_end.prefilter.cutoff": start})
    tune = Tune(
        made,
        method,
        "front_end.prefilter.cutoff",
        "misfit",
        runs=16,
        held_out=16,
        steps=100,
        rate=0.3,
        fidelity="samples",
    )
    np.testing.assert_allclose(run(tune).values["front_end.prefilter.cutoff"], 0.489, rtol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("condition", [1, 2, 3, 4])
@pytest.mark.parametrize("start", [0.015, 50.0])
def test_cutoff_in_all_conditions(condition, start):
    """Within 5 % of 0.5 Hz."""
    made = scenario("disturbed", condition=condition, duration=60.0)
    method = build("fine", prefilter="vondrak", parameters={"front_end.prefilter.cutoff": start})
    found = run(
        Tune(
            made,
            method,
            "front_end.prefilter.cutoff",
            Misfit(),
            runs=32,
            held_out=8,
            steps=100,
            rate=0.3,
            fidelity="samples",
        )
    )
    assert abs(found.values["front_end.prefilter.cutoff"] / 0.5 - 1) < 0.05


@pytest.mark.slow
def test_prefilter_by_the_attitude():
    """Through the filter: the derivative against differences."""
    made = scenario("disturbed", condition=2, amplitude_mg=100.0, duration=20.0)
    method = build("dual_vector", prefilter="vondrak")
    tune = Tune(made, method, "front_end.prefilter.cutoff", runs=2, held_out=2, every=100, fidelity="samples")
    assert tune.chosen_mode == "forward"
    objective, batch, _ = engine.prepared(tune)
    zero = {"front_end.prefilter.cutoff": jnp.zeros(())}
    _, slope = eqx.filter_jit(loss_and_slope)(objective, zero, batch, "forward")
    value = eqx.filter_jit(lambda x: objective({"front_end.prefilter.cutoff": x}, batch))
    for h in (1e-3, 3e-4):
        np.testing.assert_allclose(slope["front_end.prefilter.cutoff"], (value(h) - value(-h)) / (2 * h), rtol=1e-4)
