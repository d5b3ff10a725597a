"""`python -m experiments.shen2025_moba_dvl`: DVL-aided alignment with Mahalanobis weights."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from experiments import dvl  # noqa: E402
from experiments.command import run  # noqa: E402
from experiments.monte_carlo import Errors  # noqa: E402
from experiments.page import Page, Table  # noqa: E402
from experiments.shen2025_moba_dvl.findings import findings  # noqa: E402
from experiments.shen2025_moba_dvl.pictures import heading_over_time, histogram  # noqa: E402
from experiments.statistics import few_runs  # noqa: E402
from jaxalign.published import with_published_observation  # noqa: E402

SCENARIO = "dvl-accturn"
CONDITIONS: dict[str, dict[str, Any]] = {
    "clean": {},
    "Sim1": {"outliers": "fixed"},
    "Sim2": {"outliers": "segment"},
}
INLIERS, WINDOW = "moba, inliers, 60 s window", "oba, 60 s window"
METHODS: dict[str, dvl.Choice] = {
    "oba": ("oba", {}),
    "roba": ("roba", {}),
    "roba, norm": ("roba", {"weight.residual": "norm", "weight.threshold": 1.345}),
    "moba": ("moba", {}),
    INLIERS: ("moba", {"weight.statistics": "inliers", "observe.window": 60.0}),
    WINDOW: ("oba", {"observe.window": 60.0}),
    "rkf_oba": ("rkf_oba", {}),
    "centred_oba": ("centred_oba", {}),
}
VARIANTS: dict[str, Callable[[Any], Any] | None] = {"neglected": with_published_observation, "fed back": None}
SINGLE = ("oba", "roba", "roba, norm", "moba", INLIERS)
SPACING_S = 1.0  # of the rows kept
PAPER_RUNS = 10
PAPER = {  # Shen et al. (2025), Table 2 (Sim1), Table 4 (Sim2): RMSE of pitch, roll, heading, deg, over the last 50 s
    "Sim1": {
        "OBAr": (0.005, 0.006, 0.57),
        "oba": (0.04, 0.011, 4.39),
        "roba": (0.017, 0.008, 1.85),
        "moba": (0.009, 0.006, 0.89),
    },
    "Sim2": {
        "OBAr": (0.005, 0.006, 0.64),
        "oba": (0.04, 0.012, 4.36),
        "roba": (0.02, 0.007, 1.79),
        "moba": (0.001, 0.011, 0.92),
    },
}
INTRODUCTION = """\
Scenario `{scenario}`: 300 s with changes of speed, turns and a dive, Doppler log at 5 Hz with 0.05 m/s of noise (Table
1). The paper shows its trajectory as figures only; this is another one. Sim1: 2 % of the velocities after the first,
noise times 200. Sim2: Table 3. The runs are the same for all methods and simulations. The paper does not say what its
ROBA is, and its source was not at hand: `roba` puts Huber's weight on the residual vector, `roba, norm` on the
difference of the lengths (threshold 1.345).

Numbers are RMSE over all runs and the last 50 s, with standard errors from the spread between runs. OBAr is OBA without
outliers. The paper has {runs} runs: beside our RMSE stands the range in which that of {runs} of our runs lies with 95 %
probability. Transport rate `neglected` is as published, with the Coriolis term by recursion; `fed back` is the
library's default, with the Coriolis term in closed form."""
SINGLE_TEXT = """\
Sim1 with each outlier on all three axes, as above, and on one of them at random. Transport rate fed back."""
WEIGHTS_TEXT = """\
One run of Sim1. With a window each velocity enters two vectors, the second one 60 s later: there, good velocities are
weighted down for an outlier at the other end too."""
Found = dict[str, dict[str, dict[str, Errors]]]


def rows(found: Found, simulation: str) -> list[tuple[str, str, Errors]]:
    """(method, variant, errors) of one simulation, with OBA on clean data as the paper's reference OBAr."""
    out = []
    for label in ("OBAr", *METHODS):
        for variant, of in found.items():
            out.append((label, variant, of["clean"]["oba"] if label == "OBAr" else of[simulation][label]))
    return out


