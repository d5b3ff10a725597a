"""Tables of the results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.page import Table
from experiments.statistics import at, rms
from experiments.vondrak_disturbed_base.paper import TABLE_5
from experiments.vondrak_disturbed_base.repeatability import METHODS
from experiments.vondrak_disturbed_base.schemes import GRADES, SCHEMES
from experiments.vondrak_disturbed_base.smoothing import Choice

__all__ = ["condition_table", "drive_table", "end", "real_table", "settling", "smoothing_table", "two_vector_table"]

COLUMNS = tuple(f"{scheme} (deg)" for scheme in SCHEMES)


def end(errors: Any, time: float | None = None) -> np.ndarray:
    """(runs, 1) heading errors (deg) at a time (s; None: the end)."""
    row = -1 if time is None else at(errors.time, time)
    return errors.phi[:, [row], 2]


def condition_table(name: str, found: Mapping[str, tuple[Any, np.ndarray | None]]) -> Table:
    """RMS of the heading error at the end per condition and method; where the floor is known, also what is above it."""
    table = Table(name, ("condition", "what", *COLUMNS))
    for condition, (of, floor) in found.items():
        for what in of["2: no filter"]:
            time = 60.0 if what.endswith("60 s") else None
            values = [end(of[scheme][what], time) for scheme in SCHEMES]
            table.add(condition, what, *(rms(v) for v in values))
            if floor is not None:
                table.add(condition, f"{what}, less the floor", *(rms(v - floor[:, None]) for v in values))
        if floor is not None:
            table.add(condition, "floor: the biases alone", *[rms(floor[:, None])] * len(SCHEMES))
    return table


def settling(errors: Any, within: float = 0.05) -> float:
    """Median over the runs of the time (s) from which the heading stays within so many deg of where it ends."""
    far = np.abs(errors.phi[:, :, 2] - errors.phi[:, -1:, 2]) > within
    far[:, 0] = True
    last = far.shape[1] - 1 - np.argmax(far[:, ::-1], axis=1)
    return float(np.median(errors.time[np.minimum(last + 1, len(errors.time) - 1)]))


def two_vector_table(found: Mapping[float, Any]) -> Table:
    """RMS of the heading error."""
    table = Table("two vectors", ("length", "vectors", *COLUMNS))
    for length, of in found.items():
        for what in of["2: no filter"]:
            table.add(f"{length:g} s", what, *(rms(end(of[scheme][what])) for scheme in SCHEMES))
    return table


def smoothing_table(found: Mapping[tuple[int, str], tuple[Choice, dict[float, Choice]]]) -> Table:
    """Cut-offs found, values, evaluations."""
    table = Table("smoothing", ("condition", "objective", "search", "cut-off (Hz)", "value", "evaluations"))
    for (condition, objective), (ga, gradients) in found.items():
        searches = {"genetic algorithm": ga} | {f"gradient from {x:g} Hz": of for x, of in gradients.items()}
        for search, of in searches.items():
            value = float(np.exp(-of.value)) if objective == "J" else of.value
            table.add(f"condition {condition}", objective, search, of.cutoff, value, of.evaluations)
    return table


def drive_table(found: Mapping[tuple[str, str], tuple[np.ndarray, np.ndarray]], labels: tuple[str, ...]) -> Table:
    """Table 5's idea: medians over the runs of RMS and largest position error."""
    heads = ("RMS (m)", "largest (m)", "RMS over scheme 2's")
    printed_heads = ("paper: RMS", "paper: largest", "paper: RMS over scheme 2's")
    table = Table("drive", ("sensors", "disturbance", "scheme", *heads, *printed_heads))
    for (grade, case), (mean, most) in found.items():
        j = list(GRADES).index(grade)
        for i, label in enumerate(labels):
            printed: tuple[Any, ...] = ("", "", "")
            if i + 1 in TABLE_5:
                printed = TABLE_5[i + 1][j], TABLE_5[i + 1][2 + j], TABLE_5[i + 1][j] / TABLE_5[2][j]
            ratio = float(np.median(mean[i] / mean[1]))
            table.add(grade, case, label, float(np.median(mean[i])), float(np.median(most[i])), ratio, *printed)
    return table


def real_table(found: Mapping[tuple[float, str, str], np.ndarray]) -> Table:
    """RMS and median of the differences from the reference."""
    table = Table("laser gyro", ("segments", "scheme", "deg", *METHODS))
    for length, scheme in dict.fromkeys((length, scheme) for length, scheme, _ in found):
        values = [found[length, scheme, method] for method in METHODS]
        row = f"{len(values[0])} of {length:g} s", scheme
        table.add(*row, "RMS", *(float(np.sqrt(np.mean(v**2))) for v in values))
        table.add(*row, "median", *(float(np.median(np.abs(v))) for v in values))
    return table
