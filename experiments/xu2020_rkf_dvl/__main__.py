"""`python -m experiments.xu2020_rkf_dvl`: DVL-aided alignment with vectors reconstructed by a robust Kalman filter."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from experiments import dvl  # noqa: E402
from experiments.command import run  # noqa: E402
from experiments.monte_carlo import Errors  # noqa: E402
from experiments.page import Page, Table  # noqa: E402
from experiments.statistics import at, per_run, rms, share  # noqa: E402
from experiments.xu2020_rkf_dvl.findings import early_findings, findings  # noqa: E402
from experiments.xu2020_rkf_dvl.pictures import errors_over_time, vectors, vectors_over_time  # noqa: E402

SCENARIO = "dvl-sturn"
CONDITIONS: dict[str, dict[str, Any]] = {
    "clean": {},
    "fixed": {"outliers": "fixed"},
    "segment": {"outliers": "segment"},
}
METHODS: dict[str, dvl.Choice] = {
    "oba": ("oba", {}),
    "oba, as published": ("oba_as_published", {}),
    "rkf_oba": ("rkf_oba", {}),
    "rkf_oba, as published": ("rkf_oba_as_published", {}),
    "rkf_oba, zero start": ("rkf_oba", {"reconstruct.drop_constant": True, "reconstruct.process_variance": 1e-8}),
    "roba": ("roba", {}),
    "centred_oba": ("centred_oba", {}),
}
EARLY = ("oba", "rkf_oba", "rkf_oba, zero start", "roba", "centred_oba")
EARLY_S, EARLY_TIMES, BAD_DEG = 10.0, 25, 5.0
PAPER = {  # Xu et al. (2020), section IV-A, text after Fig. 6: one run, schemes 2 to 4
    "time s": 200.0,
    "pitch and roll deg": 0.01,
    "yaw deg": 1.0,
}
INTRODUCTION = """\
Scenario `{scenario}`: 300 s of S-turns at 5 m/s, Doppler log at 1 Hz with 0.1 m/s of noise; the paper shows its
trajectory as a figure only. Fixed outliers: 2 % of the velocities after the first, noise times 300, (41). Segment
outliers: Table 3 of Shen et al. (2025). The runs are the same for all methods and conditions.

Numbers are RMSE over all runs and the last 50 s, with standard errors from the spread between runs. `yaw per run`: the
median, the 95 % point and the largest of the runs' own RMSE over the same time, deg. `as published`: Coriolis term by
recursion, transport rate neglected, and for `rkf_oba` the filter as printed. `zero start`: the fitted constant left out
of the vector, process noise 1e-8."""
CLAIM = """\
The paper: at {time s:g} s the errors of pitch and roll are below {pitch and roll deg:g} deg and that of yaw is below
{yaw deg:g} deg, for its method with and without outliers and for `oba` without them (section IV-A, one run). The share
of our runs:"""
Found = dict[str, dict[str, Errors]]


def accuracy_table(found: Found, condition: str) -> Table:
    """RMSE over the last 50 s, and of yaw over time."""
    columns = "pitch deg", "roll deg", "yaw deg", "yaw per run: median", "95 %", "max"
    table = Table(f"accuracy, {condition}", ("method", *columns, "yaw deg at 100 s", "200 s", "300 s"))
    for label, errors in found[condition].items():
        later = [dvl.yaw_at(errors, t) for t in (100.0, 200.0, 300.0)]
        table.add(label, *dvl.accuracy(errors), *dvl.spread(errors), *later)
    return table


def claim_table(found: Found) -> Table:
    """How often the paper's numbers hold."""
    limits = f"yaw below {PAPER['yaw deg']:g} deg, %", f"pitch and roll below {PAPER['pitch and roll deg']:g} deg, %"
    table = Table("claim", ("outliers", "method", *limits, "all, %"))
    for condition, name in (("clean", "none"), ("fixed", "fixed")):
        for label, errors in found[condition].items():
            size = np.abs(errors.euler[:, at(errors.time, PAPER["time s"])])
            yaw, level = size[:, 2] < PAPER["yaw deg"], (size[:, :2] < PAPER["pitch and roll deg"]).all(axis=1)
            table.add(name, label, share(yaw), share(level), share(yaw & level))
    return table


