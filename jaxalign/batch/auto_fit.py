"""The robust batch estimator with figures of the unit and of the aids that it fits: what `auto` is going to be.

It is no recipe yet.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer, eval_context

from jaxalign.aids import AbstractAid
from jaxalign.arguments import check_choice
from jaxalign.batch.figures import Layout, described
from jaxalign.batch.fit import Start, usual_starts
from jaxalign.batch.fit_on_host import causal_on_host, fit_on_host, rows_on_host
from jaxalign.batch.fit_traced import causal_traced, fit_traced, rows_traced
from jaxalign.batch.problem import Model
from jaxalign.batch.robust_map import RobustMap, assembled_rows
from jaxalign.epochs import Epochs, row_numbers
from jaxalign.front_end import FrontEnd
from jaxalign.inertial_unit import GRADES, PER_SAMPLE, ImuErrors
from jaxalign.log import Log
from jaxalign.method import AbstractMethod
from jaxalign.precision import require_x64
from jaxalign.raw_noise import white_densities
from jaxalign.solution import Solution
from jaxalign.units import DEG_SQRT_H

__all__ = ["AutoFit", "fitted_unknowns"]

_STEP, _FINE = 1.0, 0.2  # s, between epochs of a standing vehicle; with gyroscopes whose noise is large
_NOISY = 0.05 * DEG_SQRT_H
_LEAST = 20  # epochs


class AutoFit(AbstractMethod):
    """:class:`RobustMap` with figures of the inertial unit and of the aids that are fitted with the attitude.

    Unknown, beside what ``RobustMap`` has, are bias, white noise and wander of both triads, and of each aid its white
    noise and the size of its slow error, if it may have one. What is believed of them beforehand: inertial units lie
    along a line from navigation grade to what is in a telephone, and their white noise is about that of the quiet
    parts of the record. The search has eight starts, most of them by windows that grow from the first seconds, which
    survive biases of degrees per second.

    By default figures are those of the whole record, for all rows: a row then knows of the unit what only came later.
    With ``causal`` each row has the figures of the fixes up to it, at the cost of a fit a row.

    Pure: inside traced code all of it is done there; derivatives are those of the solution with the figures held.

    Attributes:
        estimator: that aligns; of its own numbers ``imu``, ``aid_noise`` and ``headings`` are not used.
        imu: figures of the inertial unit that are known; None (default): found.
        grade: a name of :data:`jaxalign.inertial_unit.GRADES` whose figures are about right, within a factor of two or
            three; None: nothing is known.
        causal: see above.

    Source: none of the papers.
    """

    has_covariance: ClassVar[bool] = RobustMap.has_covariance
    rows_are_costly: ClassVar[bool] = RobustMap.rows_are_costly
    takes_components: ClassVar[bool] = RobustMap.takes_components
    finds_noise: ClassVar[bool] = RobustMap.finds_noise
    judges_by_covariance: ClassVar[bool] = RobustMap.judges_by_covariance
    needs: ClassVar[str] = RobustMap.needs
    takes_prefilter: ClassVar[bool] = RobustMap.takes_prefilter
    estimator: RobustMap = eqx.field(
        default_factory=RobustMap, metadata={"hides": ("imu", "aid_noise", "headings", "tolerance")}
    )
    imu: ImuErrors | None = eqx.field(default=None, metadata={"slot": True, "hides": PER_SAMPLE})
    grade: str | None = eqx.field(static=True, default=None)
    causal: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        if self.imu is not None:
            ImuErrors.checked(self.imu).check_densities()
        if self.grade is not None:
            check_choice("grade", self.grade, tuple(GRADES))

    @property
    def aids(self) -> tuple[AbstractAid, ...]:
        """That it observes."""
        return self.estimator.aids

    @property
    def front_end(self) -> FrontEnd:
        """That of the estimator."""
        return self.estimator.front_end

    def with_front_end(self, front_end: FrontEnd) -> Self:
        """The same with another one."""
        return dataclasses.replace(self, estimator=self.estimator.with_front_end(front_end))

    @property
    def unknowns(self) -> dict[str, slice]:
        """Where in ``Solution.filter.calibration`` the unknowns of the aids are."""
        return self.estimator.unknowns

    @property
    def figures(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each of ``Solution.filter.figures``."""
        return described(self.aids, Layout.of(self._model))

    def with_imu(self, imu: ImuErrors) -> Self:
        """With these figures of the inertial unit."""
        return dataclasses.replace(self, imu=imu)

    def counted(self, solution: Solution) -> np.ndarray:
        """(K,) rows whose fix is rather none of the outliers."""
        return self.estimator.counted(solution)

    def epochs(self, log: Log) -> Epochs:
        """Preintegrate a log; of a standing vehicle every second, with noisy gyroscopes five times as often."""
        samples = self.front_end.interval_samples or standing_samples(log)
        return self.estimator.with_front_end(FrontEnd(samples, self.front_end.scheme)).epochs(log)

    @property
    def _model(self) -> Model:
        return dataclasses.replace(self.estimator.model, aid_noise="held")

    @property
    def _starts(self) -> tuple[Start, ...]:
        return usual_starts(self.aids)

    def solve(self, epochs: Epochs, rows: Any = 1, done: Callable[[int], None] | None = None) -> Solution:
        """Align epochs (see :meth:`AbstractMethod.solve`)."""
        require_x64(epochs)
        numbers = row_numbers(len(epochs), rows)
        model, starts, known = self._model, self._starts, (self.imu, self._centre)
        if any(isinstance(x, Tracer) for x in jax.tree.leaves((self, epochs))):
            if self.causal:
                found, figures = causal_traced(model, epochs, starts, numbers, self.estimator.iterations, *known)
            else:
                whole = fit_traced(model, epochs, starts, *known)
                found = rows_traced(model, epochs, whole, numbers, self.estimator.iterations)
                figures = jnp.broadcast_to(
                    whole.fitted.theta[:, whole.best, None], (len(whole.fitted.theta), len(numbers))
                )
            return assembled_rows(self.estimator, epochs.site, epochs.rows, numbers, found, jnp.exp(figures))
        with eval_context():  # inside traced code too, where all are constants
            if self.causal:
                found, figures = causal_on_host(model, epochs, starts, numbers, *known, done)
            else:
                fit = fit_on_host(model, epochs, starts, *known)
                found = rows_on_host(model, fit, numbers, done)
                figures = np.repeat(np.asarray(fit.fitted.theta)[:, [fit.best]], len(numbers), axis=1)
            return assembled_rows(self.estimator, epochs.site, epochs.rows, numbers, found, np.exp(figures))

    @property
    def _centre(self) -> tuple[float, ...] | None:
        return None if self.grade is None else GRADES[self.grade]


def fitted_unknowns(aids: tuple[AbstractAid, ...]) -> tuple[str, ...]:
    """Unknowns that are estimated where nothing is said."""
    slow = tuple(f"{aid.name}.slow" for aid in aids if "slow" in aid.known_unknowns)
    return (*(f"{aid.name}.{name}" for aid in aids for name in aid.usual), *slow)


def standing_samples(log: Log) -> int | None:
    """IMU samples per epoch of a log of a standing vehicle; None of another."""
    if not log.standing:
        return None
    raw = white_densities(log.dtheta, log.dvel, log.dt)
    step = min(_FINE if raw is not None and raw[0] > _NOISY else _STEP, log.duration / _LEAST)
    return max(round(step / log.dt), 1)
