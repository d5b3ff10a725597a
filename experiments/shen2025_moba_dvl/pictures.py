"""Pictures: heading errors over time, and how they spread over the runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.dvl import last
from experiments.figures import finish, panels, sizes
from experiments.monte_carlo import Errors
from experiments.statistics import per_run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["heading_over_time", "histogram"]


def heading_over_time(found: dict[str, dict[str, Errors]]) -> Figure:
    """Size of the heading error: a column per simulation, a colour per method."""
    axes = panels(1, len(found), width=11.0, height=5.0, sharex=True, sharey=True)
    for axis, (simulation, of) in zip(axes[0], found.items(), strict=True):
        sizes(axis, next(iter(of.values())).time, {label: errors.euler[..., 2] for label, errors in of.items()})
        axis.set_title(simulation, fontsize="medium")
        axis.set_xlabel("time (s)")
    axes[0, 0].set_ylabel("|heading error| (deg)")
    axes[0, 0].set_ylim(0.2, 180.0)
    return finish(axes, "as published: median of the runs (solid), 95 % of them below (dashed)")


def histogram(found: dict[str, dict[str, Errors]]) -> Figure:
    """Heading RMSE of the single runs over the last 50 s; a row per method, the first one behind the others."""
    each = {s: {label: per_run(last(e)[..., 2]) for label, e in of.items()} for s, of in found.items()}
    everything = np.concatenate([x for of in each.values() for x in of.values()])
    bins = np.geomspace(everything.min() * 0.99, everything.max() * 1.01, 25)
    behind, *others = next(iter(each.values()))
    axes = panels(len(others), len(each), width=11.0, height=7.0, sharex=True, sharey=True)
    for column, (simulation, of) in enumerate(each.items()):
        for row, label in enumerate(others):
            axis = axes[row, column]
            axis.hist(of[behind], bins, color="0.85", label=f"{behind} (without outliers)")
            axis.hist(of[label], bins, histtype="step", color="C3", linewidth=1.6, label="with outliers")
            axis.set_title(f"{label}, {simulation}", fontsize="medium")
            axes[row, 0].set_ylabel("runs (1)")
        axes[-1, column].set_xlabel("heading RMSE of a run (deg)")
    axes[0, 0].set_xscale("log")
    axes[0, 0].xaxis.set_major_formatter("{x:g}")
    return finish(axes, "as published: heading RMSE over the last 50 s, run by run")
