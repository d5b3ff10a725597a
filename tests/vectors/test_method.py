"""The protocol: a method of one's own needs no change of the library."""

import equinox as eqx
import numpy as np
import pytest

import jaxalign as ja
from jaxalign.front_end import FrontEnd
from jaxalign.inertial_unit import PER_SAMPLE, AccelErrors, GyroErrors, ImuErrors
from jaxalign.methods import RECIPES, build
from jaxalign.simulate import scenario, simulate
from jaxalign.study import Study, run


class Delegating(ja.AbstractMethod):
    """It leaves the work to another method, as a method from elsewhere would do its own."""

    inner: ja.AbstractMethod
    aids: tuple = eqx.field(static=True, default=(ja.BodyVelocity(),))
    front_end: FrontEnd = FrontEnd()
    prefilter: None = None

    def solve(self, epochs, rows=1, done=None):
        return self.inner.solve(epochs, rows, done)


@pytest.fixture(scope="module")
def made():
    return scenario("dvl-sturn", outliers="fixed", duration=60.0)


def test_a_method_of_ones_own(made):
    log, inner = simulate(made, 1), build("oba", "body")
    own = Delegating(inner)
    found, expected = ja.align(own, log, every=10), ja.align(inner, log, every=10)
    np.testing.assert_array_equal(found.q_nb, expected.q_nb)
    np.testing.assert_allclose(own.misfit(found, 1.0), np.sqrt(2) * inner.misfit(found, 1.0))
    assert own.with_imu(ja.imu_errors("mems")) is own
    with pytest.raises(ja.UserError, match=r"has no body .*which the method observes: it has nav"):
        own.epochs(simulate("gps-zigzag", 1, duration=20.0))


@pytest.mark.slow
def test_in_a_study(made):
    own, plain = (run(Study(made, {"x": m}, runs=8, every=10))["x"] for m in (Delegating(build("oba")), build("oba")))
    np.testing.assert_allclose(own.end, plain.end, atol=1e-9)


def test_what_is_missing_is_named():
    class Nothing(ja.AbstractMethod):
        aid = "body"

    with pytest.raises(TypeError, match="abstract"):
        Nothing()


@pytest.mark.parametrize("name", list(RECIPES))
def test_every_recipe_keeps_it(name):
    """Figures of the unit reach the methods with a model of it, by the same names, and no others."""
    method = build(name)
    assert isinstance(method, ja.AbstractMethod)
    assert method.front_end.interval_samples is None
    assert method.front_end.prefilter is None
    imu = ImuErrors(GyroErrors(3.0, 0.2), AccelErrors(700.0, 90.0))
    held = {path: x for path, x in ja.parameters(method.with_imu(imu)).items() if "imu." in path}
    path = {"fine": "filter.imu.", "robust_map": "imu.", "auto": "imu."}.get(name)
    expected = {} if path is None else {path + x: y for x, y in ja.parameters(imu).items() if x not in PER_SAMPLE}
    assert held == expected
