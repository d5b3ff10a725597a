"""The result of a study: statistics by method, as tables and files."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxalign.io.files import replacing
from jaxalign.study.statistics import AXES, PERCENTILES, Estimate, MethodStatistics

if TYPE_CHECKING:
    from jaxalign.study.settings import Study

__all__ = ["Result", "shown"]

_TIMED = ("mean", "rmse", "within")


def shown(value: float, error: float = np.nan, unit: str = "") -> str:
    """A number with its standard error, to two digits of it."""
    if not np.isfinite(value):
        return "never" if np.isposinf(value) and unit == " s" else "-"
    if np.isposinf(error):
        return f"{value:.3g} ± inf{unit}"
    if not (np.isfinite(error) and error > 0):
        return f"{value:.3g}{unit}"
    digits = max(0, 1 - int(np.floor(np.log10(error))))
    return f"{value:.{digits}f} ± {error:.{digits}f}{unit}"


@dataclass(frozen=True)
class Result:
    """What came out of a study.

    Attributes:
        study: what was done.
        methods: label -> statistics.
    """

    study: Study
    methods: Mapping[str, MethodStatistics]

    def __getitem__(self, label: str) -> MethodStatistics:
        return self.methods[label]

    @property
    def runs(self) -> int:
        """Runs that were finished."""
        return min(method.runs for method in self.methods.values())

    @property
    def title(self) -> str:
        """One line on what was done."""
        study = self.study
        return f"{study.scenario.name}, {self.runs} runs, seed {study.seed}, noise per {study.fidelity[:-1]}"

    def rows(self) -> tuple[list[str], list[list[str]]]:
        """Head and rows of the table: one row a method, accuracies over the window."""
        study = self.study
        start, stop = study.window
        tolerance = f"{study.tolerance_deg:g}°"
        reference = next(iter(self.methods))
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
        for label, method in self.methods.items():
            accuracy, ratio = method.accuracy, method.ratio(self.methods[reference])
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

    def markdown(self) -> str:
        """The table with its settings, for people."""
        head, rows = self.rows()
        lines = [f"# {self.title}", "", " | ".join(["", *head, ""]).strip(), "|".join(["", *["---"] * len(head), ""])]
        lines += [" | ".join(["", *row, ""]).strip() for row in rows]
        lines += [
            "",
            "Errors are estimate minus truth; ± is the Monte Carlo standard error (missing: too few runs to tell). All "
            "methods see the same runs; the ratio's error is that of the paired runs. Failed: runs without an attitude "
            "at the end, or with a number that is not finite.",
            "",
        ]
        return "\n".join(lines)

    def csv(self) -> str:
        """Statistics over time: a row for each method, time and angle."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        shares = [f"p{p:g}" for p in PERCENTILES]
        names = ["mean", "rmse", *shares]
        writer.writerow(
            ["method", "time_s", "angle"]
            + [f"{name}_deg{se}" for name in names for se in ("", "_se")]
            + ["within", "within_se", "undefined", "failed"]
        )
        for label, m in self.methods.items():
            percentiles = [Estimate(m.percentiles.value[i], m.percentiles.error[i]) for i in range(len(PERCENTILES))]
            for k, t in enumerate(m.time_s):
                for i, axis in enumerate(AXES):
                    cells = [
                        x for e in (m.mean, m.rmse, *percentiles, m.within) for x in (e.value[k, i], e.error[k, i])
                    ]
                    writer.writerow(
                        [label, f"{t:.9g}", axis, *(f"{x:.8g}" for x in (*cells, m.undefined[k], m.failed[k]))]
                    )
        return stream.getvalue()

    def arrays(self) -> dict[str, np.ndarray]:
        """All statistics, stacked over the methods (first axis), and the per-run numbers."""
        found = list(self.methods.values())
        out = {
            "methods": np.array(list(self.methods)),
            "angles": np.array(AXES),
            "percentages": np.array(PERCENTILES),
            "time_s": found[0].time_s,
            "settings": np.array(json.dumps(self.study.settings)),
        }
        for name in ("mean", "rmse", "percentiles", "within"):
            unit = "" if name == "within" else "_deg"
            out[f"{name}{unit}"] = np.stack([getattr(m, name).value for m in found])
            out[f"{name}{unit}_se"] = np.stack([getattr(m, name).error for m in found])
        for name, unit in (
            ("undefined", ""),
            ("failed", ""),
            ("end", "_deg"),
            ("window", "_rmse_deg"),
            ("converged_s", ""),
        ):
            out[f"{name}{unit}"] = np.stack([getattr(m, name) for m in found])
        return out

    def write(self, folder: str | os.PathLike[str], plot: bool = False) -> list[Path]:
        """Write results.npz, .csv, .md and perhaps .png; the paths.

        Raises:
            UserError: a file cannot be written, or matplotlib is missing.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        written = [folder / f"results.{kind}" for kind in ("npz", "csv", "md")]
        with replacing(written[0]) as stream:
            np.savez_compressed(stream, **self.arrays())  # pyright: ignore[reportArgumentType]
        for path, text in zip(written[1:], (self.csv(), self.markdown()), strict=True):
            with replacing(path) as stream:
                stream.write(text.encode())
        if plot:
            from jaxalign import plots
            from jaxalign.bounds import bound

            made = self.study.scenario
            limit = None if made.force is not None else bound(made)
            written.append(folder / "results.png")
            figure = plots.study(self, limit)
            with replacing(written[-1]) as stream:
                figure.savefig(stream, format="png")
        return written
