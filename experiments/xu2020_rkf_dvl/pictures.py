"""Pictures: errors over time, vectors before and after reconstruction."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from experiments.figures import finish, panels, sizes
from experiments.monte_carlo import Errors
from jaxalign import Log, align

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Vectors", "errors_over_time", "vectors", "vectors_over_time"]


class Vectors(NamedTuple):
    """Vectors in b0 of one log, from its second epoch on.

    Attributes:
        time: (K,) s.
        bent: (K, 3) beta less its mean slope, m/s: what turns with the Earth, and the vehicle's start.
        wrong: (K, 3) beta less C_b0n0 alpha with the true attitude, m/s.
    """

    time: np.ndarray
    bent: np.ndarray
    wrong: np.ndarray


def vectors(method: Any, log: Log) -> Vectors:
    """The vectors that a method uses."""
    assert log.C_nb is not None
    solution = align(method, log)
    time, beta, alpha = (np.asarray(x)[1:] for x in (solution.time, solution.beta, solution.alpha))
    true = alpha @ log.C_nb[0]  # rows: C_b0n0 alpha
    return Vectors(time, beta - np.outer(time, true[-1] / time[-1]), beta - true)


def errors_over_time(found: dict[str, dict[str, Errors]], chosen: tuple[str, ...]) -> Figure:
    """Sizes of the errors in pitch, roll and yaw, one column per condition."""
    axes = panels(3, len(found), width=11.0, height=9.0, sharex=True, sharey="row")
    for column, (condition, of) in enumerate(found.items()):
        for i in range(3):
            sizes(axes[i, column], of[chosen[0]].time, {label: of[label].euler[..., i] for label in chosen})
        axes[0, column].set_title(condition, fontsize="medium")
        axes[-1, column].set_xlabel("time (s)")
    for i, (name, low, high) in enumerate((("pitch", 1e-3, 1.0), ("roll", 1e-3, 1.0), ("yaw", 0.1, 180.0))):
        axes[i, 0].set_ylabel(f"|{name} error| (deg)")
        axes[i, 0].set_ylim(low, high)
    return finish(axes, "sizes of the errors: median of the runs (solid), 95 % of them below (dashed)")


def vectors_over_time(found: dict[str, Vectors], title: str) -> Figure:
    """Vectors of one run and their errors, component by component."""
    axes = panels(3, 2, width=11.0, height=8.0, sharex=True)
    styles = {"marker": ".", "markersize": 3, "linewidth": 0.6}, {"linewidth": 1.4}
    for color, ((label, some), style) in enumerate(zip(found.items(), styles, strict=True)):
        for i, axis in enumerate("xyz"):
            for column, values in enumerate((some.bent, some.wrong)):
                axes[i, column].plot(some.time, values[:, i], color=f"C{color}", label=label, **style)
            axes[i, 0].set_ylabel(f"{axis} (m/s)")
    axes[0, 0].set_title("beta less its mean slope", fontsize="medium")
    axes[0, 1].set_title("beta less the true one (outliers leave the frame)", fontsize="medium")
    for axis in axes[:, 1]:
        axis.set_ylim(-0.8, 0.8)
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    return finish(axes, title)
