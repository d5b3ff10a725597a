"""The robust batch estimator: the most probable attitude, first velocity and biases, with outliers among the fixes."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.aligner import align
from jaxalign.batch.imu import ImuErrors
from jaxalign.batch.model import ACCEL, GYRO, SPEED, TILT, UNKNOWN, Guess, Path, navigated
from jaxalign.batch.modes import best_of, turned, turns
from jaxalign.batch.smoother import Filtered, Measured, Prior, filtered, fixes, settled, smoothed
from jaxalign.batch.start import misfit, robust_start, views
from jaxalign.epochs import Aid, Epochs, epochs_from_log
from jaxalign.errors import UserError
from jaxalign.log import Log
from jaxalign.observe.options import check_choice, check_count, check_interval, optional_count
from jaxalign.parameters import tunable
from jaxalign.solution import FilterRecord, Solution, Status
from jaxalign.vector import Quat, Vec3, where

__all__ = ["RobustMap"]

_FREE = 1e3  # times the noise of a fix: nothing is known of the first velocity, and nothing lost to rounding
_LEAST = 1e-12  # weight
_BELIEF = 6.0  # numbers that the stated noise of the aid is worth
_FITTED = 8.0  # numbers that the attitude, the first velocity and what is seen of the biases take up
_LONGEST = 0.95  # correlation of neighbouring fixes
_PARTS = {"mounting": 4, "latency": 1, "lever": 3}  # in the order of their unknowns
_MEDIAN = 2.366  # of the squared length of a normal vector
_FEWEST = 3  # fixes
_BLIND = np.deg2rad(20.0)


class _State(eqx.Module):
    """Between two steps: the path's start, unknowns of the aid, what is thought of each fix, velocities (n0)."""

    guess: Guess
    calibration: Array
    weight: Array
    variance: Array
    times: Array
    smooth: Vec3 | None


class _Found(eqx.Module):
    """A solution at an epoch."""

    q_nb: Array
    tilt: Array
    told: FilterRecord
    residual: Array
    weight: Array
    aid_sd: Array
    guess: Guess


