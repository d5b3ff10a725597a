"""Tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.embedding.doppler import DOPPLER, LABELS, NAMES, SD, UNITS, LogRun, Simulated
from experiments.embedding.outliers import Weights
from experiments.embedding.pictures import IN
from experiments.page import Table
from experiments.statistics import mean, rms, share
from jaxalign.tables import Estimate

__all__ = ["beyond_table", "estimate_table", "heading_table", "log_heading_table", "log_table", "weight_table"]

TOLERANCE_DEG = 1.0


def estimate_table(found: Mapping[str, Simulated]) -> Table:
    """Errors of the estimates beside what is stated."""
    columns = "sd beforehand", "sd stated (median)", "RMS error", "mean error", "RMS of error / sd"
    table = Table("Doppler log", ("scenario", "unknown", *columns))
    for name, one in found.items():
        for i in range(DOPPLER):
            error, sd = one.found.values[:, i] - one.truth[:, i], one.found.sd[:, i]
            wrong, middle = (error / UNITS[i])[:, None], float(np.median(sd) / UNITS[i])
            row = float(SD[i] / UNITS[i]), middle, rms(wrong), mean(wrong), rms((error / sd)[:, None])
            table.add(name, f"{NAMES[i]}, {IN[i]}", *row)
    return table


def heading_table(found: Mapping[str, Simulated]) -> Table:
    """Heading at the end, with and without."""
    table = Table("heading at the end", ("", *(f"{name}: RMSE deg" for name in found)))
    for label in LABELS:
        table.add(label, *(rms(one.heading[label]) for one in found.values()))
    return table


def log_table(found: Sequence[LogRun]) -> Table:
    """What was found, beside what the reference says."""
    shown = (0, 1, 2, 3, 6)
    columns = [x for i in shown for x in (f"{NAMES[i]}, {IN[i]}", "reference")]
    table = Table("logs", ("log", "turns, deg", *columns))
    for run in found:
        cells: list[Estimate | float] = []
        for i in shown:
            cells += [Estimate(run.values[i] / UNITS[i], run.sd[i] / UNITS[i]), float(run.reference[i] / UNITS[i])]
        table.add(run.name, round(run.turned), *cells)
    return table


def log_heading_table(found: Sequence[LogRun]) -> Table:
    """Heading of the logs at the end."""
    labels = list(found[0].heading)
    table = Table("heading of the logs", ("log", *(f"{label}: heading error deg" for label in labels)))
    for run in found:
        table.add(run.name, *run.heading.values())
    table.add("RMS", *(float(np.sqrt(np.mean([run.heading[x] ** 2 for run in found]))) for x in labels))
    return table


def weight_table(found: Weights) -> Table:
    """Heading RMSE by outliers and method."""
    methods = list(next(iter(found.errors.values())))
    table = Table("heading RMSE deg", ("outliers", *methods))
    for condition, errors in found.errors.items():
        table.add(condition, *(rms(errors[label]) for label in methods))
    return table


def beyond_table(found: Weights) -> Table:
    """Runs that are lost."""
    methods = [x for x in next(iter(found.errors.values())) if x.startswith("centred")]
    table = Table(f"share of the runs beyond {TOLERANCE_DEG:g} deg", ("outliers", *(f"{x}, %" for x in methods)))
    for condition, errors in found.errors.items():
        table.add(condition, *(share(errors[label][:, 0] > TOLERANCE_DEG) for label in methods))
    return table
