"""The protocol of a method: from a log to epochs, from epochs to attitudes, and what a report says of them."""

# No annotations from the future: equinox looks for abstract attributes among them, and finds none in text.
from abc import abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Self

import equinox as eqx
import numpy as np

from jaxalign.epochs import Epochs, epochs_from_log, over_runs
from jaxalign.errors import UserError
from jaxalign.inertial_unit import ImuErrors
from jaxalign.log import Log
from jaxalign.prefilter import AbstractPrefilter
from jaxalign.solution import Solution

__all__ = ["AbstractMethod"]

_FEWEST = 3  # vectors to judge by


class AbstractMethod(eqx.Module):
    """A method of alignment: :func:`jaxalign.align`, studies, tuning and the command line need no more than this.

    Subclasses are abstract or final. A method of your own says which aid it takes and solves epochs; the rest has
    defaults.

    Attributes:
        aid: the kind of aid that it observes: "static" (none: the vehicle stands), "body" or "nav".
        interval_samples: IMU samples per epoch; None: as the log has it.
        prefilter: low-pass filter of the specific force of a whole log of a standing vehicle; None: no filter.
    """

    has_covariance: ClassVar[bool] = False
    """Whether its solutions come with a covariance."""
    rows_are_costly: ClassVar[bool] = False
    """Whether each row goes over all epochs before it."""
    finds_noise: ClassVar[bool] = False
    """Whether ``Solution.aid_sd`` is the noise that it found, not the noise that it was told."""
    judges_by_covariance: ClassVar[bool] = False
    """Whether its heading is observable where its standard deviation is small, not where the directions have opened."""
    needs: ClassVar[str] = "two directions (log too short for its averaging?)"
    """What it takes to find an attitude, for people."""

    if TYPE_CHECKING:  # fields or properties of a subclass

        @property
        def aid(self) -> str:
            """See above."""
            ...

        @property
        def interval_samples(self) -> int | None:
            """See above."""
            ...

        @property
        def prefilter(self) -> AbstractPrefilter | None:
            """See above."""
            ...
    else:
        aid: eqx.AbstractVar[str]
        interval_samples: eqx.AbstractVar[int | None]
        prefilter: eqx.AbstractVar[AbstractPrefilter | None]

    @staticmethod
    def checked(given: Any) -> "AbstractMethod":
        """What was given, if it is a method.

        Raises:
            UserError: it is something else.
        """
        if not isinstance(given, AbstractMethod):
            raise UserError(f"{given!r} is no method: build one by name with jaxalign.methods.build('oba', aid='body')")
        return given

    @abstractmethod
    def solve(self, epochs: Epochs, rows: Any = 1, done: Callable[[int], None] | None = None) -> Solution:
        """Align epochs; also inside jit, vmap and grad.

        Args:
            epochs: of one log.
            rows: epochs between two rows of the result, as ``every`` of :func:`jaxalign.align`, or the numbers of the
                epochs to read out, ascending (host integers).
            done: told how many rows are finished, now and then, by a method whose rows are costly.

        Raises:
            UserError: rows that are no epochs.
        """

    def epochs(self, log: Log) -> Epochs:
        """Filter and preintegrate a log for this method.

        Raises:
            UserError: float32, an aid that the method does not observe, or an interval that does not fit.
        """
        standing = self.aid == "static"
        if not standing and log.aid != self.aid:
            raise UserError(
                f"{log.name} has a {log.aid!r} aid, the method observes {self.aid!r}: build it with aid={log.aid!r}"
            )
        return epochs_from_log(log, interval_samples=self.interval_samples, static=standing, prefilter=self.prefilter)

    def solve_runs(self, epochs: Epochs, rows: Any = 1) -> Solution:
        """Align many runs, see :func:`jaxalign.epochs.over_runs`."""
        return over_runs(lambda one: self.solve(one, rows), epochs)

    def with_imu(self, imu: ImuErrors) -> Self:
        """The same with these figures of the inertial unit; a method that uses none is itself."""
        return self

    @property
    def unknowns(self) -> dict[str, slice]:
        """Unknowns of the aid by name: where they are in ``Solution.filter.calibration``."""
        return {}

    @property
    def fits_vectors(self) -> bool:
        """Whether its residuals are those of vectors that were fitted: they hide outliers and biases."""
        return False

    def counted(self, solution: Solution) -> np.ndarray:
        """(K,) rows of a solution whose fix counted, on the host."""
        return np.asarray(solution.defined) & (np.asarray(solution.weight) > 0)

    def whitened(self, residual: np.ndarray, time: np.ndarray, sd: float, interval: float) -> np.ndarray:
        """Residuals in standard deviations of the noise that they should have been, on the host.

        Args:
            residual: (n, 3) of the rows that counted, m/s.
            time: (n,) of these rows, s.
            sd: of the noise (``Solution.aid_sd``), m/s.
            interval: between epochs, s.
        """
        return residual / sd

    def misfit(self, solution: Solution, interval: float) -> float:
        """RMS of the residual across the vector, per axis, in standard deviations of the noise assumed.

        Along the vector a misfit (accelerometer bias along the vertical) moves no attitude.

        Args:
            solution: of one log, found by this method.
            interval: between epochs, s.

        Returns:
            The ratio; NaN where fewer than three fixes counted.
        """
        used = self.counted(solution)
        alpha, residual = np.asarray(solution.alpha)[used], np.asarray(solution.residual)[used]
        if len(alpha) < _FEWEST:
            return float("nan")
        direction = alpha / np.linalg.norm(alpha, axis=1, keepdims=True)
        across = residual - np.sum(residual * direction, axis=1, keepdims=True) * direction
        white = self.whitened(across, np.asarray(solution.time)[used], float(solution.aid_sd[-1]), interval)
        return float(np.sqrt(np.mean(np.sum(white**2, axis=1)) / 2.0))
