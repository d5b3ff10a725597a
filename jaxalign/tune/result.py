"""What a search found, and how."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from importlib import metadata
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from jaxalign.errors import UserError
from jaxalign.method_file import write_method

if TYPE_CHECKING:
    from jaxalign.tune.settings import Tune

__all__ = ["History", "Tuned"]


@dataclass
class History:
    """Every step.

    Attributes:
        paths: of what is tuned.
        loss: over the runs of the step, before it.
        values: path -> the numbers, before the step.
        slopes: path -> the derivative by the free numbers (largest in size, where a path has many).
        seconds: since the start, compilation included.
        steps: at which the runs held out were looked at.
        held: the loss over them.
    """

    paths: tuple[str, ...]
    loss: list[float] = field(default_factory=list)
    values: dict[str, list[float]] = field(default_factory=dict)
    slopes: dict[str, list[float]] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)
    steps: list[int] = field(default_factory=list)
    held: list[float] = field(default_factory=list)

    def step(self, loss: float, values: dict[str, float], slopes: Any, seconds: float) -> None:
        """Add a step."""
        self.loss.append(loss)
        self.seconds.append(seconds)
        for path, value in values.items():
            self.values.setdefault(path, []).append(value)
        for path in self.paths:
            flat = np.concatenate([np.ravel(x) for x in jax.tree.leaves(slopes[path])])
            self.slopes.setdefault(path, []).append(float(flat[np.argmax(np.abs(flat))]))

    def held_out(self, step: int, loss: float) -> None:
        """A look at the runs held out, before a step."""
        self.steps.append(step)
        self.held.append(loss)


@dataclass(frozen=True)
class Tuned:
    """The result of a search.

    Attributes:
        tune: what was asked.
        mode: of differentiation, "forward" or "reverse".
        method: the best over the runs held out; the start, if nothing was better.
        start: path -> number at the start.
        values: path -> number of `method`.
        history: every step.
        best: loss of `method` over the runs held out.
        gain: change of that loss from the start, over the same runs, and its standard error (NaN: not known).
        stopped: why the search ended.
        evaluations: runs that were simulated or differentiated (those held out not counted).
        seconds: all of it took.
    """

    tune: Tune
    mode: str
    method: Any
    start: dict[str, float]
    values: dict[str, float]
    history: History
    best: float
    gain: tuple[float, float]
    stopped: str
    evaluations: int
    seconds: float

    def rows(self) -> tuple[list[str], list[list[str]]]:
        """A table: head and rows."""
        rows = [[path, f"{self.start[path]:.6g}", f"{value:.6g}"] for path, value in self.values.items()]
        return ["parameter", "start", "tuned"], rows

    @property
    def summary(self) -> str:
        """What became of the loss, in a line."""
        unit = getattr(self.tune.loss, "unit", "")
        change, error = self.gain
        sure = f" ({change:+.3g} ± {error:.1g})" if np.isfinite(error) and change else ""
        return (
            f"loss over {self.tune.held_out} runs held out: {self.history.held[0]:.6g} -> {self.best:.6g} {unit}{sure}"
            f"; {self.stopped}"
        )

    @property
    def entries(self) -> dict[str, Any]:
        """Settings, result and history, JSON-ready."""
        h = self.history
        return {
            "jaxalign": metadata.version("jaxalign"),
            "settings": self.tune.settings,
            "mode": self.mode,
            "start": self.start,
            "values": self.values,
            "held_out": {"start": h.held[0], "best": self.best, "gain": self.gain[0], "gain_se": _known(self.gain[1])},
            "stopped": self.stopped,
            "evaluations": self.evaluations,
            "seconds": self.seconds,
            "history": {
                "loss": h.loss,
                "values": h.values,
                "slopes": h.slopes,
                "seconds": h.seconds,
                "steps": h.steps,
                "held_out": h.held,
            },
        }

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the method and how it was found, for `--method-file` and :func:`jaxalign.method_file.read_method`.

        Raises:
            UserError: the method was not given as the name of a recipe, or the file cannot be written.
        """
        if self.tune.recipe is None:
            raise UserError(
                "only a method made by a recipe can be written: name it (method='roba', or recipe='roba' beside it)"
            )
        write_method(path, self.tune.recipe, self.method, tuned=self.entries)


def _known(x: float) -> float | None:
    return x if np.isfinite(x) else None
