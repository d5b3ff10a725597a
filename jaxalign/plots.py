"""Pictures of an alignment (needs the ``plots`` extra)."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxalign.errors import UserError
from jaxalign.log import Log
from jaxalign.metrics import attitude_error_deg, component_rms, reference_at
from jaxalign.rotation import euler_from_dcm
from jaxalign.solution import Solution, Status

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jaxalign.bounds import Bound

__all__ = ["GREY", "attitude", "bound", "compare", "panels", "require"]

GREY = "0.6"


def require() -> None:
    """Say how to get matplotlib if it is not there.

    Raises:
        UserError: matplotlib is missing.
    """
    backend = os.environ.pop("MPLBACKEND", None)  # not used here, and matplotlib refuses to load with an unknown one
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise UserError("pictures need matplotlib: pip install 'jaxalign[plots]'") from None
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend


def panels(rows: int, height: float) -> tuple[Figure, Any]:
    """A figure of a height (inches) and its panels, one above the other, that share the axis of time.

    Raises:
        UserError: matplotlib is missing.
    """
    require()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]


def _rebranched(headings: list[np.ndarray]) -> list[np.ndarray]:
    """Headings within 180 deg of where they mostly are, so that a vehicle going north does not jump across the axis."""
    settled = np.concatenate([h[len(h) // 4 :] for h in headings])
    settled = np.deg2rad(settled[np.isfinite(settled)])
    centre = np.rad2deg(np.arctan2(np.sin(settled).sum(), np.cos(settled).sum()))
    return [np.mod(h - centre + 180.0, 360.0) + centre - 180.0 for h in headings]


def _unbroken(heading: np.ndarray) -> np.ndarray:
    """NaN where the heading passes north, so that no line is drawn across the picture."""
    out = heading.copy()
    out[1:][np.abs(np.diff(heading)) > 180.0] = np.nan
    return out


def _settled_limits(axis: Any, values: list[np.ndarray], floor: float) -> None:
    """Limits that show all but the first quarter: the wild beginning may leave the frame."""
    settled = np.concatenate([v[len(v) // 4 :].ravel() for v in values])
    settled = settled[np.isfinite(settled)]
    if settled.size:
        low, high = settled.min(), settled.max()
        pad = max(0.1 * (high - low), floor)
        axis.set_ylim(low - pad, high + pad)


def _shade_unobservable(axes: Any, solution: Solution, time: np.ndarray) -> None:
    seen = np.flatnonzero(np.asarray(solution.observable))
    end = time[seen[0]] if seen.size else time[-1]
    if end > time[0]:
        for i, axis in enumerate(axes):
            axis.axvspan(time[0], end, color="0.92", zorder=0, label=None if i else "heading not yet\nobservable")


def attitude(solution: Solution, log: Log, title: str = "") -> Figure:
    """Pitch, roll, heading with the reference where there is one, errors, and residuals over time.

    Where the method states standard deviations, the heading has a band of one of them, and the errors have them beside.

    Args:
        solution: of one log (no batch axes).
        log: that was aligned.
        title: of the picture.

    Returns:
        A figure; ``figure.savefig(...)`` writes it.
    """
    numbers = solution.to_numpy()
    time = numbers["t"] + log.t0
    reference = reference_at(log, numbers["t"])
    error = attitude_error_deg(solution, log)
    figure, axes = panels(4 if error is None else 6, 10 if error is None else 13.5)
    sd = numbers.get("sd_deg")
    truth = None if reference is None else np.rad2deg(np.array(euler_from_dcm(reference)))

    shown = numbers["euler_deg"].copy()
    shown[:, 2] = numbers["heading_deg"]
    if truth is not None:
        truth[:, 2] = np.mod(-truth[:, 2], 360.0)
    for i, name in enumerate(("pitch", "roll", "heading")):
        lines = [shown[:, i]] if truth is None else [shown[:, i], truth[:, i]]
        if name == "heading":
            lines = _rebranched(lines)
            axes[i].yaxis.set_major_formatter(lambda x, _: f"{x % 360:g}")
        axes[i].plot(time, _unbroken(lines[0]), label="estimate")
        if truth is not None:
            axes[i].plot(time, _unbroken(lines[1]), "--", color=GREY, label="reference")
        if name == "heading" and sd is not None:
            band = np.stack([lines[0] - sd[:, 2], lines[0] + sd[:, 2]])
            axes[i].fill_between(time, *band, alpha=0.2, linewidth=0, label="its own sd")
        axes[i].set_ylabel(f"{name} (deg)")
        _settled_limits(axes[i], lines, 0.5 if name == "heading" else 0.01)
    last = 3
    if error is not None:
        axes[3].plot(time, error[:, 0], label="east")
        axes[3].plot(time, error[:, 1], label="north")
        axes[3].set_ylabel("level error (deg)")
        _settled_limits(axes[3], [error[:, :2]], 0.002)
        axes[4].semilogy(time, np.maximum(np.abs(error[:, 2]), 1e-6), color="C3", label="|error|")
        axes[4].set_ylabel("heading error (deg)")
        if sd is not None:
            axes[4].semilogy(time, sd[:, 2], "--", color=GREY, label="its own sd")
            axes[3].plot(time, np.hypot(sd[:, 0], sd[:, 1]) / np.sqrt(2), "--", color=GREY, label="its own sd")
        last = 5
    _residuals(axes[last], time, solution, numbers)
    axes[last].set_xlabel("time (s)")
    _shade_unobservable(axes, solution, time)
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small", frameon=False)
    figure.suptitle(title or log.name)
    return figure


def _residuals(axis: Any, time: np.ndarray, solution: Solution, numbers: dict[str, np.ndarray]) -> None:
    """Of one velocity in m/s; of several aids, or of single components, in standard deviations."""
    defined = (numbers["status"] & Status.UNDEFINED) == 0
    if any(f"{name}_residual" in numbers for name in solution.aids):
        for name in solution.aids:
            value, weight, sd = (numbers[f"{name}_{key}"] for key in ("residual", "weight", "sd"))
            size = component_rms(value) / sd
            used = defined & (weight > 0) & (size > 0)
            axis.semilogy(time, np.where(used, size, np.nan), ".", markersize=3, label=f"{name}\nper component")
        axis.axhline(1.0, color=GREY, linestyle=":")
        axis.set_ylabel("residual\n(standard deviations)")
        return
    used, sd = defined & (numbers["weight"] > 0), float(numbers["aid_sd"][-1])
    size = np.where(used, np.linalg.norm(numbers["residual"], axis=1), np.nan)
    axis.semilogy(time, np.maximum(size, 1e-9), ".", markersize=3, label="|residual|")
    axis.axhline(sd, color=GREY, linestyle=":", label=f"white noise\n{sd:.2g} m/s")
    axis.set_ylabel("residual (m/s)")


def compare(solutions: dict[str, Solution], log: Log, title: str = "") -> Figure:
    """Errors of several methods on one log with a reference.

    Args:
        solutions: name -> solution.
        log: with a reference attitude.
        title: of the picture.

    Raises:
        UserError: the log has no reference.
    """
    if log.C_nb is None:
        raise UserError(f"{log.name} has no reference attitude to compare with")
    figure, axes = panels(3, 8)
    names = ("level error east", "level error north", "heading error")
    for name, solution in solutions.items():
        error = attitude_error_deg(solution, log)
        assert error is not None
        time = np.asarray(solution.time) + log.t0
        for i in range(3):
            axes[i].semilogy(time, np.maximum(np.abs(error[:, i]), 1e-6), label=name, linewidth=1.2)
    for axis, label in zip(axes, names, strict=True):
        axis.set_ylabel(f"|{label}| (deg)")
        axis.grid(alpha=0.3, which="both")
        axis.legend(loc="upper right", fontsize="small")
    axes[-1].set_xlabel("time (s)")
    figure.suptitle(title or log.name)
    return figure


def bound(found: Bound, title: str = "") -> Figure:
    """The Cramer-Rao bound over time.

    Args:
        found: of :func:`jaxalign.bounds.bound`.
        title: of the figure.
    """
    figure, axes = panels(3, 8)
    for i, (axis, name) in enumerate(zip(axes, ("pitch", "roll", "yaw"), strict=True)):
        axis.plot(found.time[1:], found.euler_deg[1:, i], color="k")
        axis.set_yscale("log")
        axis.set_ylabel(f"{name}, least\nstandard deviation (deg)")
        axis.grid(True, which="both", color="0.9", linewidth=0.6)
    axes[-1].set_xlabel("time (s)")
    axes[0].set_title(f"{title}: Cramér-Rao bound".removeprefix(": "), fontsize="medium")
    return figure
