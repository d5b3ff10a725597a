"""The robust batch estimator: the most probable attitude, first velocity and biases, with outliers among the fixes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, Literal, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxalign.batch.fix import PARTS, parts_of
from jaxalign.batch.iterate import LANES, Found, on_host, traced
from jaxalign.batch.solver import Model, Problem
from jaxalign.epochs import Aid, Epoch, Epochs, row_numbers
from jaxalign.errors import UserError
from jaxalign.inertial_unit import ImuErrors
from jaxalign.method import AbstractMethod
from jaxalign.observe.options import check_choice, check_count, check_interval, optional_count
from jaxalign.parametrization import tunable
from jaxalign.precision import require_x64
from jaxalign.solution import FilterRecord, Solution, status_bits

__all__ = ["FEWEST_FIXES", "RobustMap"]

FEWEST_FIXES = 3
"""That an attitude takes."""
_DEG = np.deg2rad(1.0)
_BLIND = 20.0 * _DEG
_MOST_ITERATIONS = 1000


class RobustMap(AbstractMethod):
    """The most probable attitude by all fixes up to an epoch, with outliers.

    Unknown are attitude, first velocity, the biases of the inertial unit (with priors) and its white noise. The noise
    of a fix is normal, or with a small probability normal with a much larger standard deviation: each fix counts by the
    probability that it is none of those, found together with the rest (iterated reweighting). One Gauss-Newton step is
    a Kalman filter, a disturbance smoother and a pass forward over the errors of a trajectory with a state at every
    epoch. Derivatives are those of a solution that has converged.

    A standing vehicle has the velocity zero; the noise is then its disturbance, and the stated figure (of the force
    over an interval, ``Epochs.aid_sd``) the least of it.

    In its solutions ``aid_sd`` is the noise found (white noise with the same density at low frequencies), ``residual``
    the noise of the fix of that row, and ``filter.covariance`` that of the best solution, where there are several.

    Attributes:
        imu: figures of the inertial unit.
        outliers: probability of an outlier beforehand.
        spread: standard deviation of outliers over that of the others.
        noise: standard deviation of the aid. "at_least" (default): the stated one, or that of the data where it is
            larger; "estimated": that of the data, the stated one being worth a few fixes; "stated": as it is. Data tell
            of white noise alone: where a stated figure covers slow errors too, the estimate is too small.
        calibrate: unknowns of the aid too: "none" (default), "mounting" (scale factor and misalignment of a body aid),
            "latency" (its velocities are of some time ago), "lever" (it is not where the inertial unit is), "slow" (an
            error of its velocity that fades and renews itself), or some of them: "latency+lever".
        scale_sd: of the scale factor beforehand.
        mounting_sd_deg: of each angle of the misalignment beforehand.
        latency_sd: of the latency beforehand, s. It is resolved to a fraction of the interval between epochs.
        lever_sd: of each component of the lever arm beforehand, m.
        slow_sd: of each component of the slow error, m/s.
        slow_time: after which it has renewed itself, s.
        starts: headings to start from. 1 (default): the one found without a guess. 4 for low-cost units, whose biases
            may hide the turn of the Earth: more than one heading may fit, and the covariance has them all in mind.
        iterations: Gauss-Newton steps, at most; fewer where it has converged. Up to 1000.
        tolerance: it has converged where a step moves it by less, in standard deviations, and the noise by less of
            itself. Derivatives hold to about a hundred times as much; with a navigation aid, those of the covariance
            and of the likelihood are approximate: they leave out how the velocities that are taken for steady depend on
            the gains of the filter.
        aid: that it observes.
        interval_samples: IMU samples per epoch; None: as the log has it.

    Source: none of the papers.
    """

    has_covariance: ClassVar[bool] = True
    rows_are_costly: ClassVar[bool] = True
    finds_noise: ClassVar[bool] = True
    judges_by_covariance: ClassVar[bool] = True
    needs: ClassVar[str] = "three usable fixes"
    prefilter: ClassVar[None] = None
    imu: ImuErrors = eqx.field(default_factory=ImuErrors)
    outliers: Float[Array, ""] = tunable(0.05, unit="1", bounds=(1e-4, 0.5))
    spread: Float[Array, ""] = tunable(30.0, unit="1", bounds=(3.0, 1e3))
    scale_sd: Float[Array, ""] = tunable(0.005, unit="1", bounds=(1e-6, 0.1))
    mounting_sd_deg: Float[Array, ""] = tunable(1.0, unit="deg", bounds=(1e-4, 10.0))
    latency_sd: Float[Array, ""] = tunable(0.1, unit="s", bounds=(1e-4, 5.0))
    noise: Literal["at_least", "estimated", "stated"] = eqx.field(static=True, default="at_least")
    lever_sd: Float[Array, ""] = tunable(1.0, unit="m", bounds=(1e-3, 1e3))
    slow_sd: Float[Array, ""] = tunable(0.005, unit="m/s", bounds=(1e-6, 10.0))
    slow_time: Float[Array, ""] = tunable(300.0, unit="s", bounds=(1.0, 1e6))
    calibrate: str = eqx.field(static=True, default="none")
    starts: int = eqx.field(static=True, default=1)
    iterations: int = eqx.field(static=True, default=12)
    tolerance: float = eqx.field(static=True, default=1e-5)
    aid: Aid = eqx.field(static=True, default="body", metadata={"given": True})
    interval_samples: int | None = optional_count()

    def __check_init__(self):
        check_choice("noise", self.noise, ("at_least", "estimated", "stated"))
        check_choice("aid", self.aid, ("body", "nav", "static"))
        check_interval(self.interval_samples, "interval_samples")
        for name in ("starts", "iterations"):
            check_count(name, getattr(self, name))
        if self.iterations > _MOST_ITERATIONS:
            raise UserError(f"iterations = {self.iterations}: at most {_MOST_ITERATIONS}; 12 do for nearly all logs")
        if not 0 < self.tolerance < 1:
            raise UserError(f"tolerance = {self.tolerance}: must be above 0 and below 1")
        parts = [] if self.calibrate == "none" else str(self.calibrate).split("+")
        if not set(parts) <= set(PARTS) or len(set(parts)) < len(parts):
            raise UserError(
                f"calibrate = {self.calibrate!r}: must be none, or some of {', '.join(PARTS)}, each once, joined by +"
            )
        if "mounting" in self.unknowns and self.aid != "body":
            raise UserError("calibrate: scale and misalignment are those of a body aid: leave mounting out")
        if self.unknowns and self.aid == "static":
            raise UserError("calibrate: a standing vehicle has no aid to calibrate")

    @property
    def unknowns(self) -> dict[str, slice]:
        """Where in ``Solution.filter.calibration`` the unknowns of the aid are, by name."""
        return parts_of(tuple(self.calibrate.split("+")))

    @property
    def model(self) -> Model:
        """What it knows beforehand, without what does not change a step."""
        known = {
            "mounting": [self.scale_sd, *[_number(self.mounting_sd_deg) * _DEG] * 3],
            "latency": [self.latency_sd],
            "lever": [self.lever_sd] * 3,
            "slow": [self.slow_sd] * 3,
        }
        names = tuple(self.unknowns)
        sd = [x for name in names for x in known[name]]
        fade = [self.slow_time if name == "slow" else jnp.inf for name in names for _ in known[name]]
        sd, fade, limit = _stacked(sd), _stacked(fade), np.float64(self.tolerance)
        return Model(self.imu, self.outliers, self.spread, sd, fade, limit, names, self.noise, self.aid)

    def with_imu(self, imu: ImuErrors) -> Self:
        """With these figures of the inertial unit."""
        return dataclasses.replace(self, imu=imu)

    def counted(self, solution: Solution) -> np.ndarray:
        """(K,) rows whose fix is rather none of the outliers, which keep a little weight."""
        return np.asarray(solution.defined) & (np.asarray(solution.weight) > 0.5)

    def solve(self, epochs: Epochs, rows: Any = 1, done: Callable[[int], None] | None = None) -> Solution:
        """Align epochs, each row by the fixes up to it.

        Args:
            epochs: of one log.
            rows: epochs between two rows, see :func:`jaxalign.align`, or the numbers of the epochs to read out.
            done: told how many rows are finished, now and then; not inside traced code.

        Raises:
            UserError: float32, rows that are no epochs.
        """
        require_x64(epochs)
        numbers = row_numbers(len(epochs), rows)
        if any(isinstance(x, Tracer) for x in jax.tree.leaves((self, epochs))):
            return _assembled(self, epochs.rows, numbers, _rows_of(self, epochs, numbers))
        lanes = min(LANES, 1 << (len(numbers) - 1).bit_length())
        with jax.ensure_compile_time_eval():  # inside traced code too, where both are constants
            found = on_host(self.model, epochs, numbers, self.iterations, self.starts, lanes=lanes, done=done)
            return _assembled(self, epochs.rows, numbers, found)

    def solve_runs(self, epochs: Epochs, rows: Any = 1) -> Solution:
        """Align many runs side by side: leaves of ``epochs.rows`` that differ have the runs on the last axis. Pure.

        The same as ``jax.vmap`` of :meth:`solve` over that axis, faster.

        Returns:
            A solution whose leaves have the runs on a first axis.

        Raises:
            UserError: float32, rows that are no epochs, epochs of one log.
        """
        require_x64(epochs)
        if epochs.rows.dvel.x.ndim != 2:
            raise UserError("these are the epochs of one log: solve_runs takes runs on the last axis, solve one log")
        numbers = row_numbers(len(epochs), rows)
        return _runs_of(self, epochs, numbers)


def _number(x: Any) -> Any:
    """On the host without a program of its own for what is done with it."""
    return x if isinstance(x, Tracer) else np.float64(x)


def _stacked(numbers: list[Any]) -> Any:
    """(n,); on the host without a program of its own for a few numbers."""
    if any(isinstance(x, Tracer) for x in numbers):
        return jnp.stack([jnp.asarray(x, jnp.float64) for x in numbers])
    return np.array([float(x) for x in numbers], np.float64)


def _rows_of(method: RobustMap, epochs: Epochs, numbers: np.ndarray) -> Found:
    """Rows of one log as lanes, a group at a time."""
    one = jax.tree.map(lambda x: x[:, None], epochs.rows)

    def group(last: Any) -> Found:
        return traced(method.model, Problem(one, epochs.site, epochs.aid_sd, last), method.iterations, method.starts)

    if len(numbers) <= 2 * LANES:
        return group(jnp.asarray(numbers))
    index = np.minimum(np.arange(-(-len(numbers) // LANES) * LANES), len(numbers) - 1)
    found = jax.lax.map(group, jnp.asarray(numbers[index].reshape(-1, LANES)))
    joined = jax.tree.map(lambda x: jnp.moveaxis(x, 0, -2).reshape(*x.shape[1:-1], index.size), found)
    return jax.tree.map(lambda x: x[..., : len(numbers)], joined)


def _runs_of(method: RobustMap, epochs: Epochs, numbers: np.ndarray) -> Solution:
    """Runs as lanes, and rows beside them where there are few runs; a group at a time.

    The same row of many runs: they need about as many steps, and nothing of what comes later.
    """
    runs, count = epochs.rows.dvel.x.shape[-1], len(numbers)
    together = min(runs, LANES)
    beside = min(count, max(1, LANES // together))
    of_runs, of_rows = (
        np.minimum(np.arange(-(-n // size) * size), n - 1).reshape(-1, size)
        for n, size in ((runs, together), (count, beside))
    )

    def group(some: Any) -> Found:
        chosen, lasts = some

        def lanes(x: Any) -> Any:
            if x.ndim == 1:
                return x[:, None]
            return jnp.broadcast_to(x[:, chosen][:, :, None], (len(x), together, beside)).reshape(len(x), -1)

        problem = Problem(jax.tree.map(lanes, epochs.rows), epochs.site, epochs.aid_sd, jnp.tile(lasts, together))
        found = traced(method.model, problem, method.iterations, method.starts)
        return jax.tree.map(lambda x: jnp.moveaxis(x.reshape(*x.shape[:-1], together, beside), -2, 0), found)

    pairs = np.repeat(of_runs, len(of_rows), axis=0), np.tile(numbers[of_rows], (len(of_runs), 1))
    found = jax.lax.map(group, jax.tree.map(jnp.asarray, pairs))

    def by_run(x: Any) -> Any:
        """(groups, runs, ..., rows) of each to (runs, ..., rows) of all."""
        x = jnp.moveaxis(x.reshape(len(of_runs), len(of_rows), *x.shape[1:]), 1, -2)
        return x.reshape(of_runs.size, *x.shape[2:-2], of_rows.size)[:runs, ..., :count]

    rows = jax.tree.map(lambda x: x.T if x.ndim > 1 else jnp.broadcast_to(x, (runs, len(x))), epochs.rows)
    return jax.vmap(lambda rows, found: _assembled(method, rows, numbers, found))(rows, jax.tree.map(by_run, found))


def _assembled(method: RobustMap, rows: Epoch, numbers: np.ndarray, found: Found) -> Solution:
    """Rows on the first axis, and what to say of each; on the host with NumPy, to compile nothing."""
    given = rows.dt, rows.valid, found
    xp = jnp if any(isinstance(x, Tracer) for x in jax.tree.leaves(given)) else np
    dt, valid, (read, alpha, beta) = jax.tree.map(xp.asarray, given)
    read, alpha, beta = jax.tree.map(lambda x: xp.moveaxis(x, -1, 0), (read, alpha, beta))
    finite = xp.all(xp.isfinite(read.q_nb), axis=1) & xp.all(xp.isfinite(read.tilt), axis=(1, 2))
    defined = finite & (xp.cumsum(valid)[numbers] >= FEWEST_FIXES)
    observable = defined & (read.tilt[:, 2, 2] < _BLIND**2)
    bits = status_bits(defined=defined, observable=observable, aided=valid[numbers], finite=finite, xp=xp)

    def masked(x: Any) -> Any:
        return xp.where(defined.reshape(-1, *[1] * (x.ndim - 1)), x, 0.0)

    record = {
        "gyro_bias": masked(read.gyro),
        "accel_bias": masked(read.accel),
        "covariance": masked(read.covariance),
        "log_likelihood": masked(read.log_likelihood),
        "calibration": masked(read.unknowns) if method.unknowns else None,
    }
    q_nb = xp.where(read.q_nb[:, :1] < 0, -read.q_nb, read.q_nb)
    rows_of = {
        "time": xp.cumsum(dt)[numbers],
        "q_nb": xp.where(defined[:, None], q_nb, xp.asarray([1.0, 0.0, 0.0, 0.0])),
        "defined": defined,
        "observable": observable,
        "eigengap": xp.zeros(len(numbers)),
        "residual": masked(read.residual),
        "weight": read.weight,
        "alpha": alpha,
        "beta": beta,
        "covariance": masked(read.tilt),
        "status": bits,
        "aid_sd": read.aid_sd,
    }
    if xp is np:
        rows_of, record = jax.device_put((rows_of, record), _device(rows))
    return Solution(**rows_of, filter=FilterRecord(**record))


def _device(rows: Epoch) -> Any:
    """Where the epochs must stay; None: anywhere."""
    kept = [x for x in jax.tree.leaves(rows) if isinstance(x, jax.Array) and x.committed]
    return kept[0].sharding if kept else None
