"""The vehicle stands (it may sway): its specific force is gravity."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxalign.earth import Site
from jaxalign.epochs import Epoch
from jaxalign.errors import UserError
from jaxalign.observe.base import AbstractObserve, Context, Pair
from jaxalign.observe.frames import Place, gravity_impulse, turn
from jaxalign.observe.options import check_choice, check_interval, check_window, optional_count
from jaxalign.observe.window import Previous, Sliding, Sums, Whole, window
from jaxalign.vector import Quat, Vec3

__all__ = ["Static"]


class _State(eqx.Module):
    q_b0b: Quat
    q_n0n: Quat
    sums: Sums
    window: Whole | Sliding | Previous
    rate: Vec3
    gravity: Float[Array, ""]


class Static(AbstractObserve):
    """Zero velocity as the aid: ``alpha = -int C_n0n g dt``, ``beta = int C_b0b f dt``.

    Attributes:
        vectors: "integrated" over the window, or "instantaneous": the increments of each interval (the mean of
            the interval on both sides).
        window: length of the window in seconds, 0 for the whole time ("integrated" only).
        interval_samples: IMU samples per epoch; None: as the log has it.

    Source: Xu 2017 (7), (13)-(14) with zero velocity; sums of closed-form gravity instead of its point values.
    """

    aid: ClassVar[str] = "static"
    steps: ClassVar[bool] = True
    vectors: Literal["integrated", "instantaneous"] = eqx.field(static=True, default="integrated")
    window: float = eqx.field(static=True, default=0.0)
    interval_samples: int | None = optional_count()

    def __check_init__(self):
        check_choice("observe.vectors", self.vectors, ("integrated", "instantaneous"))
        check_window(self.window)
        if self.window and self.vectors == "instantaneous":
            raise UserError("observe.window means nothing for instantaneous vectors: leave it at 0, or take velocity_q")
        check_interval(self.interval_samples)

    def whitened(self, residual: np.ndarray, time: np.ndarray, sd: float, interval: float) -> np.ndarray:
        """The noise is that of one interval: sums since the start are differenced first."""
        if self.vectors == "integrated":
            residual = np.diff(residual, axis=0) / np.sqrt(np.diff(time) / interval)[:, None]
        return residual / sd

    def init(self, site: Site, interval: float) -> Any:
        """State before the first epoch (see the base class)."""
        sums = Sums.zero(moment=False)
        state = window(self.window, interval, sums)
        if self.vectors == "instantaneous":
            state = Previous(window(0.0, interval, sums), sums)  # type: ignore[arg-type]
        place = Place.of(site)
        return _State(Quat.identity(), Quat.identity(), sums, state, place.earth_rate, place.gravity)

    def step(self, state: Any, context: Context, epoch: Epoch) -> tuple[Any, Pair]:
        """Consume one epoch."""
        s = state
        q_b0b = (s.q_b0b * epoch.rotation).renormalised()
        q_n0n = turn(s.q_n0n, s.rate, epoch.dt)
        sums = Sums(
            s.sums.alpha - s.q_n0n.rotate(gravity_impulse(s.rate, s.gravity, epoch.dt)),
            s.sums.beta + s.q_b0b.rotate(epoch.dvel),
            None,
        )
        held, pair, valid, _ = s.window.push(context.index, sums, epoch.valid)
        new = _State(q_b0b, q_n0n, sums, held, s.rate, s.gravity)
        return new, Pair(pair.alpha, pair.beta, valid, sums.alpha - s.sums.alpha, pair.beta, None, s.rate)
