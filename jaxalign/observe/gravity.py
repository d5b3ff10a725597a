"""The vehicle stands (it may sway): its specific force is gravity."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxalign.aids import AbstractAid, Standing
from jaxalign.arguments import check_choice
from jaxalign.earth import Site
from jaxalign.epochs import Epoch
from jaxalign.errors import UserError
from jaxalign.observe.base import AbstractObserve, Context, Pair
from jaxalign.observe.options import check_window
from jaxalign.observe.window import Previous, Sliding, Sums, Whole, window
from jaxalign.parametrization import given
from jaxalign.propagation import Place, advance_body, advance_nav
from jaxalign.vector import Quat, Vec3

__all__ = ["GravityVectors"]


class _State(eqx.Module):
    q_b0b: Quat
    q_n0n: Quat
    sums: Sums
    window: Whole | Sliding | Previous
    rate: Vec3
    gravity: Float[Array, ""]


class GravityVectors(AbstractObserve):
    """Zero velocity as the aid: ``alpha = -int C_n0n g dt``, ``beta = int C_b0b f dt``.

    Attributes:
        vectors: "integrated" over the window, or "instantaneous": the increments of each interval (the mean of
            the interval on both sides).
        window: length of the window in seconds, 0 for the whole time ("integrated" only).
        interval: between epochs, s, which a window must know; None: to be told (:meth:`jaxalign.Aligner.at_interval`).
        aid: that it observes.

    Source: Xu 2017 (7), (13)-(14) with zero velocity; sums of closed-form gravity instead of its point values.
    """

    steps: ClassVar[bool] = True
    vectors: Literal["integrated", "instantaneous"] = eqx.field(static=True, default="integrated")
    window: float = eqx.field(static=True, default=0.0)
    interval: float | None = given(None)
    aid: AbstractAid = given(Standing())

    def __check_init__(self):
        check_choice("observe.vectors", self.vectors, ("integrated", "instantaneous"))
        check_window(self.window)
        if self.window and self.vectors == "instantaneous":
            raise UserError("observe.window means nothing for instantaneous vectors: leave it at 0, or take velocity_q")

    def whitened(self, residual: np.ndarray, time: np.ndarray, sd: float, interval: float) -> np.ndarray:
        """The noise is that of one interval: sums since the start are differenced first."""
        if self.vectors == "integrated":
            residual = np.diff(residual, axis=0) / np.sqrt(np.diff(time) / interval)[:, None]
        return residual / sd

    def init(self, site: Site) -> Any:
        """State before the first epoch (see the base class)."""
        sums = Sums.zero(displacement=False)
        state = window(self.window, self.interval, sums)
        if self.vectors == "instantaneous":
            state = Previous(window(0.0, None, sums), sums)  # type: ignore[arg-type]
        place = Place.of(site)
        return _State(Quat.identity(), Quat.identity(), sums, state, place.earth_rate, place.gravity)

    def step(self, state: Any, context: Context, epoch: Epoch) -> tuple[Any, Pair]:
        """Consume one epoch."""
        s = state
        q_b0b, gained = advance_body(s.q_b0b, epoch.rotation, epoch.dvel)
        q_n0n, fallen = advance_nav(s.q_n0n, s.rate, s.gravity, epoch.dt)
        sums = Sums(s.sums.alpha - fallen, s.sums.beta + gained, None)
        held, pair, valid, _ = s.window.push(context.index, sums, epoch.valid)
        new = _State(q_b0b, q_n0n, sums, held, s.rate, s.gravity)
        return new, Pair(pair.alpha, pair.beta, valid, sums.alpha - s.sums.alpha, pair.beta, None, s.rate)
