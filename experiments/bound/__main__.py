"""`python -m experiments.bound`: every recipe against the Cramer-Rao bound, and against its own standard deviations."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from experiments.bound.calibration import CASES, DRAWS, calibration, calibration_table  # noqa: E402
from experiments.bound.conditions import CONDITIONS, FACTOR, GAPS, MISSTATED, MOVING, ratios  # noqa: E402
from experiments.bound.pictures import calibrated, over_time  # noqa: E402
from experiments.bound.tables import bound_table, end_table, findings, level_table, time_table  # noqa: E402
from experiments.command import QUICK_RUNS, run  # noqa: E402
from experiments.page import Page  # noqa: E402

INTRODUCTION = """\
The bound (`jaxalign.bound`) is that of white noise of the aid and of the inertial unit, normal biases, and a first
velocity that is not known; outliers are left out of it, gaps are not. Errors are RMS over {runs} runs ({costly} on
dvl-accturn), 180 deg where a method has no attitude, over the bound at that time; 99 %: so many of the runs are below.
Biases are drawn from a normal distribution of the scenario's size, and `robust_map` and `fine` are told that size.
Outliers: the noise of a fix times {body:g} (Doppler log) or {nav:g} (GNSS), the first fix like the others. "bad first":
the first fix alone. Gaps: no fix in {gaps} of the time. "noise x {misstated:g}": that much more than is stated (the
bound is that of the true noise). Recipes as they are, every aid as it is meant: nothing is tuned. Real logs, with and
without outliers: [real_logs](../real_logs/results.md)."""


def study(runs: int, seed: int) -> Page:
    """All scenarios and conditions; with a few runs one of each."""
    few = runs <= QUICK_RUNS
    names, labels = (MOVING[-1:], ("clean", "10 %")) if few else (MOVING, tuple(CONDITIONS))
    moving = {name: {label: ratios(name, label, runs, seed) for label in labels} for name in names}
    standing = {} if few else {"sway": {"as it is": ratios("sway", None, max(runs // 4, 2), seed)}}
    cases = ["gps-zigzag, clean"] if few else list(CASES)
    stated = {case: calibration(case, max(runs // 2, 2), seed) for case in cases}
    accturn = moving.get("dvl-accturn", next(iter(moving.values())))
    page = Page()
    page.add(
        "# Every recipe against the Cramer-Rao bound",
        f"Written by `python -m experiments.bound --runs {runs} --seed {seed}`.",
        INTRODUCTION.format(
            runs=runs,
            costly=next(iter(accturn.values())).runs,
            gaps=", ".join(f"{100 * a:g}-{100 * b:g} %" for a, b in GAPS),
            misstated=MISSTATED,
            **FACTOR,
        ),
        "## What comes out",
        findings(moving, stated),
    )
    for name, of in moving.items():
        page.add(f"## {name}: heading at the end, RMS over the bound, and 99 % of the runs", end_table(name, of))
        page.picture(f"{name}", f"RMS heading error over the bound, {name}", over_time(name, of))
        page.add("Over time:", time_table(name, of), "Level at the end, the worse of two axes:", level_table(name, of))
    for name, of in standing.items():
        page.add(
            f"## {name}: a standing vehicle, nothing done to it",
            "The bound takes its velocity for exactly zero; every method grants it some noise.",
            end_table(name, of),
            "Level at the end, the worse of two axes:",
            level_table(name, of),
        )
    page.add(
        "## Calibration",
        f"Errors at the end against the stated covariance, {max(runs // 2, 2)} runs: NEES over its degrees of freedom "
        "(1 if the covariance holds), and how many 95 % intervals cover the error. `robust_map` and `fine` state their "
        f"own; for the others `jaxalign.assess` aligns each log {DRAWS} times with drawn errors.",
        calibration_table(stated),
    )
    page.picture("calibration", "NEES of every recipe", calibrated(stated))
    page.add("## The bound", bound_table(moving | standing))
    return page


def main(arguments: Sequence[str] | None = None) -> int:
    """Study and write."""
    return run("experiments.bound", __doc__ or "", Path(__file__).parent, study, arguments, runs=200)


if __name__ == "__main__":
    sys.exit(main())
