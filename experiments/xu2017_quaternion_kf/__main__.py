"""`python -m experiments.xu2017_quaternion_kf`: self-alignment on a swaying base, Schemes 1 to 4."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)

from experiments.command import run  # noqa: E402
from experiments.figures import attitude_sizes  # noqa: E402
from experiments.monte_carlo import Errors, monte_carlo  # noqa: E402
from experiments.page import Page, Table  # noqa: E402
from experiments.statistics import between, mean  # noqa: E402
from experiments.xu2017_quaternion_kf.findings import findings, limit_deg  # noqa: E402
from experiments.xu2017_quaternion_kf.paper import PAPER  # noqa: E402
from experiments.xu2017_quaternion_kf.pictures import force_over_time  # noqa: E402
from jaxalign.methods import build  # noqa: E402
from jaxalign.rotation import quat_from_dcm, quat_from_rotvec, quat_multiply  # noqa: E402
from jaxalign.simulate import Scenario, scenario, truth  # noqa: E402
from jaxalign.tables import Estimate  # noqa: E402

SAMPLES = 2  # per epoch: 50 Hz
EVERY_S = 1.0
START_DEG = (10.0, 10.0, 30.0)  # the filters' first attitude is turned by this about east, north, up
WINDOWS = tuple((100.0 * i, 100.0 * (i + 1)) for i in range(6))
RAW = {"estimate.averaging": 0.0}
FIXED = {"estimate.measurement_noise": "fixed", "estimate.variance": 1e-7}
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "Scheme 1: gravity_q": ("gravity_q", {}),
    "Scheme 2: velocity_q, unit vectors": ("velocity_q", {"estimate.normalise": True}),
    "velocity_q": ("velocity_q", {}),
    "Scheme 3, full R": ("quaternion_kf_as_published", {}),
    "Scheme 3, cumulative R": ("quaternion_kf", RAW),
    "Scheme 3, fixed R": ("quaternion_kf", {**RAW, **FIXED}),
    "quaternion_kf (1 s averages)": ("quaternion_kf", {}),
    "Scheme 4, full R": ("rls_quaternion_kf_as_published", {}),
    "Scheme 4, cumulative R": ("rls_quaternion_kf", {}),
    "Scheme 4, fixed R": ("rls_quaternion_kf", FIXED),
    "rls_q": ("rls_q", {}),
    "dual_vector, V(t/2) and V(t)": ("dual_vector_as_published", {"vectors": "halves"}),
    "dual_vector, RLS": ("dual_vector_as_published", {"vectors": "rls"}),
}
TURNED = (
    "Scheme 1: gravity_q",
    "Scheme 3, full R",
    "Scheme 3, cumulative R",
    "Scheme 4, full R",
    "Scheme 4, cumulative R",
)
SHOWN = (
    "Scheme 1: gravity_q",
    "Scheme 2: velocity_q, unit vectors",
    "Scheme 3, cumulative R",
    "Scheme 4, cumulative R",
    "quaternion_kf (1 s averages)",
)
INTRODUCTION = """\
Scenario `sway`: Tables 1 and 2 of the paper: 10, 12, 6 deg about zero, gyroscopes 0.05 deg/h, accelerometers 500 ug,
the "random" errors taken as standard deviations of a sample at 100 Hz (as densities the Cramer-Rao bound alone would be
0.6 deg of yaw at the end). The biases are equal and positive on all axes, as printed. One vector per two samples. The
Kalman filters of Schemes 3 and 4 start from the truth turned by {start} deg (about east, north, up), P0 = I, each
vector a measurement; `quaternion_kf` as it is here averages over 1 s and starts from its own first two vectors.
"full", "cumulative" and "fixed" are three readings of the paper's (28).