def early_errors(found: Found, runs: int, seed: int) -> tuple[dict[str, dict[str, np.ndarray]], float]:
    """Yaw errors over the last 50 s by group of runs and by method, and the share of runs hit early.

    The groups: no outlier in the first seconds; some, from many more runs; and the first velocity one as well.
    """
    chosen, outliers = {label: METHODS[label] for label in EARLY}, CONDITIONS["fixed"]
    hit = dvl.early_hits(SCENARIO, outliers, EARLY_TIMES * runs, seed, EARLY_S)
    late, early, first = (
        f"none in the first {EARLY_S:g} s",
        f"some in the first {EARLY_S:g} s",
        "the first velocity too",
    )
    chunk = min(25, runs)  # no new program for another number of runs
    some = dvl.conditions(SCENARIO, {early: outliers}, chosen, np.flatnonzero(hit), seed, chunk=chunk)
    some |= dvl.conditions(SCENARIO, {first: {**outliers, "first": "always"}}, chosen, runs, seed)
    out = {late: {label: dvl.last(found["fixed"][label])[~hit[:runs], :, 2] for label in EARLY}}
    out |= {group: {label: dvl.last(e)[..., 2] for label, e in of.items()} for group, of in some.items()}
    return {group: of for group, of in out.items() if len(of["oba"]) > 1}, float(hit.mean())


def early_table(groups: dict[str, dict[str, np.ndarray]]) -> Table:
    """What early outliers cost."""
    columns = "runs", "yaw deg", "yaw per run: median", "max", f"runs above {BAD_DEG:g} deg"
    table = Table("early outliers", ("method", "outliers", *columns))
    for label in EARLY:
        for group, of in groups.items():
            each = per_run(of[label])
            bad = int((each > BAD_DEG).sum())
            table.add(label, group, len(each), rms(of[label]), float(np.median(each)), float(each.max()), bad)
    return table


def study(runs: int, seed: int) -> Page:
    """All conditions and methods, and the page on them."""
    found = dvl.conditions(SCENARIO, CONDITIONS, METHODS, runs, seed)
    groups, hit_share = early_errors(found, runs, seed)
    log, hit = dvl.log_with_outliers(SCENARIO, CONDITIONS["fixed"], seed)
    made = dvl.methods(METHODS)
    seen = {"measured": vectors(made["oba"], log), "reconstructed": vectors(made["rkf_oba"], log)}
    page = Page()
    page.add(
        "# Vectors reconstructed by a robust Kalman filter (Xu et al. 2020)",
        f"Written by `python -m experiments.xu2020_rkf_dvl --runs {runs} --seed {seed}`.",
        INTRODUCTION.format(scenario=SCENARIO),
        "## What comes out",
        findings(found, seen, hit, SCENARIO, METHODS),
    )
    for condition, title in (("clean", "No outliers"), ("fixed", "Fixed outliers"), ("segment", "Segment outliers")):
        page.add(f"## {title}", accuracy_table(found, condition))
    pair = {"no outliers": found["clean"], "fixed outliers": found["fixed"]}
    shown = "oba", "rkf_oba", "roba", "centred_oba"
    page.picture("errors", "Errors of pitch, roll and yaw over time", errors_over_time(pair, shown))
    title = f"{SCENARIO}: the vector in b0, one run with fixed outliers"
    page.picture("vectors", "Vectors of one run", vectors_over_time(seen, title))
    title = f"{SCENARIO}: weights of one run with fixed outliers"
    weight = dvl.run_weights({"roba": METHODS["roba"]}, log)
    page.picture("weights", "Weights of one run", dvl.weights_over_time(weight, log, hit, title))
    page.add(
        "## The paper's claim",
        CLAIM.format(**PAPER),
        claim_table(found),
        "## Outliers in the first seconds",
        early_findings(groups, hit_share, EARLY_TIMES * runs, BAD_DEG),
        early_table(groups),
    )
    return page


def main(arguments: Sequence[str] | None = None) -> int:
    """Study and write."""
    return run("experiments.xu2020_rkf_dvl", __doc__ or "", Path(__file__).parent, study, arguments, runs=400)


if __name__ == "__main__":
    sys.exit(main())
