"""Pictures that the experiments share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.monte_carlo import Errors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["attitude_sizes", "finish", "panels", "sizes"]


def panels(rows: int, columns: int = 1, width: float = 9.0, height: float = 6.0, **share: Any) -> np.ndarray:
    """Axes (rows, columns) of a new figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), dpi=100, layout="constrained")
    FigureCanvasAgg(made)
    return made.subplots(rows, columns, squeeze=False, **share)


def sizes(axis: Any, time: np.ndarray, errors: dict[str, np.ndarray]) -> None:
    """Median over the runs (solid) and 95 % of them (dashed) of the errors' sizes, on a logarithmic axis.

    Args:
        axis: to draw on.
        time: (K,) s.
        errors: label -> (runs, K); where there is no attitude yet, NaN. The first are drawn widest, so that equal lines
            show.
    """
    for i, (label, values) in enumerate(errors.items()):
        known = np.isfinite(values).all(axis=0)
        middle, high = np.percentile(np.abs(values[:, known]), [50, 95], axis=0)
        style = {"color": f"C{i}", "linewidth": max(3.2 - 0.7 * i, 1.0)}
        axis.semilogy(time[known], middle, label=label, **style)
        axis.semilogy(time[known], high, linestyle="--", alpha=0.6, **style)


def finish(axes: np.ndarray, title: str, columns: int = 6) -> Figure:
    """Grids, a title, below a legend (so many columns) of what the first axes hold: the figure."""
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    made = axes.flat[0].figure
    made.suptitle(title)
    made.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=columns, frameon=False)
    return made


def attitude_sizes(
    found: Mapping[str, Errors], level: tuple[float, float], yaw: tuple[float, float], title: str, columns: int
) -> Figure:
    """Sizes of the errors in pitch, roll and yaw over time.

    Args:
        found: label -> errors, all at the same times.
        level: limits of pitch and roll, deg.
        yaw: limits of yaw, deg.
        title: of the figure.
        columns: of the legend.
    """
    axes, time = panels(3, 1, height=9.0, sharex=True), next(iter(found.values())).time
    for i, (name, limits) in enumerate((("pitch", level), ("roll", level), ("yaw", yaw))):
        sizes(axes[i, 0], time, {label: errors.euler[..., i] for label, errors in found.items()})
        axes[i, 0].set_ylabel(f"|{name} error| (deg)")
        axes[i, 0].set_ylim(*limits)
    axes[-1, 0].set_xlabel("time (s)")
    return finish(axes, f"{title}: median of the runs (solid), 95 % of them below (dashed)", columns)
