"""One small study, the same in all the tests of studies, and when two of them are identical."""

import functools

import numpy as np

from jaxalign.simulate import scenario
from jaxalign.study import Study, run

SHORT = {"duration": 60.0}
RUNS = 100


def small(made=None, methods=("oba", "roba")):
    """100 runs of two methods with outliers, 60 s; other scenarios and fewer methods share its programs."""
    made = scenario("dvl-sturn", outliers="fixed", **SHORT) if made is None else made
    return Study(made, list(methods), runs=RUNS, seed=4, tolerance_deg=20.0, window=(30.0, 60.0))


@functools.cache
def result_of_small():
    """One for all tests of a process (the files that use it are one group of xdist)."""
    return run(small())


def arrays(result):
    """Of a result, but its settings."""
    return {key: value for key, value in result.arrays().items() if key != "settings"}


def assert_identical(one, two):
    """To the last bit."""
    one, two = arrays(one), arrays(two)
    assert one.keys() == two.keys()
    for key in one:
        np.testing.assert_array_equal(one[key], two[key], err_msg=key)
