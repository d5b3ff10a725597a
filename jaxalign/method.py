"""The protocol of a method: from a log to epochs, from epochs to attitudes, and what a report says of them."""

# No annotations from the future: equinox looks for abstract attributes among them, and finds none in text.
import dataclasses
from abc import abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Self

import equinox as eqx
import numpy as np

from jaxalign.aids import AbstractAid
from jaxalign.epochs import Epochs, over_runs
from jaxalign.errors import UserError
from jaxalign.front_end import FrontEnd, check_prefilter, is_standing
from jaxalign.inertial_unit import ImuErrors
from jaxalign.log import Log
from jaxalign.solution import Solution

__all__ = ["AbstractMethod"]

_FEWEST = 3  # vectors to judge by
_PLAIN = FrontEnd()


class AbstractMethod(eqx.Module):
    """A method of alignment: :func:`jaxalign.align`, studies, tuning and the command line need no more than this.

    Subclasses are abstract or final. A method of your own says which aid it takes and solves epochs; the rest has
    defaults.

    Attributes:
        aids: that it observes; :class:`jaxalign.Standing` alone where it takes the vehicle as standing.
        front_end: makes its epochs of a log.
    """

    has_covariance: ClassVar[bool] = False
    """Whether its solutions come with a covariance."""
    rows_are_costly: ClassVar[bool] = False
    """Whether each row goes over all epochs before it."""
    finds_noise: ClassVar[bool] = False
    """Whether ``Solution.aid_sd`` is the noise that it found, not the noise that it was told."""
    judges_by_covariance: ClassVar[bool] = False
    """Whether its heading is observable where its standard deviation is small, not where the directions have opened."""
    takes_components: ClassVar[bool] = False
    """Whether it can use a velocity without all of its components."""
    takes_prefilter: ClassVar[bool] = True
    """Whether it aligns a standing vehicle behind a filter of the specific force, which colours the noise."""
    needs: ClassVar[str] = "two directions (log too short for its averaging?)"
    """What it takes to find an attitude, for people."""

    if TYPE_CHECKING:  # fields or properties of a subclass

        @property
        def aids(self) -> tuple[AbstractAid, ...]:
            """The aids that it observes."""
            ...

        @property
        def front_end(self) -> FrontEnd:
            """See above."""
            ...

    else:
        aids: eqx.AbstractVar[tuple[AbstractAid, ...]]
        front_end: eqx.AbstractVar[FrontEnd]

    def __check_init__(self):
        if self.front_end.prefilter is not None:
            check_prefilter(self.front_end.prefilter, self.aids)
            if not self.takes_prefilter:
                raise UserError(
                    "a prefilter colours the noise, of which this method has a model of its own: leave the filter out, "
                    "or take a method such as gravity_q"
                )

    @staticmethod
    def checked(given: Any) -> "AbstractMethod":
        """What was given, if it is a method.

        Raises:
            UserError: it is something else.
        """
        if not isinstance(given, AbstractMethod):
            raise UserError(f"{given!r} is no method: build one by name with jaxalign.build('oba', aid='body')")
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
        for aid in self.aids:
            seen = None if aid.implied else log.measured(aid)
            if seen is not None and not self.takes_components and seen.velocity is None:
                raise UserError(
                    f"{log.name} has no whole velocity: {seen.name} is {seen.aid.described}, and the method needs all "
                    "three components at once; robust_map takes what there is"
                )
        return self.front_end.epochs(log, self.aids, whole=not self.takes_components)

    def with_front_end(self, front_end: FrontEnd) -> Self:
        """The same with another one."""
        return dataclasses.replace(self, front_end=front_end)

    @property
    def bare(self) -> Self:
        """The same for epochs that are made: methods that differ in the front end alone share a program."""
        return self if self.front_end == _PLAIN else self.with_front_end(_PLAIN)

    @property
    def standing(self) -> bool:
        """Whether it takes the vehicle as standing."""
        return is_standing(self.aids)

    def at_interval(self, seconds: float | None) -> Self:
        """The same for epochs so far apart (s; None: at unequal intervals); a method without windows is itself."""
        return self

    def solve_runs(self, epochs: Epochs, rows: Any = 1) -> Solution:
        """Align many runs, see :func:`jaxalign.epochs.over_runs`."""
        return over_runs(lambda one: self.solve(one, rows), epochs)

    def with_imu(self, imu: ImuErrors) -> Self:
        """The method with these figures of the inertial unit; a method that uses none is itself."""
        return self

    @property
    def unknowns(self) -> dict[str, slice]:
        """Unknowns of the aid by name: where they are in ``Solution.filter.calibration``."""
        return {}

    @property
    def figures(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of what it fits of the inertial unit and the aids: ``Solution.filter.figures``."""
        return ()

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
