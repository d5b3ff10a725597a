"""The robust batch estimator: the most probable attitude, first velocity and biases, with outliers among the fixes."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.aligner import align
from jaxalign.batch.imu import ImuErrors
from jaxalign.batch.model import ACCEL, GYRO, SPEED, TILT, UNKNOWN, Guess, navigated
from jaxalign.batch.smoother import Prior, filtered, fixes, smoothed
from jaxalign.batch.start import robust_start, views
from jaxalign.epochs import Aid, Epochs, epochs_from_log
from jaxalign.errors import UserError
from jaxalign.log import Log
from jaxalign.observe.options import check_choice, check_interval, optional_count
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
_BLIND = np.deg2rad(20.0)


class RobustMap(eqx.Module):
    """The most probable attitude by all fixes up to an epoch, with outliers.

    Unknown are attitude, first velocity, the biases of the inertial unit (with priors) and its white noise. The noise
    of a fix is normal, or with a small probability normal with a much larger standard deviation: each fix counts by the
    probability that it is none of those, found together with the rest (iterated reweighting). One Gauss-Newton step is
    a Kalman filter forth and a smoother back over the errors of a navigated path.

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
    iterations: int = eqx.field(static=True, default=8)
    aid: Aid = eqx.field(static=True, default="body", metadata={"given": True})
    interval_samples: int | None = optional_count()

    def __check_init__(self):
        check_choice("noise", self.noise, ("at_least", "estimated", "stated"))
        check_interval(self.interval_samples)
        if self.calibrate != "none":
            for part in self.calibrate.split("+"):
                check_choice("calibrate", part, _PARTS)
        if "mounting" in self._unknown and self.aid != "body":
            raise UserError("calibrate: scale and misalignment are those of a body aid: leave mounting out")
        if self._unknown and self.aid == "static":
            raise UserError("calibrate: a standing vehicle has no aid to calibrate")

    @property
    def _unknown(self) -> dict[str, slice]:
        """Where the unknowns of the aid are, by name."""
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

    def _prior(self, guess: Guess, calibration: Any, stated: Any) -> Prior:
        imu, mounting = self.imu, jnp.deg2rad(self.mounting_sd_deg)
        parts = [(3, UNKNOWN), (3, _FREE * stated), (3, imu.gyro_bias), (3, imu.accel_bias)]
        mean = [jnp.zeros(6), -guess.gyro.array, -guess.accel.array]
        known = {
            "mounting": [(1, self.scale_sd), (3, mounting)],
            "latency": [(1, self.latency_sd)],
            "lever": [(3, self.lever_sd)],
        }
        for name in self._unknown:
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

    def until(self, epochs: Epochs, seen: tuple[Vec3, Vec3], last: Any) -> dict[str, Any]:
        """The solution by the fixes up to the epoch ``last``. Pure."""
        used = epochs.rows.valid & (jnp.arange(len(epochs)) <= last)
        stated = jnp.maximum(epochs.aid_sd, 1e-6)
        guess, weight, scale = jax.lax.stop_gradient(robust_start(*seen, used, 1e-6, self.aid))
        variance = stated**2
        if self.noise != "stated":
            variance = jnp.maximum(variance, scale**2)
        calibration = jnp.zeros(sum(_PARTS[name] for name in self._unknown))

        def solved(state: Any) -> Any:
            guess, calibration, weight, variance, times = state
            path = navigated(epochs, guess).until(last)
            unknown = {name: calibration[where] for name, where in self._unknown.items()}
            measured = fixes(path, epochs.rows.velocity, used, self.aid, **unknown)
            each = variance * times / jnp.where(used, jnp.maximum(weight, _LEAST), 1.0)
            prior = self._prior(guess, calibration, stated)
            return path, measured, each, prior, filtered(path, measured, each, self.imu, prior)

        def step(state: Any, _: Any) -> Any:
            guess, calibration, weight, variance, times = state
            path, measured, each, prior, found = solved(state)
            error, noise = smoothed(path, measured, each, prior, found)
            good, weight = self._weighed(noise, variance, used)
            if self.noise != "stated":
                squares = jnp.sum(good[:, None] * noise**2)
                count = jnp.maximum(3 * jnp.sum(good) - _FITTED, 0.0)
                variance = (_BELIEF * stated**2 + squares) / (_BELIEF + count)
                if self.noise == "at_least":
                    variance = jnp.maximum(variance, stated**2)
                times = self._persistence(noise, good, variance)
            return (guess.moved(error), calibration + error[12:], weight, variance, times), noise

        state, noise = jax.lax.scan(
            step, (guess, calibration, weight, variance, jnp.ones(())), None, length=self.iterations
        )
        guess, calibration, weight, variance, times = state
        path, _, _, _, found = solved(state)
        error, covariance = found.mean[0], found.covariance[0]
        at = jax.tree.map(lambda x: x[last], path)
        q_n0b = (Quat.exp(Vec3.of(error[TILT])) * at.q_n0b).unit()
        turned = at.q_n0n.matrix.array
        tilt = turned.T @ covariance[TILT, TILT] @ turned
        return {
            "q_nb": (at.q_n0n.conjugate() * q_n0b).unit(),
            "tilt": tilt,
            "gyro": guess.gyro.array + error[GYRO],
            "accel": guess.accel.array + error[ACCEL],
            "calibration": calibration + error[12:],
            "covariance": covariance,
            "likelihood": found.log_likelihood,
            "residual": noise[-1][last],
            "weight": jnp.where(used[last], weight[last], 0.0),
            "aid_sd": jnp.sqrt(variance * times),
            "fixes": jnp.sum(used),
            "speed": at.velocity.array + error[SPEED],
        }


@eqx.filter_jit
def _jitted(method: RobustMap, epochs: Epochs, every: int) -> Solution:
    count = len(epochs)
    rows = np.unique([*range(0, count, every), count - 1])
    alpha, beta = views(epochs)
    found = jax.lax.map(lambda last: method.until(epochs, (alpha, beta), last), jnp.asarray(rows))
    finite = jnp.all(jnp.isfinite(found["q_nb"].array), axis=1) & jnp.all(jnp.isfinite(found["tilt"]), axis=(1, 2))
    defined = finite & (found["fixes"] >= 3)
    observable = defined & (found["tilt"][:, 2, 2] < _BLIND**2)
    bits = (
        (~defined, Status.UNDEFINED),
        (~observable, Status.HEADING_UNOBSERVABLE),
        (~epochs.rows.valid[rows], Status.AID_MISSING),
        (~finite, Status.NON_FINITE),
    )
    status = sum((jnp.where(c, jnp.int32(int(b)), 0) for c, b in bits), jnp.zeros(len(rows), jnp.int32))

    def masked(x: Any) -> Any:
        return jnp.where(defined.reshape(-1, *[1] * (x.ndim - 1)), x, 0.0)

    biases = (masked(found[x]) for x in ("gyro", "accel", "covariance"))
    calibration = None if method.calibrate == "none" else masked(found["calibration"])
    return Solution(
        time=jnp.cumsum(epochs.rows.dt)[rows],
        q_nb=where(defined, found["q_nb"].positive(), Quat.identity()).array,
        defined=defined,
        observable=observable,
        eigengap=jnp.zeros(len(rows)),
        residual=masked(found["residual"]),
        weight=found["weight"],
        alpha=alpha.array[rows],
        beta=beta.array[rows],
        covariance=masked(found["tilt"]),
        status=status,
        aid_sd=found["aid_sd"],
        filter=FilterRecord(*biases, log_likelihood=found["likelihood"], calibration=calibration),
    )