class RobustMap(eqx.Module):
    """The most probable attitude by all fixes up to an epoch, with outliers.

    Unknown are attitude, first velocity, the biases of the inertial unit (with priors) and its white noise. The noise
    of a fix is normal, or with a small probability normal with a much larger standard deviation: each fix counts by the
    probability that it is none of those, found together with the rest (iterated reweighting). One Gauss-Newton step is
    a Kalman filter forth and a smoother back over the errors of a navigated path. Derivatives hold where it has
    converged.

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
            "latency" (its velocities are of some time ago), "lever" (it is not where the inertial unit is), or some of
            them: "latency+lever".
        scale_sd: of the scale factor beforehand.
        mounting_sd_deg: of each angle of the misalignment beforehand.
        latency_sd: of the latency beforehand, s. It is resolved to a fraction of the interval between epochs.
        lever_sd: of each component of the lever arm beforehand, m.
        starts: headings to start from. 1 (default): the one found without a guess. 4 for low-cost units, whose biases
            may hide the turn of the Earth: more than one heading may fit, and the covariance has them all in mind.
        iterations: Gauss-Newton steps.
        aid: that it observes.
        interval_samples: IMU samples per epoch; None: as the log has it.

    Source: none of the papers.
    """

    has_covariance: ClassVar[bool] = True
    imu: ImuErrors = eqx.field(default_factory=ImuErrors)
    outliers: Float[Array, ""] = tunable(0.05, unit="1", bounds=(1e-4, 0.5))
    spread: Float[Array, ""] = tunable(30.0, unit="1", bounds=(3.0, 1e3))
    scale_sd: Float[Array, ""] = tunable(0.005, unit="1", bounds=(1e-6, 0.1))
    mounting_sd_deg: Float[Array, ""] = tunable(1.0, unit="deg", bounds=(1e-4, 10.0))
    latency_sd: Float[Array, ""] = tunable(0.1, unit="s", bounds=(1e-4, 5.0))
    noise: Literal["at_least", "estimated", "stated"] = eqx.field(static=True, default="at_least")
    lever_sd: Float[Array, ""] = tunable(1.0, unit="m", bounds=(1e-3, 1e3))
    calibrate: str = eqx.field(static=True, default="none")
    starts: int = eqx.field(static=True, default=1)
    iterations: int = eqx.field(static=True, default=8)
    aid: Aid = eqx.field(static=True, default="body", metadata={"given": True})
    interval_samples: int | None = optional_count()

    def __check_init__(self):
        check_choice("noise", self.noise, ("at_least", "estimated", "stated"))
        check_interval(self.interval_samples, "interval_samples")
        for name in ("starts", "iterations"):
            check_count(name, getattr(self, name))
        parts = [] if self.calibrate == "none" else str(self.calibrate).split("+")
        if not set(parts) <= set(_PARTS) or len(set(parts)) < len(parts):
            raise UserError(
                f"calibrate = {self.calibrate!r}: must be none, or some of {', '.join(_PARTS)}, each once, joined by +"
            )
        if "mounting" in self.unknown and self.aid != "body":
            raise UserError("calibrate: scale and misalignment are those of a body aid: leave mounting out")
        if self.unknown and self.aid == "static":
            raise UserError("calibrate: a standing vehicle has no aid to calibrate")

    @property
    def unknown(self) -> dict[str, slice]:
        """Where in ``Solution.filter.calibration`` the unknowns of the aid are, by name."""
        out, end = {}, 0
        for name, size in _PARTS.items():
            if name in self.calibrate.split("+"):
                out[name] = slice(end, end + size)
                end += size
        return out

    def epochs(self, log: Log) -> Epochs:
        """Preintegrate a log for this method."""
        return epochs_from_log(log, interval_samples=self.interval_samples, static=self.aid == "static")

    def solve(self, epochs: Epochs, every: int = 1) -> Solution:
        """Align epochs; rows as :func:`jaxalign.align` has them, each by the fixes up to it."""
        return _jitted(self, epochs, every)

    def align(self, log: Log | Epochs, every: int = 1) -> Solution:
        """See :func:`jaxalign.align`."""
        return align(self, log, every)

    def _prior(self, state: _State, stated: Any) -> Prior:
        guess, calibration = state.guess, state.calibration
        noise = jnp.sqrt(jnp.maximum(stated**2, jax.lax.stop_gradient(state.variance)))
        imu, mounting = self.imu, jnp.deg2rad(self.mounting_sd_deg)
        parts = [(3, UNKNOWN), (3, _FREE * noise), (3, imu.gyro_bias), (3, imu.accel_bias)]
        mean = [jnp.zeros(6), -guess.gyro.array, -guess.accel.array]
        known = {
            "mounting": [(1, self.scale_sd), (3, mounting)],
            "latency": [(1, self.latency_sd)],
            "lever": [(3, self.lever_sd)],
        }
        for name in self.unknown:
            parts += known[name]
        mean.append(-calibration)
        sd = jnp.concatenate([jnp.full(n, 1.0) * x for n, x in parts])
        return Prior(jnp.concatenate(mean), sd**2)

    def _weighed(self, noise: Any, variance: Any, used: Any) -> tuple[Any, Any]:
        """Probability that each fix is no outlier, and its weight."""
        square = jnp.sum(noise**2, axis=1) / variance
        wide = self.spread**2
        odds = jnp.log((1 - self.outliers) / self.outliers) + 1.5 * jnp.log(wide) - 0.5 * square * (1 - 1 / wide)
        good = jnp.where(used, jax.nn.sigmoid(odds), 0.0)
        return good, good + (1 - good) / wide

    def _persistence(self, noise: Any, good: Any, variance: Any) -> Any:
        """How many times the noise of a fix counts because its neighbours share it: (1 + r) / (1 - r).

        r is the correlation of neighbouring fixes, never taken for negative; white noise with the variance so enlarged
        has the same density at low frequencies, where the attitude is.
        """
        pair = (good[1:] * good[:-1])[:, None]
        shared = jnp.sum(pair * noise[1:] * noise[:-1])
        own = 0.5 * jnp.sum(pair * (noise[1:] ** 2 + noise[:-1] ** 2))
        r = jnp.clip(shared / (own + _BELIEF * variance), 0.0, _LONGEST)
        return (1.0 + r) / (1.0 - r)

    def _scaled(self, noise: Any, used: Any, stated: Any) -> Any:
        """Variance of the noise by its median, which a half of outliers does not move."""
        square = jnp.sort(jnp.where(used, jnp.sum(noise**2, axis=1), jnp.inf))
        middle = square[jnp.maximum(jnp.sum(used) - 1, 0) // 2] / _MEDIAN
        return jnp.maximum(jnp.where(jnp.any(used), middle, 0.0), stated**2)

    def _estimated(self, noise: Any, good: Any, stated: Any) -> tuple[Any, Any]:
        """Variance of the noise and how many times it counts, by the fixes that are no outliers."""
        if self.noise == "stated":
            return stated**2, jnp.ones(())
        squares = jnp.sum(good[:, None] * noise**2)
        count = jnp.maximum(3 * jnp.sum(good) - _FITTED, 0.0)
        variance = (_BELIEF * stated**2 + squares) / (_BELIEF + count)
        if self.noise == "at_least":
            variance = jnp.maximum(variance, stated**2)
        return variance, self._persistence(noise, good, variance)

    def _measured(self, epochs: Epochs, used: Any, path: Path, state: _State, smooth: Vec3 | None) -> Measured:
        unknown = {name: state.calibration[where] for name, where in self.unknown.items()}
        return fixes(path, epochs.rows.velocity, used, self.aid, smooth=smooth, **unknown)

    def _solved(self, epochs: Epochs, used: Any, last: Any, stated: Any, state: _State) -> Any:
        """One Gauss-Newton step but for taking it: path, measurements, their variances, prior, filter."""
        path = navigated(epochs, state.guess).until(last)
        measured = self._measured(epochs, used, path, state, state.smooth)
        each = state.variance * state.times / jnp.where(used, jnp.maximum(state.weight, _LEAST), 1.0)
        prior = self._prior(state, stated)
        return path, measured, each, prior, filtered(path, measured, each, self.imu, prior)

    def _log_likelihood(self, found: Filtered, prior: Prior, used: Any, state: _State) -> Any:
        """Of the mixture, the first velocity being free: without its prior, with the odds of the outliers."""
        wide = self.spread**2
        bad = jnp.where(used, 1.0 - (state.weight - 1.0 / wide) / (1.0 - 1.0 / wide), 0.0)
        odds = jnp.sum(bad) * jnp.log(self.outliers / (1.0 - self.outliers))
        return found.log_likelihood + 0.5 * jnp.sum(jnp.log(prior.variance[SPEED])) + odds

    def _iterated(self, epochs: Epochs, used: Any, last: Any, stated: Any, state: _State) -> _Found:
        """From a start to a solution."""

        def step(state: _State, count: Any) -> tuple[_State, Any]:
            path, measured, each, prior, found = self._solved(epochs, used, last, stated, state)
            error, noise = smoothed(path, measured, each, prior, found)
            # While biases are still in the misfit a mean square would take them for noise, and keep them there.
            early = count < self.iterations // 2
            variance = jnp.where(early, self._scaled(noise, used, stated), state.variance)
            good, weight = self._weighed(noise, variance, used)
            late, times = self._estimated(noise, good, stated)
            new = _State(
                state.guess.moved(error),
                state.calibration + error[12:],
                weight,
                jnp.where(early, variance, late),
                jnp.where(early, 1.0, times),
                None if state.smooth is None else path.velocity + Vec3.of(measured.gap - noise),
            )
            return new, noise[last]

        state, noise = jax.lax.scan(step, state, jnp.arange(self.iterations))
        path, measured, each, prior, found = self._solved(epochs, used, last, stated, state)
        error, covariance = found.mean[0], found.covariance[0]
        if state.smooth is not None:
            smooth = settled(state.smooth, measured, each, found)
            surer = self._measured(epochs, used, path, state, smooth)
            covariance = filtered(path, surer, each, self.imu, prior).covariance[0]
        at = jax.tree.map(lambda x: x[last], path)
        q_n0b = (Quat.exp(Vec3.of(error[TILT])) * at.q_n0b).unit()
        turn = at.q_n0n.matrix.array
        told = FilterRecord(
            state.guess.gyro.array + error[GYRO],
            state.guess.accel.array + error[ACCEL],
            covariance,
            log_likelihood=self._log_likelihood(found, prior, used, state),
            calibration=state.calibration + error[12:],
        )
        return _Found(
            (at.q_n0n.conjugate() * q_n0b).unit().array,
            turn.T @ covariance[TILT, TILT] @ turn,
            told,
            noise[-1],
            jnp.where(used[last], state.weight[last], 0.0),
            jnp.sqrt(state.variance * state.times),
            state.guess,
        )

    def until(self, epochs: Epochs, seen: tuple[Vec3, Vec3], last: Any) -> _Found:
        """The solution by the fixes up to the epoch ``last``. Pure."""
        used = epochs.rows.valid & (jnp.arange(len(epochs)) <= last)
        stated = jnp.maximum(epochs.aid_sd, 1e-6)
        guess = jax.lax.stop_gradient(robust_start(*seen, used, 1e-6, self.aid)[0])
        off = misfit(*seen, guess, self.aid)
        variance = jax.lax.stop_gradient(self._scaled(off.array, used, stated))
        _, weight = self._weighed(off.array, variance, used)
        calibration = jnp.zeros(sum(_PARTS[name] for name in self.unknown))
        smooth = navigated(epochs, guess).velocity if self.aid == "nav" else None
        state = _State(guess, calibration, jax.lax.stop_gradient(weight), variance, jnp.ones(()), smooth)
        first = self._iterated(epochs, used, last, stated, state)
        if self.starts == 1:
            return first

        def again(angle: Any) -> _Found:
            start = dataclasses.replace(state, guess=turned(first.guess, angle, self.aid))
            return self._iterated(epochs, used, last, stated, start)

        others = jax.lax.map(again, jnp.asarray(turns(self.starts)))
        every = jax.tree.map(lambda x, more: jnp.concatenate([x[None], more]), first, others)
        best, tilt = best_of(every.q_nb, every.tilt, every.told.log_likelihood)
        return dataclasses.replace(jax.tree.map(lambda x: x[best], every), tilt=tilt)


@eqx.filter_jit
def _jitted(method: RobustMap, epochs: Epochs, every: int) -> Solution:
    count = len(epochs)
    rows = np.unique([*range(0, count, every), count - 1])
    alpha, beta = views(epochs)
    found = jax.lax.map(lambda last: method.until(epochs, (alpha, beta), last), jnp.asarray(rows))
    finite = jnp.all(jnp.isfinite(found.q_nb), axis=1) & jnp.all(jnp.isfinite(found.tilt), axis=(1, 2))
    fixes_so_far = jnp.cumsum(epochs.rows.valid)[rows]
    defined = finite & (fixes_so_far >= _FEWEST)
    observable = defined & (found.tilt[:, 2, 2] < _BLIND**2)
    bits = (
        (~defined, Status.UNDEFINED),
        (~observable, Status.HEADING_UNOBSERVABLE),
        (~epochs.rows.valid[rows], Status.AID_MISSING),
        (~finite, Status.NON_FINITE),
    )
    status = sum((jnp.where(c, jnp.int32(int(b)), 0) for c, b in bits), jnp.zeros(len(rows), jnp.int32))

    def masked(x: Any) -> Any:
        return jnp.where(defined.reshape(-1, *[1] * (x.ndim - 1)), x, 0.0)

    told = jax.tree.map(masked, found.told)
    return Solution(
        time=jnp.cumsum(epochs.rows.dt)[rows],
        q_nb=where(defined, Quat.of(found.q_nb).positive(), Quat.identity()).array,
        defined=defined,
        observable=observable,
        eigengap=jnp.zeros(len(rows)),
        residual=masked(found.residual),
        weight=found.weight,
        alpha=alpha.array[rows],
        beta=beta.array[rows],
        covariance=masked(found.tilt),
        status=status,
        aid_sd=found.aid_sd,
        filter=told if method.calibrate != "none" else dataclasses.replace(told, calibration=None),
    )
