"""Pictures of the searches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.figures import finish, panels
from experiments.tuning.searches import Searched

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["convergence", "landscapes"]


def landscapes(found: Sequence[Searched]) -> Figure:
    """The loss along each number, the others as tuned; where the searches end, and the way of the gradient."""
    cells = [(searched, path) for searched in found for path in searched.problem.paths]
    columns = 3
    axes = panels(-(-len(cells) // columns), columns, width=13.0, height=3.0 * -(-len(cells) // columns))
    for axis, (searched, path) in zip(axes.flat, cells, strict=False):
        x, loss = searched.slices[path]
        axis.plot(x, loss, color="0.4", label="landscape")
        way = np.array(searched.path[path])
        axis.plot(way, np.interp(np.log(way), np.log(x), loss), ".", color="C0", markersize=4, label="gradient's way")
        axis.plot(searched.gradient.values[path], searched.gradient.loss, "o", color="C0", label="gradient")
        axis.plot(searched.genetic.values[path], searched.genetic.loss, "s", color="C1", label="genetic algorithm")
        axis.plot(searched.grid.values[path], searched.grid.loss, "^", color="C2", label="grid")
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_title(searched.problem.label, fontsize=9)
        axis.set_xlabel(path, fontsize=9)
        axis.set_ylabel("heading RMSE (deg)", fontsize=9)
    for axis in axes.flat[len(cells) :]:
        axis.set_visible(False)
    return finish(axes, "each number alone, the others as the gradient left them", 5)


def convergence(found: Sequence[Searched]) -> Figure:
    """The best loss so far over the evaluations."""
    columns = 3
    axes = panels(-(-len(found) // columns), columns, width=13.0, height=3.0 * -(-len(found) // columns))
    for axis, searched in zip(axes.flat, found, strict=False):
        searches: Mapping[str, Any] = {
            "gradient": searched.gradient,
            "genetic algorithm": searched.genetic,
            "grid": searched.grid,
        }
        least = min(search.trace[-1] for search in searches.values())
        for i, (label, search) in enumerate(searches.items()):
            above = np.maximum(search.trace / least - 1, 1e-5)
            axis.loglog(np.arange(1, len(above) + 1), 100 * above, color=f"C{i}", label=label)
        axis.set_title(searched.problem.label, fontsize=9)
        axis.set_xlabel(f"evaluations, of {searched.runs} runs each")
        axis.set_ylabel("loss above the least (%)")
    for axis in axes.flat[len(found) :]:
        axis.set_visible(False)
    return finish(axes, "the best so far", 3)
