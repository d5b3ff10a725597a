"""A picture of a search."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jaxalign import plots
from jaxalign.tune.result import Tuned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["picture"]


def picture(tuned: Tuned) -> Figure:
    """The search of :func:`jaxalign.tune.run`: loss and numbers over the steps.

    Args:
        tuned: what was found; parts of a method that are no single number are not drawn.
    """
    history = tuned.history
    figure, axes = plots.panels(1 + len(history.values), 2.5 + 2.2 * (1 + len(history.values)))
    best = history.steps[int(np.argmin(history.held))]
    axes[0].plot(history.loss, label="the runs of the step")
    axes[0].plot(history.steps, history.held, "o-", markersize=4, label=f"{tuned.tune.held_out} runs held out")
    axes[0].set_ylabel(f"loss ({getattr(tuned.tune.loss, 'unit', 'as given')})")
    for axis, (path, values) in zip(axes[1:], history.values.items(), strict=True):
        axis.plot(values, color=plots.GREY)
        axis.plot(min(best, len(values)), tuned.values[path], "C1o", label=f"kept: {tuned.values[path]:.4g}")
        axis.set_ylabel(path)
        if min(values) > 0 and max(values) > 10 * min(values):
            axis.set_yscale("log")
    for axis in axes:
        axis.grid(True, which="both", color="0.9", linewidth=0.6)
        axis.legend(loc="upper right", fontsize="small")
    axes[-1].set_xlabel("step")
    axes[0].set_title(f"{tuned.tune.recipe or 'method'} on {tuned.tune.scenario.name}", fontsize="medium")
    return figure
