"""The result of a study: statistics by method."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxalign.study.statistics import AXES, PERCENTILES, MethodStatistics

if TYPE_CHECKING:
    from jaxalign.study.settings import Study

__all__ = ["Result"]

_TIMED = ("mean", "rmse", "within")


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
