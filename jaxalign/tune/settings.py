"""What is tuned, on what, for what: checked before anything is traced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from jaxalign.arguments import check_choice, whole_number
from jaxalign.errors import UserError
from jaxalign.normalised import Normalised
from jaxalign.simulate import Scenario
from jaxalign.study.epochs_spec import Fidelity
from jaxalign.study.settings import Study, described
from jaxalign.tune.losses import Misfit, loss_of
from jaxalign.tune.space import Space, space_of

__all__ = ["Tune"]

Asked = Literal["auto", "forward", "reverse"]
_FORWARD = 3
"""Numbers up to which a tangent each costs less than a pass backward (benchmarks/tuning.md)."""


@dataclass(frozen=True)
class Tune:
    """A search for the numbers of a method that make a loss small, by its gradient, over the same simulated runs.

    Attributes:
        scenario: a :class:`jaxalign.simulate.Scenario` (given by itself or its name).
        method: where the search starts (given by itself or the name of its recipe).
        paths: what is tuned ("weight.threshold", ...), see :func:`jaxalign.tune.space_of`.
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

    scenario: Normalised[str | Scenario, Scenario] = Normalised()
    method: Normalised[Any, Any] = Normalised()
    paths: Normalised[str | Sequence[str], tuple[str, ...]] = Normalised()
    loss: Any = "rmse"
    runs: int = 256
    batch: Normalised[int | None, int] = Normalised(None)
    held_out: int = 1024
    steps: int = 100
    rate: float = 0.1
    check: int = 5
    patience: int = 6
    seed: int = 0
    every: int = 10
    fidelity: Fidelity = "increments"
    window: Normalised[tuple[float, float] | None, tuple[float, float]] = Normalised(None)
    mode: Asked = "auto"
    recipe: str | None = None
    space: Space = field(init=False)

    def __post_init__(self):
        loss, window, batch, given = loss_of(self.loss), self.window, self.batch, self.method
        if window is None and getattr(loss, "whole", False):
            window = (0.0, np.inf)
        runs = whole_number("runs", self.runs, 2, 10**6)
        methods = [given] if isinstance(given, str) else {"method": given}
        study = Study(self.scenario, methods, runs, self.seed, self.every, self.fidelity, window=window)
        method = next(iter(study.methods.values()))
        space = space_of(method, self.paths)
        put = {
            "scenario": study.scenario,
            "method": method,
            "paths": space.paths,
            "loss": loss,
            "runs": runs,
            "batch": runs if batch is None else whole_number("batch", batch, 2, runs),
            "held_out": whole_number("held_out", self.held_out, 2, 10**6),
            "steps": whole_number("steps", self.steps, 1, 10**6),
            "check": whole_number("check", self.check, 1, 10**6),
            "patience": whole_number("patience", self.patience, 0, 10**6),
            "window": study.window,
            "recipe": given if isinstance(given, str) else self.recipe,
            "space": space,
        }
        for name, value in put.items():
            object.__setattr__(self, name, value)
        rate = self.rate
        if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 < rate < np.inf:
            raise UserError(f"rate = {rate!r}: must be a positive number")
        check_choice("mode", self.mode, get_args(Asked))
        others = [path for path in space.paths if not path.startswith("front_end.prefilter.")]
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
        return "forward" if few or any(path.startswith("front_end.prefilter.") for path in self.paths) else "reverse"
