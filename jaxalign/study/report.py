"""Of the result of a study: its table, statistics over time as CSV, a picture, and the files of all of them."""

from __future__ import annotations

import csv as csv_format
import io
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxalign import plots
from jaxalign.files import replacing
from jaxalign.study.result import Result
from jaxalign.study.statistics import AXES, PERCENTILES
from jaxalign.tables import Estimate
from jaxalign.tables import markdown as markdown_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jaxalign.bounds import Bound

__all__ = ["csv", "markdown", "picture", "rows", "shown", "write"]


def shown(value: float, error: float = np.nan, unit: str = "") -> str:
    """A number with its standard error; a word where there is none."""
    if not np.isfinite(value):
        return "never" if np.isposinf(value) and unit == " s" else "-"
    return f"{Estimate(value, error)}{unit}"


def rows(result: Result) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table: one row a method, accuracies over the window."""
    study = result.study
    start, stop = study.window
    tolerance = f"{study.tolerance_deg:g}°"
    reference = next(iter(result.methods))
    head = [
        "method",
        *(f"{axis} RMSE {start:g}-{stop:g} s, °" for axis in AXES),
        f"yaw RMSE / {reference}",
        "yaw 95 % at end, °",
        f"yaw within {tolerance} at end",
        f"yaw within {tolerance} from (median)",
        "failed runs",
    ]
    out = []
    for label, method in result.methods.items():
        accuracy, ratio = method.accuracy, method.ratio(result.methods[reference])
        late = [shown(100 * method.within.value[-1, 2], 100 * method.within.error[-1, 2], " %")]
        late.append(shown(method.convergence.value[2], method.convergence.error[2], " s"))
        failed = max(method.failed.max(), method.undefined[-1])
        out.append(
            [
                label,
                *(shown(accuracy.value[i], accuracy.error[i]) for i in range(3)),
                "1" if label == reference else shown(ratio.value[2], ratio.error[2]),
                shown(method.percentiles.value[1, -1, 2], method.percentiles.error[1, -1, 2]),
                *late,
                f"{100 * failed:.3g} %",
            ]
        )
    return head, out


def markdown(result: Result) -> str:
    """The table with its settings, for people."""
    head, cells = rows(result)
    lines = [
        f"# {result.title}",
        "",
        markdown_table(head, cells),
        "",
        "Errors are estimate minus truth; ± is the Monte Carlo standard error (missing: too few runs to tell). All "
        "methods see the same runs; the ratio's error is that of the paired runs. Failed: runs without an attitude "
        "at the end, or with a number that is not finite.",
        "",
    ]
    return "\n".join(lines)


def csv(result: Result) -> str:
    """Statistics over time: a row for each method, time and angle."""
    stream = io.StringIO()
    writer = csv_format.writer(stream, lineterminator="\n")
    shares = [f"p{p:g}" for p in PERCENTILES]
    names = ["mean", "rmse", *shares]
    writer.writerow(
        ["method", "time_s", "angle"]
        + [f"{name}_deg{se}" for name in names for se in ("", "_se")]
        + ["within", "within_se", "undefined", "failed"]
    )
    for label, m in result.methods.items():
        percentiles = [Estimate(m.percentiles.value[i], m.percentiles.error[i]) for i in range(len(PERCENTILES))]
        for k, t in enumerate(m.time_s):
            for i, axis in enumerate(AXES):
                cells = [x for e in (m.mean, m.rmse, *percentiles, m.within) for x in (e.value[k, i], e.error[k, i])]
                writer.writerow([label, f"{t:.9g}", axis, *(f"{x:.8g}" for x in (*cells, m.undefined[k], m.failed[k]))])
    return stream.getvalue()


def picture(result: Result, limit: Bound | None = None) -> Figure:
    """Root mean square errors of a study over time, with their standard errors, and the share of good headings.

    Args:
        result: of :func:`jaxalign.study.run`.
        limit: the bound of its scenario, drawn beside them.
    """
    figure, axes = plots.panels(4, 11)
    for label, method in result.methods.items():
        time = method.time_s
        for i, axis in enumerate(axes[:3]):
            rmse, error = method.rmse.value[:, i], method.rmse.error[:, i]
            (line,) = axis.plot(time, rmse, label=label)
            axis.fill_between(time, rmse - 2 * error, rmse + 2 * error, color=line.get_color(), alpha=0.25, linewidth=0)
        axes[3].plot(time, 100.0 * method.within.value[:, 2], label=label)
    if limit is not None:
        seen = np.asarray(limit.time) >= min(method.time_s[0] for method in result.methods.values())
        for i, axis in enumerate(axes[:3]):
            axis.plot(limit.time[seen], limit.euler_deg[seen, i], "k--", linewidth=1, label="Cramér-Rao bound")
    for axis, name in zip(axes, ("pitch", "roll", "yaw"), strict=False):
        axis.set_yscale("log")
        axis.set_ylabel(f"{name} RMSE (deg)")
    axes[3].set_ylabel(f"runs with yaw within\n{result.study.tolerance_deg:g} deg (%)")
    axes[3].set_ylim(-3, 103)
    axes[3].set_xlabel("time (s)")
    for axis in axes:
        axis.grid(True, which="both", color="0.9", linewidth=0.6)
    axes[0].legend(loc="upper right", fontsize="small", ncols=2)
    axes[0].set_title(f"{result.title}; bands: two standard errors", fontsize="medium")
    return figure


def write(result: Result, folder: str | os.PathLike[str], plot: bool = False) -> list[Path]:
    """Write results.npz, .csv, .md and perhaps .png; the paths.

    Raises:
        UserError: a file cannot be written, or matplotlib is missing.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / f"results.{kind}" for kind in ("npz", "csv", "md")]
    with replacing(written[0]) as stream:
        np.savez_compressed(stream, **result.arrays())  # pyright: ignore[reportArgumentType]
    for path, text in zip(written[1:], (csv(result), markdown(result)), strict=True):
        with replacing(path) as stream:
            stream.write(text.encode())
    if plot:
        from jaxalign.bounds import bound

        made = result.study.scenario
        limit = None if made.force is not None else bound(made)
        written.append(folder / "results.png")
        figure = picture(result, limit)
        with replacing(written[-1]) as stream:
            figure.savefig(stream, format="png")
    return written
