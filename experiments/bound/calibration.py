"""Whether the standard deviations hold: coverage of 95 % intervals and NEES, per recipe, in scenarios that match."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from experiments.bound.conditions import recipes, with_condition
from experiments.page import Table
from experiments.progress import progress
from jaxalign.rotation import attitude_error, quat_from_dcm
from jaxalign.simulate import Scenario, intervals_of, measure_epochs, scenario, truth
from jaxalign.tables import Estimate
from jaxalign.uncertainty import ensemble_covariance

__all__ = ["CASES", "Calibration", "calibration", "calibration_table"]

CASES = {
    "dvl-sturn, clean": ("dvl-sturn", {}, "clean"),
    "dvl-sturn, 10 %": ("dvl-sturn", {}, "10 %"),
    "gps-zigzag, clean": ("gps-zigzag", {}, "clean"),
    "gps-zigzag, 10 %": ("gps-zigzag", {}, "10 %"),
    "sway, 120 s": ("sway", {"duration": 120.0}, None),
}
DRAWS = 32
_WITHIN = 1.96
_CHUNK = 10


class Calibration(NamedTuple):
    """Errors at the end and what was said of them.

    Attributes:
        phi: (runs, 3) rad: east, north, heading.
        covariance: (runs, 3, 3) rad^2.
    """

    phi: np.ndarray
    covariance: np.ndarray

    @property
    def covered(self) -> np.ndarray:
        """(3,) shares of the runs whose error is within 1.96 standard deviations."""
        sd = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))
        return (np.abs(self.phi) < _WITHIN * sd).mean(axis=0)

    @property
    def nees(self) -> Estimate:
        """Mean of the errors squared, each by what was expected of it: 1 if it holds."""
        each = np.einsum("ni,nij,nj->n", self.phi, np.linalg.inv(self.covariance), self.phi) / 3.0
        return Estimate(float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each))))


def calibration(case: str, runs: int, seed: int) -> dict[str, Calibration]:
    """Label -> errors and covariances of every recipe; biases are drawn from a normal distribution."""
    name, options, condition = CASES[case]
    made = scenario(name, bias="gaussian", **options)
    if condition is not None:
        made = with_condition(made, condition)
    exact = truth(made)
    reference = quat_from_dcm(exact.C_nb[-1])
    chunks = -(-runs // _CHUNK)
    keys = jax.random.split(jax.random.key(seed), (chunks, _CHUNK))
    methods = recipes(made)
    out = {}
    with progress(f"calibration, {case}", chunks * len(methods)) as bar:
        for label, method in methods.items():
            every = method.front_end.interval_samples or made.epoch_samples
            intervals = intervals_of(exact, every)
            parts = []
            for some in keys:
                parts.append(_solved(method, made, intervals, some))
                bar.update(1)
            q, covariance = (np.concatenate(x)[:runs] for x in zip(*parts, strict=True))
            phi = attitude_error(jnp.asarray(q), jnp.broadcast_to(reference, q.shape))
            out[label] = Calibration(np.asarray(phi), covariance)
    jax.clear_caches()  # the programs of all cases are more than a process may map
    return out


@eqx.filter_jit
def _solved(method: Any, made: Scenario, intervals: Any, keys: Any) -> tuple[Any, Any]:
    """Attitudes at the end and their covariances."""
    imu = made.imu.at_rate(made.imu_rate)

    def one(key: Any) -> tuple[Any, Any]:
        measured, drawn = jax.random.split(key)
        epochs = measure_epochs(intervals, made, measured)
        last = len(epochs) - 1
        found = method.solve(epochs, last)
        if method.has_covariance:
            assert found.covariance is not None
            return found.q_nb[-1], found.covariance[-1]
        return found.q_nb[-1], ensemble_covariance(method, epochs, imu, found, last, DRAWS, drawn)[-1]

    return jax.lax.map(one, keys)


def calibration_table(found: dict[str, dict[str, Calibration]]) -> Table:
    """Rows of recipes and cases."""
    columns = ("recipe", "case", "runs", "NEES / 3", "95 % interval covers: east %", "north %", "heading %")
    table = Table("calibration", columns)
    names = list(dict.fromkeys(name for of in found.values() for name in of))
    for name in names:
        for case, of in found.items():
            if name in of:
                one = of[name]
                table.add(name, case, len(one.phi), one.nees, *(float(100 * x) for x in one.covered))
    return table
