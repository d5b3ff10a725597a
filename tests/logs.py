"""Logs for the tests of the checks, and changes to logs."""

import dataclasses

import numpy as np
import pytest

from jaxalign.earth import EARTH_RATE
from jaxalign.errors import UserError
from jaxalign.log import Log
from jaxalign.measurements import Measurements

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
        "epoch_samples": EVERY,
        "aid": "body",
        "velocity": np.tile([0.0, 1.0, 0.0], (EPOCHS + 1, 1)),
        "lat": LAT,
        "C_nb": np.tile(np.eye(3), (EPOCHS + 1, 1, 1)),
    }
    return base | changes


def log_of(velocity=None, aid="body", aid_sd=None, **rest):
    """A log with one aid that measures at all epochs, or with none."""
    aids = rest.pop("aids", ())
    if aid != "static" and not aids:
        time = np.arange(len(velocity)) * (rest["epoch_samples"] * rest["dt"])
        aids = (Measurements(aid, time, velocity, aid_sd),)
    return Log(**rest, aids=aids)


def with_velocity(log, velocity, **changes):
    """The same log with other values of its aid."""
    one = dataclasses.replace(log.aids[0], value=np.asarray(velocity))
    return dataclasses.replace(log, aids=(one,), **changes)


def with_noise(made, sd=None, faults=None):
    """The same scenario with other noise or faults of its aid."""
    changes = {key: value for key, value in (("sd", sd), ("faults", faults)) if value is not None}
    return dataclasses.replace(made, aids=(dataclasses.replace(made.aids[0], **changes),))


def static(**changes):
    return fields(aid="static", velocity=None, **changes)


def put(array, index, value):
    array = np.array(array)
    array[index] = value
    return array


def message(**changes):
    with pytest.raises(UserError) as caught:
        log_of(**fields(name="trial", **changes))
    text = str(caught.value)
    assert text.startswith("trial")
    assert "\n" not in text
    return text


GOOD = fields()
