"""Tables of errors over the bound, and what they come to."""

from __future__ import annotations

import numpy as np

from experiments.bound.calibration import Calibration
from experiments.bound.conditions import Ratios
from experiments.page import Table

__all__ = ["OURS", "bound_table", "end_table", "findings", "level_table", "time_table"]

OURS = ("robust_map", "revising_oba", "centred_oba")
Found = dict[str, Ratios]


def bound_table(found: dict[str, Found]) -> Table:
    """The bound itself."""
    table = Table("bound", ("scenario", "condition", "time s", "east deg", "north deg", "heading deg"))
    for name, of in found.items():
        for label, one in of.items():
            for k in _thirds(one):
                table.add(name, label, float(one.time[k]), *(float(x) for x in one.bound[k]))
    return table


def _thirds(one: Ratios) -> list[int]:
    """Rows at one third, two thirds and the end."""
    last = len(one.time) - 1
    return [*list(dict.fromkeys(int(np.argmin(np.abs(one.time - one.time[-1] * x))) for x in (1 / 3, 2 / 3))), last]


def end_table(name: str, of: Found) -> Table:
    """Heading at the end: RMS over the bound, and in brackets 99 % of the runs."""
    table = Table(f"{name}, heading at the end", ("recipe", *(x for label in of for x in (label, "99 %"))))
    for recipe in next(iter(of.values())).rms:
        cells = [float(x) for one in of.values() for x in (one.rms[recipe][-1, 2], one.high[recipe][-1, 2])]
        table.add(recipe, *cells)
    return table


def time_table(name: str, of: Found) -> Table:
    """Heading over time: RMS over the bound."""
    one = next(iter(of.values()))
    rows = _thirds(one)
    columns = tuple(f"{label}: {one.time[k]:g} s" for label in of for k in rows)
    table = Table(f"{name}, heading over time", ("recipe", *columns))
    for recipe in one.rms:
        table.add(recipe, *(float(x.rms[recipe][k, 2]) for x in of.values() for k in rows))
    return table


def level_table(name: str, of: Found) -> Table:
    """Level at the end: RMS over the bound, the worse of the two axes."""
    table = Table(f"{name}, level at the end", ("recipe", *of))
    for recipe in next(iter(of.values())).rms:
        table.add(recipe, *(float(one.rms[recipe][-1, :2].max()) for one in of.values()))
    return table


def _range(values: list[float]) -> str:
    return f"{min(values):.2f} to {max(values):.2f}"


def findings(moving: dict[str, Found], calibrated: dict[str, dict[str, Calibration]]) -> str:
    """The numbers that matter, from the tables."""
    lines = []
    for recipe in OURS:
        parts = []
        for name, of in moving.items():
            worst = max(of, key=lambda label, of=of: of[label].rms[recipe][-1, 2])
            parts.append(f"{name} {_range([float(one.rms[recipe][-1, 2]) for one in of.values()])} (worst: {worst})")
        lines.append(f"- `{recipe}`: RMS heading error at the end over the bound, by condition: {'; '.join(parts)}.")
    for label in ("clean", "10 %"):
        parts = []
        for name, of in moving.items():
            if label in of:
                others = {x: float(v[-1, 2]) for x, v in of[label].rms.items() if x not in OURS}
                best = min(others, key=lambda x, others=others: others[x])
                parts.append(f"{name} {best} {others[best]:.2f}")
        lines.append(f"- The best published method, {label}: {'; '.join(parts)}.")
    covered = {case: 100 * of["robust_map"].covered for case, of in calibrated.items() if "robust_map" in of}
    lines.append(
        "- The 95 % intervals of `robust_map` cover (east, north, heading): "
        + "; ".join(f"{case}: {', '.join(f'{x:.0f}' for x in values)} %" for case, values in covered.items())
        + "."
    )
    poor = [
        f"{name} ({case}: {100 * one.covered[2]:.0f} %)"
        for case, of in calibrated.items()
        for name, one in of.items()
        if one.covered[2] < 0.85
    ]
    if poor:
        lines.append(f"- Heading intervals that cover less than 85 %: {', '.join(poor)}.")
    return "\n".join(lines)
