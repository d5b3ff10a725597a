"""`python -m experiments.embedding`: a calibration around the alignment, and a trained weight within it."""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from experiments.command import run  # noqa: E402
from experiments.embedding import pictures, tables  # noqa: E402
from experiments.embedding.doppler import (  # noqa: E402
    INJECTED,
    LENGTH_S,
    SCENARIOS,
    SD,
    UNITS,
    Simulated,
    logs,
    sensitivity,
)
from experiments.embedding.findings import on_logs, on_simulations, on_weights  # noqa: E402
from experiments.embedding.outliers import FEW, RUNS_A_RUN, weights  # noqa: E402
from experiments.page import Page  # noqa: E402

HERE = Path(__file__).parent
CALIBRATION, WEIGHT = "dvl_calibration.py", "learned_weight.py"
INTRODUCTION = """\
Two programs that use the library as it is. [`{calibration}`]({calibration}) ({lines[0]} lines) puts the alignment
inside a larger estimator and differentiates through it. [`{weight}`]({weight}) ({lines[1]} lines) puts a part of its
own into the alignment, a small network, and trains it through the recursion."""
DOPPLER = """\
The unknowns are the scale, the mounting (three small angles) and the lever arm of the Doppler log, the biases of the
inertial unit, and its noise as the mean over each of a few parts of the record. Each has a standard deviation
beforehand: {sd[0]:g} %, {sd[1]:g} deg, {sd[4]:g} m, and for the inertial unit what the scenario draws from. Velocities
and increments are corrected, the alignment (`centred_oba`) finds its attitude, and what its vectors leave unexplained
is made small together with the unknowns: Gauss-Newton, with the derivative through all epochs. The attitude is no
unknown, it follows from the others. Standard deviations stated are those of the normal equations.

In the simulated runs the errors of the Doppler log are drawn anew in each of {runs} runs from what is known beforehand,
so that what cannot be observed shows as well: there the standard deviation stays what it was, and so does the error."""
LOGS = """\
Six real logs of an AUV (FOG unit and Doppler log at 1 Hz) and two with a synthetic unit on the real motion and the real
Doppler log (numbers 05 and 12 again); the first {length:g} s of each. Put into the Doppler log: scale {put[0]:g} %,
mounting {put[1]:g}, {put[2]:g}, {put[3]:g} deg, no lever arm. It also has errors of its own, which are not known:
"reference" is what was put in plus a fit of scale, mounting and lever arm between Doppler log and the velocity of the
post-processed reference. The noise of the aid is taken from what the calibration leaves unexplained, larger where that
lasts from one second to the next."""
NO_LOGS = "The logs of an AUV are not here (`JAXALIGN_SHARED`): no results."
WEIGHTS = """\
The network ({inputs} inputs, two layers of {width}, a sigmoid) is trained on {runs} runs of `dvl-sturn` with 2 % of the
velocities 300 times as noisy, by [`jaxalign.tune`](../../jaxalign/tune/__init__.py), in the alignment with the first
velocity free. Huber's threshold is tuned on the same runs with the same loss. All methods are then compared on {tried}
runs of another seed. Numbers are the heading RMSE in deg over the last 50 s, with standard errors; "centred" is
`centred_oba` with a weight. Unless another scenario is named it is `dvl-sturn`; "segments" are those of Shen et al.
(2025), Table 3."""


def wrapped(text: str) -> str:
    """Paragraphs and points, each filled anew."""
    parts = re.split(r"(\n\n|\n(?=- ))", text)
    keep = {"width": 120, "break_long_words": False, "break_on_hyphens": False}
    return "".join(
        x if not x.strip() else textwrap.fill(" ".join(x.split()), subsequent_indent="  " * x.startswith("- "), **keep)
        for x in parts
    )


def study(runs: int, seed: int) -> Page:
    """All of it, and the page."""
    few = runs < FEW
    names = SCENARIOS[:1] if few else SCENARIOS
    simulated = {name: Simulated.of(name, runs, seed) for name in names}
    slopes = {name: sensitivity(name) for name in names}
    real = logs(2 if few else 100)
    learned = weights(runs, seed)
    net = learned.learned.method.weight.net
    lines = [len((HERE / name).read_text().splitlines()) for name in (CALIBRATION, WEIGHT)]
    page = Page()
    page.add(
        "# Alignment inside other programs, and other programs inside it",
        f"Written by `python -m experiments.embedding --runs {runs} --seed {seed}`.",
        wrapped(INTRODUCTION.format(calibration=CALIBRATION, weight=WEIGHT, lines=lines)),
        "## Calibration of a Doppler log through the alignment",
        wrapped(DOPPLER.format(sd=SD / UNITS, runs=runs)),
        "### What comes out",
        wrapped(on_simulations(simulated, slopes)),
        "### Simulated runs",
        tables.estimate_table(simulated),
    )
    page.picture("estimates", "Scale and mounting found, run by run", pictures.estimates(simulated))
    page.add("Heading error at the end of the run:", tables.heading_table(simulated))
    page.picture("sensitivity", "Heading by errors of the Doppler log", pictures.sensitivities(slopes))
    page.add("### Logs of an AUV")
    if real:
        page.add(
            wrapped(LOGS.format(length=LENGTH_S, put=INJECTED / UNITS)), wrapped(on_logs(real)), tables.log_table(real)
        )
        page.picture("logs", "What the Doppler log has of its own", pictures.of_logs(real))
        page.add("Heading error at the end:", tables.log_heading_table(real))
    else:
        page.add(NO_LOGS)
    page.add(
        "## A learned weight",
        wrapped(WEIGHTS.format(inputs=net.in_size, width=net.width_size, runs=runs, tried=RUNS_A_RUN * runs)),
        wrapped(on_weights(learned)),
        tables.weight_table(learned),
    )
    page.picture("tried", "Heading by outliers and method", pictures.tried(learned))
    page.add(
        f"Share of the runs whose heading RMSE is beyond {tables.TOLERANCE_DEG:g} deg:", tables.beyond_table(learned)
    )
    page.picture("training", "The learned weight and its training", pictures.training(learned))
    return page


def main(arguments: Sequence[str] | None = None) -> int:
    """Study and write."""
    return run("experiments.embedding", __doc__ or "", HERE, study, arguments)


if __name__ == "__main__":
    sys.exit(main())