Numbers: errors (deg, estimate minus truth). "mean": of a window over all runs, ± one standard deviation of the runs'
own means (not of the average); "std": the standard deviation inside a window, averaged over the runs, as the paper
gives it for its one run."""


def methods(made: Scenario) -> dict[str, Any]:
    """Label -> method; the filters of the paper start off the truth by a fixed error."""
    wrong = quat_from_rotvec(np.deg2rad(START_DEG))
    start = np.asarray(quat_multiply(wrong, quat_from_dcm(truth(made).C_nb[0])))
    out = {}
    for label, (name, parameters) in METHODS.items():
        interval = "front_end.interval_samples"
        own = {"estimate.start": start} if label.startswith(("Scheme 3", "Scheme 4")) else {}
        out[label] = build(name, "static", {interval: SAMPLES, **own, **parameters})
    return out


def errors(made: Scenario, chosen: Sequence[str], runs: int, seed: int, title: str) -> dict[str, Errors]:
    """Errors once a second."""
    every = round(EVERY_S * made.imu_rate / SAMPLES)
    picked = {label: method for label, method in methods(made).items() if label in chosen}
    return monte_carlo(made, picked, runs, seed, every=every, spacing=EVERY_S, title=title)


def of_window(found: Errors, window: tuple[float, float], axis: int) -> np.ndarray:
    """(runs, rows) errors (deg) of one Euler angle; rows without an attitude left out."""
    values = found.euler[:, between(found.time, *window), axis]
    return values[:, np.isfinite(values).all(axis=0)]


def window_table(found: dict[str, Errors], axis: int, name: str) -> Table:
    """Means in the six windows beside the paper's."""
    columns = [f"{a + 1:g}-{b:g} s" for a, b in WINDOWS]
    table = Table(name, ("method", "what", *columns))
    for label, of in found.items():
        for number, (mean_, std) in PAPER[name].get(label, {}).items():
            table.add(label, f"paper, {number}", *mean_)
            if std:
                table.add(label, f"paper, {number}, std", *std)
        values = [of_window(of, window, axis) for window in WINDOWS]
        table.add(label, "mean", *(Estimate(float(v.mean()), float(v.mean(axis=1).std(ddof=1))) for v in values))
        table.add(label, "std", *(float(v.std(axis=1).mean()) for v in values))
    return table


def turned(runs: int, seed: int) -> dict[str, dict[str, np.ndarray]]:
    """Condition -> label -> (runs, rows) yaw errors in the last window, where the paper's setting is broken up."""
    made = scenario("sway")
    north = eqx.tree_at(lambda s: s.imu.gyro.bias_deg_h, made, made.imu.gyro.bias_deg_h * jnp.array([0.0, 1.0, 0.0]))
    conditions = {
        "as printed": made,
        "only the north gyro has a bias": north,
        "mean yaw 40 deg": scenario("sway", mean_yaw_deg=40.0),
        "mean yaw -120 deg": scenario("sway", mean_yaw_deg=-120.0),
        "biases of random sign": scenario("sway", bias="sign"),
    }
    return {
        condition: {
            label: of_window(e, WINDOWS[-1], 2)
            for label, e in errors(some, TURNED, runs, seed, f"sway, {condition}").items()
        }
        for condition, some in conditions.items()
    }


def turned_table(found: dict[str, dict[str, np.ndarray]]) -> Table:
    """Mean and RMS of yaw in the last window."""
    columns = [f"{label}: {what}" for label in TURNED for what in ("mean", "RMS")]
    table = Table("broken symmetry", ("condition", "limit", *columns))
    for condition, of in found.items():
        limit = limit_deg(condition)
        cells = [x for e in of.values() for x in (mean(e), float(np.sqrt((e**2).mean())))]
        table.add(condition, "" if limit is None else limit, *cells)
    return table


def study(runs: int, seed: int) -> Page:
    """All methods, and the page on them."""
    made = scenario("sway")
    found = errors(made, tuple(METHODS), runs, seed, "sway")
    broken = turned(max(2, runs // 2), seed)
    yaw = {label: of_window(e, WINDOWS[-1], 2) for label, e in found.items()}
    roll = {label: of_window(e, WINDOWS[-1], 1) for label, e in found.items()}
    page = Page()
    page.add(
        "# Self-alignment on a swaying base (Xu et al. 2017)",
        f"Written by `python -m experiments.xu2017_quaternion_kf --runs {runs} --seed {seed}`.",
        INTRODUCTION.format(start=", ".join(f"{x:g}" for x in START_DEG)),
        "## What comes out",
        findings(yaw, roll, broken),
        "## Yaw",
        window_table(found, 2, "yaw"),
    )
    page.picture(
        "errors",
        "Errors over time",
        attitude_sizes({label: found[label] for label in SHOWN}, (5e-3, 1.0), (0.05, 100.0), "sway", 2),
    )
    page.add("## Roll", window_table(found, 1, "roll"), "## Pitch", window_table(found, 0, "pitch"))
    page.add("## Where the paper's setting is broken up", turned_table(broken))
    page.picture("force", "Force measured and fitted", force_over_time(seed, SAMPLES))
    return page


def main(arguments: Sequence[str] | None = None) -> int:
    """Study and write."""
    return run("experiments.xu2017_quaternion_kf", __doc__ or "", Path(__file__).parent, study, arguments, runs=100)


if __name__ == "__main__":
    sys.exit(main())