def paper_table(found: Found, simulation: str) -> Table:
    """Beside the paper's table."""
    heading = "heading deg, paper", "heading deg", f"{PAPER_RUNS} runs: 2.5 %", "97.5 %"
    level = "pitch deg, paper", "pitch deg", "roll deg, paper", "roll deg"
    table = Table(simulation, ("method", "transport rate", *heading, *level))
    for label, variant, errors in rows(found, simulation):
        paper = [f"{x:g}" for x in PAPER[simulation].get(label, ())] or ["", "", ""]
        pitch, roll, yaw = dvl.accuracy(errors)
        few = few_runs(dvl.last(errors)[..., 2], PAPER_RUNS)
        table.add(label, variant, paper[2], yaw, *few, paper[0], pitch, paper[1], roll)
    return table


def spread_table(found: Found) -> Table:
    """Heading run by run."""
    columns = [f"{condition}: {x}" for condition in CONDITIONS for x in ("median deg", "95 %", "max")]
    table = Table("heading of the runs", ("method", "transport rate", *columns))
    for label in METHODS:
        for variant, of in found.items():
            table.add(label, variant, *(x for condition in CONDITIONS for x in dvl.spread(of[condition][label])))
    return table


def single_table(found: Found, single: dict[str, Errors]) -> Table:
    """Outliers on all axes at once, and on one at a time."""
    table = Table("single axis", ("method", "no outliers: heading deg", "all axes at once", "one axis at a time"))
    of = found["fed back"]
    for label, errors in single.items():
        table.add(label, *(dvl.accuracy(e)[2] for e in (of["clean"][label], of["Sim1"][label], errors)))
    return table


def weight_table(weights: dict[str, np.ndarray], hit: np.ndarray) -> Table:
    """What the weights of one run hit and miss."""
    columns = "outliers", "with a weight above 1/2", "good velocities", "with a weight below 1/2"
    table = Table("weights of one run", ("method", *columns))
    for label, weight in weights.items():
        bad, good = weight[1:][hit[1:]], weight[1:][~hit[1:]]
        table.add(label, len(bad), int((bad > 0.5).sum()), len(good), int((good < 0.5).sum()))
    return table


def study(runs: int, seed: int) -> Page:
    """All conditions, methods and variants, and the page on them."""

    def simulated(options: dict[str, Any], labels: Sequence[str], variant: str) -> dict[str, dict[str, Errors]]:
        chosen = {label: METHODS[label] for label in labels}
        return dvl.conditions(SCENARIO, options, chosen, runs, seed, VARIANTS[variant], spacing=SPACING_S)

    found = {variant: simulated(CONDITIONS, list(METHODS), variant) for variant in VARIANTS}
    alone = "Sim1, one axis"
    single = simulated({alone: {**CONDITIONS["Sim1"], "single_axis": True}}, SINGLE, "fed back")[alone]
    log, hit = dvl.log_with_outliers(SCENARIO, CONDITIONS["Sim1"], seed)
    page = Page()
    page.add(
        "# Mahalanobis weights (Shen et al. 2025)",
        f"Written by `python -m experiments.shen2025_moba_dvl --runs {runs} --seed {seed}`.",
        INTRODUCTION.format(scenario=SCENARIO, runs=PAPER_RUNS),
        "## What comes out",
        findings(found, single, PAPER, PAPER_RUNS),
        "## Sim1 (Table 2)",
        paper_table(found, "Sim1"),
        "## Sim2 (Table 4)",
        paper_table(found, "Sim2"),
    )
    of = found["neglected"]
    shown = {
        simulation: {"OBAr": of["clean"]["oba"]} | {x.upper(): of[simulation][x] for x in ("oba", "roba", "moba")}
        for simulation in PAPER
    }
    page.picture("heading", "Heading errors over time, as published", heading_over_time(shown))
    page.add("## The runs", spread_table(found))
    page.picture("histogram", "Heading RMSE of the runs, as published", histogram(shown))
    weight = dvl.run_weights({label: METHODS[label] for label in ("roba", "moba", INLIERS)}, log)
    page.add("## Outliers on one axis", SINGLE_TEXT, single_table(found, single))
    page.add("## Weights", WEIGHTS_TEXT, weight_table(weight, hit))
    title = f"{SCENARIO}: weights of one run, Sim1, transport rate fed back"
    page.picture("weights", "Weights of one run", dvl.weights_over_time(weight, log, hit, title))
    return page


def main(arguments: Sequence[str] | None = None) -> int:
    """Study and write."""
    return run("experiments.shen2025_moba_dvl", __doc__ or "", Path(__file__).parent, study, arguments, runs=400)


if __name__ == "__main__":
    sys.exit(main())
