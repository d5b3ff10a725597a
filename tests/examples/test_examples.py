"""The examples run, and say what they promise."""

import re

import pytest

from examples import hand_over, own_aid


@pytest.mark.slow
def test_hand_over(capsys):
    hand_over.main()
    said = capsys.readouterr().out
    assert "handed over at 150 s" in said
    squares = [float(x) for x in re.search(r"innovations ([\d., ]+) \(", said)[1].split(",")]
    assert len(squares) == 5
    assert max(squares) < 6


@pytest.mark.slow
def test_own_aid(capsys):
    own_aid.main()
    said = capsys.readouterr().out
    assert "true heading at the end: 350.00 deg" in said
    lines = said.splitlines()
    heading, sd, least = (float(x) for x in lines[-2].split()[1:])
    assert abs(heading - 350) < 4 * sd
    assert sd < 1.3 * least


def test_an_own_aid_is_short():
    """At most 40 lines of class."""
    import inspect

    assert len(inspect.getsource(own_aid.AirSpeed).splitlines()) <= 40
