"""What makes a method good: numbers of the attitude errors of many runs, to be made small."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.arguments import check_choice
from jaxalign.errors import UserError, close_names

__all__ = [
    "ANGLES",
    "LOSSES",
    "AbstractLoss",
    "Convergence",
    "LogRmse",
    "Misfit",
    "Quantile",
    "Rmse",
    "RunErrors",
    "loss_of",
]

ANGLES = ("pitch", "roll", "yaw", "level")
_LEAST_DEG = 1e-9


class RunErrors(eqx.Module):
    """Errors of runs within the window, all of them finite.

    A run without an attitude counts as one whose angles are anything: 104 deg, the RMS of a uniform angle.

    Attributes:
        euler: (runs, K, 3) deg: pitch, roll, yaw, estimate minus truth.
        phi: (runs, K, 3) deg: about east, north, up.
        time: (K,) s.
    """

    euler: Float[Array, "runs K 3"]
    phi: Float[Array, "runs K 3"]
    time: Float[Array, " K"]

    def of(self, angle: str) -> Float[Array, "runs K n"]:
        """The errors of an angle of :data:`ANGLES`."""
        return self.euler[..., :2] if angle == "level" else self.euler[..., ANGLES.index(angle)][..., None]


def _angle() -> Any:
    return eqx.field(static=True, default="yaw")


def _root(x: Any) -> Any:
    """Square root with a finite gradient at zero."""
    return jnp.sqrt(x + _LEAST_DEG**2)


class AbstractLoss(eqx.Module):
    """A number to make small.

    Attributes:
        unit: of the number.
        whole: whether the window is the whole run, if none is given; else the last 50 s.
    """

    unit: ClassVar[str] = "deg"
    whole: ClassVar[bool] = False

    @abstractmethod
    def __call__(self, errors: RunErrors) -> Float[Array, ""]:
        """Of the errors of all the runs. Pure and differentiable."""


class Rmse(AbstractLoss):
    """Root of the mean square over runs and window.

    Attributes:
        angle: "pitch", "roll", "yaw" (default) or "level" (pitch and roll).
    """

    angle: str = _angle()

    def __check_init__(self):
        check_choice("angle", self.angle, ANGLES)

    def __call__(self, errors: RunErrors) -> Float[Array, ""]:
        """Over all runs and rows together."""
        return _root(jnp.mean(errors.of(self.angle) ** 2))


class LogRmse(AbstractLoss):
    """Mean over the runs of the logarithm of each run's RMSE: every run counts alike, the worst do not rule.

    Attributes:
        angle: as of :class:`Rmse`.
    """

    unit: ClassVar[str] = "ln(deg)"
    angle: str = _angle()

    def __check_init__(self):
        check_choice("angle", self.angle, ANGLES)

    def __call__(self, errors: RunErrors) -> Float[Array, ""]:
        """Mean of logarithms."""
        return jnp.mean(jnp.log(_root(jnp.mean(errors.of(self.angle) ** 2, axis=(1, 2)))))


class Quantile(AbstractLoss):
    """What a share of the runs stay below, of each run's RMSE.

    The derivative is that of the two runs beside it: take many runs.

    Attributes:
        share: 0 to 1; 0.95 by default.
        angle: as of :class:`Rmse`.
    """

    share: float = eqx.field(static=True, default=0.95)
    angle: str = _angle()

    def __check_init__(self):
        check_choice("angle", self.angle, ANGLES)
        if not 0 < self.share < 1:
            raise UserError(f"share = {self.share}: must be between 0 and 1")

    def __call__(self, errors: RunErrors) -> Float[Array, ""]:
        """The quantile over the runs of their RMS."""
        return jnp.quantile(_root(jnp.mean(errors.of(self.angle) ** 2, axis=(1, 2))), self.share)


class Convergence(AbstractLoss):
    """Seconds during which a run is outside a tolerance, mean over the runs: a convergence time that has a derivative.

    Outside counts as ``sigmoid(ln(|error| / tolerance) / softness)``.

    Attributes:
        tolerance_deg: of the angle.
        softness: of the edge, in units of ln(error).
        angle: as of :class:`Rmse`; "level" takes the larger of the two.
    """

    unit: ClassVar[str] = "s"
    whole: ClassVar[bool] = True
    tolerance_deg: float = eqx.field(static=True, default=1.0)
    softness: float = eqx.field(static=True, default=0.2)
    angle: str = _angle()

    def __check_init__(self):
        check_choice("angle", self.angle, ANGLES)
        for name in ("tolerance_deg", "softness"):
            if not getattr(self, name) > 0:
                raise UserError(f"{name} = {getattr(self, name)}: must be positive")

    def __call__(self, errors: RunErrors) -> Float[Array, ""]:
        """Mean over the runs."""
        size = jnp.max(_root(errors.of(self.angle) ** 2), axis=-1)
        outside = jax.nn.sigmoid(jnp.log(size / self.tolerance_deg) / self.softness)
        return jnp.mean(outside @ jnp.diff(errors.time, prepend=0.0))


class Misfit(eqx.Module):
    """For a prefilter alone: signal lost below a frequency plus disturbance left above it, ln((m/s^2)^2).

    ``ln(int_low (1 - G)^2 S df + int_high G^2 S df)`` (:func:`jaxalign.prefilter.misfit`), S the mean density of the
    force of the runs along the three axes, each 60 s at most. No run is aligned.

    Attributes:
        split: Hz.
    """

    unit: ClassVar[str] = "ln(m2/s4)"
    split: float = eqx.field(static=True, default=0.5)


LOSSES: dict[str, Any] = {
    "rmse": Rmse,
    "log-rmse": LogRmse,
    "quantile": Quantile,
    "convergence": Convergence,
    "misfit": Misfit,
}
"""All losses by name."""


def loss_of(given: Any) -> Any:
    """A loss by name, or itself, or a function of :class:`RunErrors`.

    Raises:
        UserError: neither.
    """
    if isinstance(given, str):
        if given not in LOSSES:
            near = close_names(given, LOSSES) or list(LOSSES)
            raise UserError(f"no loss {given!r}: did you mean {', '.join(near)}?")
        return LOSSES[given]()
    if isinstance(given, Misfit) or callable(given):
        return given
    raise UserError(f"loss = {given!r}: must be one of {', '.join(LOSSES)}, or a function of jaxalign.tune.RunErrors")
