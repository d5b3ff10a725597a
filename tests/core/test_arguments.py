"""Checks of what a user gives, and how numbers stand in tables."""

import math

import numpy as np
import pytest

from jaxalign.arguments import check_choice, nearest, whole_number
from jaxalign.errors import UserError
from jaxalign.tables import Estimate, aligned, markdown


@pytest.mark.parametrize("value", [3, np.int32(3), np.array(3), np.array([[3]])])
def test_whole_numbers(value):
    assert whole_number("runs", value, 2, 10) == 3
    assert type(whole_number("runs", value)) is int


@pytest.mark.parametrize("value", [3.0, np.float64(3), np.array([3.0])])
def test_whole_floats_where_they_will_do(value):
    assert whole_number("every", value, floats=True) == 3
    with pytest.raises(UserError):
        whole_number("every", value)


@pytest.mark.parametrize("value", [True, np.bool_(True), "3", None, 0, -1, 2.5, math.nan, math.inf, [3], np.arange(3)])
def test_what_is_no_whole_number(value):
    with pytest.raises(UserError, match=r"every = .*: must be a whole number of epochs, at least 1"):
        whole_number("every", value, of="epochs", floats=True)


def test_limits_are_named():
    for value in (1, 11):
        with pytest.raises(UserError, match=f"runs = {value}: must be a whole number from 2 to 10"):
            whole_number("runs", value, 2, 10)


def test_choice():
    assert check_choice("mode", "forward", ("auto", "forward")) == "forward"
    with pytest.raises(UserError, match=r"^mode = 'foward': must be one of auto, forward; did you mean 'forward'\?$"):
        check_choice("mode", "foward", ("auto", "forward"))
    with pytest.raises(UserError, match=r"^noise = 1: must be one of True, False$"):
        check_choice("noise", 1, (True, False))


def test_nearest():
    assert nearest("bodi", ("body", "nav")) == "did you mean 'body'? (known: body, nav)"
    assert nearest("xyz", ("body", "nav")) == "known: body, nav"
    assert nearest("xyz", ()) == "known: none"


def test_tables():
    rows = [["1", "oba"], ["20", "roba"]]
    assert aligned(["n", "method"], rows) == " n  method\n 1     oba\n20    roba"
    assert markdown(["n", "method"], rows) == "| n | method |\n| --- | --- |\n| 1 | oba |\n| 20 | roba |"


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (0.98765, 0.0123, "0.988 ± 0.012"),
        (1234.0, 161.0, "1234 ± 160"),
        (0.5, 0.0, "0.5"),
        (0.5, math.nan, "0.5"),
        (120.0, math.inf, "120 ± inf"),
    ],
)
def test_estimates(value, error, text):
    assert str(Estimate(value, error)) == text
    assert str(Estimate(np.float64(value), np.float64(error))) == text
