"""Pictures: what is drawn is what was found."""

import dataclasses

import numpy as np
import pytest

from jaxalign import UserError, align, plots
from jaxalign.methods import build
from jaxalign.simulate import simulate


@pytest.fixture(scope="module")
def made():
    log = simulate("dvl-sturn", 2)
    return log, align(build("oba"), log)


def line(axis, label):
    return next(x for x in axis.get_lines() if x.get_label() == label)


def test_attitude(made):
    log, solution = made
    figure = plots.attitude(solution, log, "a title")
    axes = figure.axes
    assert [a.get_ylabel() for a in axes] == [
        *("pitch (deg)", "roll (deg)", "heading (deg)", "level error (deg)", "heading error (deg)", "residual (m/s)"),
    ]
    assert axes[-1].get_xlabel() == "time (s)"
    np.testing.assert_array_equal(line(axes[0], "estimate").get_ydata(), solution.euler_deg[:, 0])
    drawn, true = (line(axes[2], label).get_ydata()[60:] for label in ("estimate", "reference"))
    assert np.nanmax(np.abs(drawn - true)) < 30
    assert figure._suptitle.get_text() == "a title"


def test_without_reference(made):
    log, solution = made
    bare = dataclasses.replace(log, C_nb=None)
    assert len(plots.attitude(solution, bare).axes) == 4
    with pytest.raises(UserError, match="no reference"):
        plots.compare({"oba": solution}, bare)


def test_compare(made):
    log, solution = made
    figure = plots.compare({"first": solution, "second": solution}, log)
    assert [t.get_text() for t in figure.axes[2].get_legend().get_texts()] == ["first", "second"]


@pytest.mark.slow
def test_the_methods_own_standard_deviations_are_drawn():
    log = simulate("disturbed", 2, duration=20.0)
    solution = align(build("fine"), log, every=20)
    axes = plots.attitude(solution, log).axes
    np.testing.assert_allclose(line(axes[4], "its own sd").get_ydata()[1:], np.rad2deg(solution.sd)[1:, 2])
    assert "its own sd" in [t.get_text() for t in axes[2].get_legend().get_texts()]
