"""The robust batch estimator for a log of which nothing is said: it finds how good the inertial unit is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer, eval_context

from jaxalign.aids import AbstractAid
from jaxalign.batch.iterate import solve_on_host, solve_traced
from jaxalign.batch.problem import Model, Problem
from jaxalign.batch.robust_map import FEWEST_FIXES, RobustMap
from jaxalign.epochs import Epochs
from jaxalign.front_end import FrontEnd
from jaxalign.inertial_unit import GRADES, PER_SAMPLE, AccelErrors, GyroErrors, ImuErrors
from jaxalign.log import Log
from jaxalign.method import AbstractMethod
from jaxalign.precision import require_x64
from jaxalign.solution import Solution

__all__ = ["Auto", "Graded", "is_coarse", "standing_samples", "usual_unknowns"]

_MARGIN = 6.0  # of the log-likelihood: 400 to 1
_STEP, _FINE = 1.0, 0.2  # s, between epochs of a standing vehicle; where biases are large and it may sway
_LEAST = 20  # of them
_COARSE = 1.0  # deg/h: gyroscopes that may hide a part of the Earth's rate
_HEADINGS = 4
_FIGURES = np.array(list(GRADES.values())).T  # (4, grades)


class Graded(NamedTuple):
    """How well each grade of :data:`jaxalign.inertial_unit.GRADES` fits, finest first.

    Attributes:
        likelihood: (G,) logarithm; not finite where there is no solution.
        fixes: epochs at which any aid has a value.
        gyro: (3, G) biases found, rad/s.
        accel: (3, G) m/s^2.
    """

    likelihood: Any
    fixes: Any
    gyro: Any
    accel: Any

    @property
    def number(self) -> Any:
        """Of the finest grade whose likelihood is within a factor of 400 of the best; of few fixes the coarsest."""
        xp = jnp if isinstance(self.likelihood, Tracer) else np
        known = xp.isfinite(self.likelihood)
        best = xp.max(xp.where(known, self.likelihood, -xp.inf))
        told = xp.any(known) & (self.fixes >= FEWEST_FIXES)
        allowed = known & (self.likelihood > best - _MARGIN)
        return xp.where(told, xp.argmax(allowed), len(GRADES) - 1)


class Auto(AbstractMethod):
    """:class:`RobustMap` with the grade of the inertial unit that the data allow.

    The epochs are aligned with each grade of :data:`jaxalign.inertial_unit.GRADES`, and the finest is taken whose
    likelihood is within a factor of 400 of the best: what the data do not speak against. All rows are then aligned with
    this one. With gyroscopes worse than 1 deg/h (a coarse unit) the search starts from four headings. Of a log of a
    standing vehicle it makes epochs of 0.2 s, as a coarse unit needs them; a study has those of its scenario.

    Pure: inside traced code the grade is chosen there; derivatives are those of the grade that is chosen.

    Attributes:
        estimator: that aligns; its ``imu`` is not used. ``headings`` and an interval that are set stay.
        imu: figures of the inertial unit, if they are known; None (default): found.

    Source: none of the papers.
    """

    has_covariance: ClassVar[bool] = RobustMap.has_covariance
    rows_are_costly: ClassVar[bool] = RobustMap.rows_are_costly
    takes_components: ClassVar[bool] = RobustMap.takes_components
    finds_noise: ClassVar[bool] = RobustMap.finds_noise
    judges_by_covariance: ClassVar[bool] = RobustMap.judges_by_covariance
    needs: ClassVar[str] = RobustMap.needs
    takes_prefilter: ClassVar[bool] = RobustMap.takes_prefilter
    estimator: RobustMap = eqx.field(default_factory=RobustMap, metadata={"hides": ("imu",)})
    imu: ImuErrors | None = eqx.field(default=None, metadata={"slot": True, "hides": PER_SAMPLE})

    def __check_init__(self):
        if self.imu is not None:
            ImuErrors.checked(self.imu).check_densities()

    @property
    def aids(self) -> tuple[AbstractAid, ...]:
        """That it observes."""
        return self.estimator.aids

    @property
    def front_end(self) -> FrontEnd:
        """That of the estimator; of a standing vehicle, epochs are 0.2 s or less by default."""
        return self.estimator.front_end

    def with_front_end(self, front_end: FrontEnd) -> Self:
        """The same with another one."""
        return dataclasses.replace(self, estimator=self.estimator.with_front_end(front_end))

    @property
    def unknowns(self) -> dict[str, slice]:
        """Where in ``Solution.filter.calibration`` the unknowns of the aids are."""
        return self.estimator.unknowns

    def with_imu(self, imu: ImuErrors) -> Self:
        """With these figures of the inertial unit."""
        return dataclasses.replace(self, imu=imu)

    def counted(self, solution: Solution) -> np.ndarray:
        """(K,) rows whose fix is rather none of the outliers."""
        return self.estimator.counted(solution)

    def epochs(self, log: Log) -> Epochs:
        """Preintegrate a log; of a standing vehicle at the smaller of both intervals."""
        samples = self.front_end.interval_samples or standing_samples(log, coarse=True)
        return self.estimator.with_front_end(FrontEnd(samples, self.front_end.scheme)).epochs(log)

    def graded(self, epochs: Epochs) -> Graded:
        """How well each grade fits, by all epochs; pure.

        Raises:
            UserError: float32.
        """
        require_x64(epochs)
        base, last = self.estimator, np.full(len(GRADES), len(epochs) - 1)
        if _is_traced((self, epochs)):
            model, epochs = jax.lax.stop_gradient((self._of_all_grades, epochs))
            lane = jax.tree.map(lambda x: x[:, None], epochs.rows)
            problem = Problem(lane, epochs.site, epochs.sd, jnp.asarray(last))
            read = solve_traced(model, problem, base.iterations, base.heading_count).read
        else:
            with eval_context():  # inside traced code too, where all are constants
                read = solve_on_host(self._of_all_grades, epochs, last, base.iterations, base.heading_count).read
        xp = jnp if isinstance(read.log_likelihood, Tracer) else np  # on the host no operation of JAX by itself
        aided = xp.any(xp.stack([xp.asarray(fix.valid) for fix in epochs.rows.fixes]), axis=0)
        return Graded(read.log_likelihood, aided.sum(), read.gyro, read.accel)

    @property
    def _of_all_grades(self) -> Model:
        """One a lane, alike on all axes."""
        return dataclasses.replace(self.estimator.model, imu=_units(_FIGURES[:, None]))

    def for_unit(self, imu: ImuErrors, coarse: bool) -> RobustMap:
        """The estimator for a unit."""
        headings = _HEADINGS if coarse and self.estimator.headings is None else self.estimator.headings
        return dataclasses.replace(self.estimator, imu=imu, headings=headings)

    def solve(self, epochs: Epochs, rows: Any = 1, done: Callable[[int], None] | None = None) -> Solution:
        """Align epochs (see :meth:`AbstractMethod.solve`)."""
        imu = self.imu
        if imu is None:
            number = self.graded(epochs).number
            if isinstance(number, Tracer):
                imu = _units(jnp.asarray(_FIGURES)[:, number])
            else:
                with eval_context():
                    imu = _units(_FIGURES[:, int(number)])
        coarse = is_coarse(imu)
        if not isinstance(coarse, Tracer):
            return self.for_unit(imu, bool(coarse)).solve(epochs, rows, done)
        one, many = self.for_unit(imu, False), self.for_unit(imu, True)
        if one.heading_count == many.heading_count:
            return one.solve(epochs, rows)
        return jax.lax.cond(coarse, lambda: many.solve(epochs, rows), lambda: one.solve(epochs, rows))


def is_coarse(imu: ImuErrors) -> Any:
    """Whether the gyroscopes may hide a part of the Earth's rate."""
    bias = imu.gyro.bias_deg_h
    xp = jnp if isinstance(bias, Tracer) else np
    return xp.max(xp.abs(xp.asarray(bias))) > _COARSE


def usual_unknowns(aids: tuple[AbstractAid, ...]) -> tuple[str, ...]:
    """Unknowns that are estimated where nothing is said."""
    return tuple(f"{aid.name}.{name}" for aid in aids for name in aid.usual)


def standing_samples(log: Log, coarse: bool) -> int | None:
    """IMU samples per epoch of a log of a standing vehicle; None of another."""
    step = min(_FINE if coarse else _STEP, log.duration / _LEAST)
    return max(round(step / log.dt), 1) if log.standing else None


def _units(figures: Any) -> ImuErrors:
    """Of the four figures of a grade."""
    gyro_bias, walk, accel_bias, density = figures
    return ImuErrors(GyroErrors(gyro_bias, walk), AccelErrors(accel_bias, density))


def _is_traced(tree: Any) -> bool:
    return any(isinstance(x, Tracer) for x in jax.tree.leaves(tree))
