"""Errors over the bound over time, and over what was stated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.bound.calibration import Calibration
from experiments.bound.conditions import Ratios
from experiments.figures import finish, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["calibrated", "over_time"]

_TOP = 100.0


def over_time(name: str, found: dict[str, Ratios]) -> Figure:
    """A panel per condition, a line per recipe: RMS heading error over the bound's."""
    columns = min(len(found), 4)
    rows = -(-len(found) // columns)
    axes = panels(rows, columns, width=11.0, height=1.2 + 2.9 * rows, sharex=True, sharey=True)
    for axis in axes.flat[len(found) :]:
        axis.set_visible(False)
    for axis, (label, one) in zip(axes.flat, found.items(), strict=False):
        for i, (recipe, ratio) in enumerate(one.rms.items()):
            ours = recipe in ("robust_map", "revising_oba")
            style = {"linewidth": 2.4 if ours else 1.2, "marker": "o" if ours else "", "markersize": 3}
            axis.semilogy(
                one.time, ratio[:, 2], color=f"C{i % 10}", linestyle="-" if i < 10 else ":", label=recipe, **style
            )
        axis.axhline(1.0, color="black", linestyle="--", linewidth=1.0, label="bound")
        axis.set_ylim(0.5, _TOP)
        axis.set_title(label, fontsize="medium")
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    for axis in axes[:, 0]:
        axis.set_ylabel("RMS heading error / bound (1)")
    return finish(axes, name, 6)


def calibrated(found: dict[str, dict[str, Calibration]]) -> Figure:
    """NEES of each recipe and case; 1 where the stated covariance holds."""
    names = list(dict.fromkeys(name for of in found.values() for name in of))
    axes = panels(1, 1, width=10.0, height=5.0)
    axis = axes[0, 0]
    axis.axhline(1.0, color="black", linestyle="--", linewidth=1.0, label="holds")
    for i, (case, of) in enumerate(found.items()):
        where = [names.index(name) for name in of]
        axis.semilogy(where, [one.nees.value for one in of.values()], "o", color=f"C{i}", label=case, alpha=0.8)
    axis.set_xticks(range(len(names)), names, rotation=45, ha="right")
    axis.set_ylabel("NEES / 3 (1)")
    return finish(axes, "Errors squared over the stated covariance, at the end", 3)
