"""Logs for the tests of the checks."""

import numpy as np
import pytest

from jaxalign.earth import EARTH_RATE
from jaxalign.errors import UserError
from jaxalign.log import Log

DT, EVERY, EPOCHS = 0.01, 100, 20
LAT = 0.56


def fields(**changes):
    """A level vehicle at rest, its body axes along East, North and Up, with a DVL that reads 1 m/s."""
    samples = EVERY * EPOCHS
    w = EARTH_RATE * np.array([0.0, np.cos(LAT), np.sin(LAT)])
    base = {
        "dtheta": np.tile(w * DT, (samples, 1)),
        "dvel": np.tile([0.0, 0.0, 9.8 * DT], (samples, 1)),
        "dt": DT,
        "aid_every": EVERY,
        "aid": "body",
        "velocity": np.tile([0.0, 1.0, 0.0], (EPOCHS + 1, 1)),
        "lat": LAT,
        "C_nb": np.tile(np.eye(3), (EPOCHS + 1, 1, 1)),
    }
    return base | changes


def static(**changes):
    return fields(aid="static", velocity=None, **changes)


def put(array, index, value):
    array = np.array(array)
    array[index] = value
    return array


def message(**changes):
    with pytest.raises(UserError) as caught:
        Log(**fields(name="trial", **changes))
    text = str(caught.value)
    assert text.startswith("trial")
    assert "\n" not in text
    return text


GOOD = fields()
