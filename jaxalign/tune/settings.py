"""What is tuned, on what, for what: checked before anything is traced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from jaxalign.errors import UserError
from jaxalign.simulate import Scenario
from jaxalign.study.feed import Fidelity
from jaxalign.study.settings import Study, described, whole
from jaxalign.tune.losses import Misfit, loss_of
from jaxalign.tune.space import Space, space_of

__all__ = ["Tune"]

Asked = Literal["auto", "forward", "reverse"]
_FORWARD = 3
"""Numbers up to which a tangent each costs less than a pass backward (benchmarks/tuning.md)."""


@dataclass(frozen=True, init=False)
class Tune:
    """A search for the numbers of a method that make a loss small, by its gradient, over the same simulated runs.

    Attributes:
        scenario: a :class:`jaxalign.simulate.Scenario` (given by itself or its name).
        method: where the search starts (given by itself or the name of its recipe).
        paths: what is tuned ("weight.gamma", ...), see :func:`jaxalign.tune.space_of`.
        loss: a name of :data:`jaxalign.tune.LOSSES`, a loss, or a function of :class:`jaxalign.tune.RunErrors`.
        runs: that the gradient is taken over; the same at every step (common random numbers).
        batch: runs of a step, taken in turn from them; by default all.
        held_out: runs, of another seed, that choose between the steps and say when to stop.
        steps: at most.
        rate: learning rate of Adam: relative change of a number in one step, at the start.
        check: steps between two looks at the runs held out.
        patience: looks without anything better after which the search stops; 0: never.
        seed: of the runs.
        every, fidelity, window: as of :class:`jaxalign.study.Study`; the window of a loss of the whole run is all.
        mode: "forward" (a tangent per number), "reverse", or "auto": the cheaper one.
        recipe: that the method was made by, for files; known where the method is a name.
        space: the free numbers.

    Raises:
        UserError: float32, or a value that makes no search.
    """

    scenario: Scenario
    method: Any
    paths: tuple[str, ...]
    loss: Any
    runs: int
    batch: int
    held_out: int
    steps: int
    rate: float
    check: int
    patience: int
    seed: int
    every: int
    fidelity: Fidelity
    window: tuple[float, float]
    mode: Asked
    recipe: str | None
    space: Space

    def __init__(
        self,
        scenario: str | Scenario,
        method: Any,
        paths: str | Sequence[str],
        loss: Any = "rmse",
        runs: int = 256,
        batch: int | None = None,
        held_out: int = 1024,
        steps: int = 100,
        rate: float = 0.1,
        check: int = 5,
        patience: int = 6,
        seed: int = 0,
        every: int = 10,
        fidelity: Fidelity = "increments",
        window: tuple[float, float] | None = None,
        mode: Asked = "auto",
        recipe: str | None = None,
    ):
        loss = loss_of(loss)
        if window is None and getattr(loss, "whole", False):
            window = (0.0, np.inf)
        methods = [method] if isinstance(method, str) else {"method": method}
        study = Study(scenario, methods, whole("runs", runs, 2, 10**6), seed, every, fidelity, 1.0, window)
        method, recipe = next(iter(study.methods.values())), method if isinstance(method, str) else recipe
        space = space_of(method, paths)
        put = {
            "scenario": study.scenario,
            "method": method,
            "paths": space.paths,
            "loss": loss,
            "runs": runs,
            "batch": runs if batch is None else whole("batch", batch, 2, runs),
            "held_out": whole("held_out", held_out, 2, 10**6),
            "steps": whole("steps", steps, 1, 10**6),
            "rate": rate,
            "check": whole("check", check, 1, 10**6),
            "patience": whole("patience", patience, 0, 10**6),
            "seed": seed,
            "every": every,
            "fidelity": fidelity,
            "window": study.window,
            "mode": mode,
            "recipe": recipe,
            "space": space,
        }
        for name, value in put.items():
            object.__setattr__(self, name, value)
        if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 < rate < np.inf:
            raise UserError(f"rate = {rate!r}: must be a positive number")
        if mode not in get_args(Asked):
            raise UserError(f"mode = {mode!r}: must be one of {', '.join(get_args(Asked))}")
        others = [path for path in space.paths if not path.startswith("prefilter.")]
        if isinstance(loss, Misfit) and others:
            raise UserError(f"the loss 'misfit' is that of the prefilter alone: {others[0]} has no part in it")

    @property
    def settings(self) -> dict[str, Any]:
        """All that decides the search, JSON-ready."""
        names = ("loss", "runs", "batch", "held_out", "steps", "rate", "check", "patience", "seed", "every", "fidelity")
        return {
            "scenario": described(self.scenario),
            **{name: described(getattr(self, name)) for name in (*names, "window", "mode")},
        }

    @property
    def chosen_mode(self) -> Literal["forward", "reverse"]:
        """Forward for a few numbers; also for a prefilter's: backward would keep the record of each run."""
        if self.mode != "auto":
            return self.mode
        few = len(self.space.maps) == len(self.paths) <= _FORWARD
        return "forward" if few or any(path.startswith("prefilter.") for path in self.paths) else "reverse"
