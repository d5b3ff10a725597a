"""Tables of the searches and of what they are worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.page import Table
from experiments.tuning.searches import Searched
from experiments.tuning.trial import Tried
from jaxalign.tables import Estimate
from jaxalign.tune import Tuned

__all__ = ["cutoff_table", "number_table", "search_table", "trial_table"]


def search_table(found: Sequence[Searched]) -> Table:
    """Losses over the runs that were learned from, and what they cost."""
    table = Table(
        "searches",
        (
            "problem",
            "runs",
            "loss untuned (deg)",
            "gradient",
            "gradient, least on its way",
            "genetic",
            "grid",
            "evaluations: gradient, until as good as genetic",
            "evaluations: genetic, until within 1 % of its end",
            "evaluations: genetic, all",
            "seconds: gradient",
            "seconds: genetic",
            "seconds: grid",
        ),
    )
    for s in found:
        reached = s.gradient.evaluations_to(s.genetic.loss * (1 + 1e-4))
        table.add(
            s.problem.label,
            s.runs,
            s.start,
            s.gradient.loss,
            float(s.gradient.trace[-1]),
            s.genetic.loss,
            s.grid.loss,
            int(reached) if np.isfinite(reached) else "not",
            int(s.genetic.evaluations_to(s.genetic.loss + 0.01 * abs(s.start - s.genetic.loss))),
            len(s.genetic.trace),
            s.gradient.seconds,
            s.genetic.seconds,
            s.grid.seconds,
        )
    return table


def number_table(found: Sequence[Searched]) -> Table:
    """The numbers."""
    table = Table("numbers", ("problem", "number", "untuned", "gradient", "genetic", "grid"))
    for s in found:
        for path in s.problem.paths:
            row = (s.path[path][0], *(search.values[path] for search in (s.gradient, s.genetic, s.grid)))
            table.add(s.problem.label, path, *row)
    return table


def trial_table(found: Sequence[Searched], own: Mapping[str, Tried], other: Mapping[str, Tried]) -> Table:
    """On new runs."""
    table = Table(
        "new runs",
        (
            "problem",
            "scenario",
            "untuned (deg)",
            "gradient (deg)",
            "genetic (deg)",
            "gradient / untuned",
            "genetic / untuned",
        ),
    )
    for s in found:
        for tried, (name, options) in ((own, s.problem.place), (other, s.problem.other)):
            t = tried[s.problem.label]
            place = ", ".join([name, *(f"{k}={v}" for k, v in options.items() if k != "duration")])
            rmse = [Estimate(*t.rmse[label]) for label in ("untuned", "gradient", "genetic")]
            table.add(s.problem.label, place, *rmse, *(Estimate(*t.ratio[label]) for label in ("gradient", "genetic")))
    return table


def cutoff_table(found: Mapping[tuple[int, float], Tuned]) -> Table:
    """Vondrak's cut-off."""
    table = Table(
        "cut-off", ("condition", "start (Hz)", "cut-off (Hz)", "theta = (2 pi f)^6 (rad^6/s^6)", "steps", "seconds")
    )
    for (condition, start), tuned in found.items():
        cutoff = tuned.values["front_end.prefilter.cutoff"]
        table.add(
            f"condition {condition}", start, cutoff, (2 * np.pi * cutoff) ** 6, len(tuned.history.loss), tuned.seconds
        )
    return table
