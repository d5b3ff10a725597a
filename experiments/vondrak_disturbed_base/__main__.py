"""`python -m experiments.vondrak_disturbed_base`: alignment behind low-pass filters on a shaken base."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import TypeVar

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from experiments.command import run  # noqa: E402
from experiments.monte_carlo import monte_carlo  # noqa: E402
from experiments.page import Page  # noqa: E402
from experiments.progress import progress  # noqa: E402
from experiments.vondrak_disturbed_base import driving, pictures, repeatability, simulated, tables  # noqa: E402
from experiments.vondrak_disturbed_base.findings import findings  # noqa: E402
from experiments.vondrak_disturbed_base.schemes import GRADES, SCHEMES, behind, fine_of, grade_of  # noqa: E402
from experiments.vondrak_disturbed_base.smoothing import (  # noqa: E402
    OBJECTIVES,
    Choice,
    by_genetic_algorithm,
    by_gradient,
    objectives,
)

T = TypeVar("T")
STARTS = (0.015, 0.5, 50.0)
ALIGNED = 600.0
INTRODUCTION = """\
Scenario `disturbed`: Table 2 of the paper (latitude 37.6 deg, 200 Hz), conditions 1 and 3 undisturbed, 2 and 4 with the
sum of sines (28), whose "Bias" is the accelerometer bias as printed (50 and 10 ug) or as stated. Schemes 1 to 4: force
behind Vondrak's filter, no filter, a FIR cascade, a db4 wavelet, all at 0.5 Hz. Fine alignment: the 15-state filter,
zero velocity ten times a second with 1 mm/s or 1 cm/s, started 2 deg off in heading, as published (measured force in
the error model, all errors fed back, 3 deg of initial heading) or in the form for a standing base that this library has
by default. All schemes see the same runs; numbers are RMS heading errors ± their standard errors."""
Aligned = dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]


def search(seed: int, conditions: Sequence[int]) -> dict[tuple[int, str], tuple[Choice, dict[float, Choice]]]:
    """The smoothing factor by all ways: (condition, objective) -> genetic algorithm, gradient by start."""
    out = {}
    with progress("smoothing factor", len(conditions) * len(OBJECTIVES)) as bar:
        for condition in conditions:
            made = objectives(condition, seed)
            for name in OBJECTIVES:
                objective = made[name]
                ga = by_genetic_algorithm(objective, seed, None if name == "J" else 0.995)
                out[condition, name] = ga, {start: by_gradient(objective, start) for start in STARTS}
                bar.update(1)
    return out


def drives(runs: int, seed: int, amplitudes: Sequence[float | None] = (None, 10.0)) -> Aligned:
    """Align for 600 s, drive for half an hour: (grade, disturbance) -> position errors by scheme and without errors."""
    out: Aligned = {}
    for condition, amplitude in product((2, 4), amplitudes):
        grade = grade_of(condition)
        made = simulated.disturbed(condition, amplitude, noise_per="density", bias="sign", duration=ALIGNED)
        methods = {
            scheme: behind(prefilter, fine_of(GRADES[grade], 1e-3, "published"))
            for scheme, prefilter in SCHEMES.items()
        }
        name = "as printed" if amplitude is None else f"{amplitude:g} mg"
        found = monte_carlo(made, methods, runs, seed, every=made.epochs, chunk=4, title=f"{grade}, {name}: align")
        phi = np.stack([*(found[scheme].phi[:, -1] for scheme in SCHEMES), np.zeros((runs, 3))])
        out[grade, name] = driving.position_errors(condition, grade, phi, seed)
    return out


def apart(part: Callable[[], T]) -> T:
    """Do a part, then give back its programs: each maps memory, and Linux allows a process 65530 maps."""
    try:
        return part()
    finally:
        jax.clear_caches()


def study(runs: int, seed: int) -> Page:
    """Everything, and the page on it."""
    real = repeatability.find(Path(os.environ.get("JAXALIGN_SHARED", Path(__file__).parents[3] / "shared")))
    few = runs < 10  # to see that it works: a condition, an amplitude, the longest segments behind two schemes
    lengths = repeatability.LENGTHS[-1:] if few else repeatability.LENGTHS
    schemes = tuple(SCHEMES)[:2] if few else tuple(SCHEMES)
    conditions = (2,) if few else simulated.CONDITIONS

    def some(share: int) -> int:  # a share of the runs; of a few all: then the programs are the same
        return runs if few else max(2, runs // share)

    part = (lambda f: f()) if few else apart  # then all parts share what they can
    ten = part(lambda: simulated.ten_tests(min(10, runs), seed, conditions, simulated.SHORT if few else simulated.LONG))
    many = part(lambda: simulated.hundred(runs, seed, conditions))
    swept = apart(lambda: simulated.sweep(some(2), seed, (10.0,) if few else simulated.SWEEP_MG))
    pairs = apart(lambda: simulated.two_vectors(some(5), seed, simulated.LENGTHS[:1] if few else simulated.LENGTHS))
    chosen = apart(lambda: search(seed, conditions))
    driven = apart(lambda: drives(some(10), seed, (10.0,) if few else (None, 10.0)))
    segments = {} if real is None else apart(lambda: repeatability.repeatability(real, lengths, schemes))
    page = Page()
    page.add(
        "# Vondrak's filter on a disturbed base",
        f"Written by `python -m experiments.vondrak_disturbed_base --runs {runs} --seed {seed}`.",
        INTRODUCTION,
        "## What comes out",
        findings(many, swept, pairs, chosen, driven, segments),
        f"## {min(10, runs)} tests with fixed biases (Fig. 9)",
        "The paper draws them as curves, without numbers, and says: with the filter 2-3 times more accurate.",
        tables.condition_table("ten tests", {f"condition {c}": (of, None) for c, of in ten.items()}),
    )
    page.picture("tests", "Heading errors of each test", pictures.tests(ten))
    page.add(
        f"## {runs} runs with drawn biases, {simulated.SHORT:g} s",
        tables.condition_table("drawn biases", {f"condition {c}": pair for c, pair in many.items()}),
        f"## Larger disturbances, {some(2)} runs",
        tables.condition_table("sweep", {f"condition {c}, {a:g} mg": pair for (c, a), pair in swept.items()}),
    )
    page.picture("convergence", "Heading errors over time", pictures.convergence(swept))
    page.add(
        f"## Two vectors in inertial space, no biases, 10 mg, {some(5)} runs",
        tables.two_vector_table(pairs),
        "## The smoothing factor",
        "Values of J in m^2/s^4 (smaller is better), of (27) as they are (larger is better). By formula: theta = "
        "(2 pi 0.5 Hz)^6 = 961, no evaluation.",
        tables.smoothing_table(chosen),
    )
    page.picture("smoothing", "Objectives over the cut-off", pictures.landscapes(seed, chosen))
    page.picture("spectra", "Spectra of the force", pictures.spectra(seed, real))
    labels = (*SCHEMES, "perfect attitude")
    page.add(
        f"## Half an hour of driving after {ALIGNED:g} s of alignment (Table 5), {some(10)} runs",
        "Medians over the runs of horizontal position errors; published form at 1 mm/s; only the attitude is handed "
        "on; the paper's scale factors (Tables 3 and 4), the biases of the alignment, a way of "
        "ours. The paper prints one set of numbers, in nm in the table and in m in the text.",
        tables.drive_table(driven, labels),
        "## A real vehicle: the laser-gyro log",
        "Heading at the end of each segment less a reference (the fine alignment of the whole 923 s, taken back by the "
        "gyros). The reference is good to some 0.005 deg; an error common to all is not seen.",
        tables.real_table(segments) if segments else "(the log is not here: set JAXALIGN_SHARED to its folder)",
    )
    return page


def main(arguments: Sequence[str] | None = None) -> int:
    """Study and write."""
    return run("experiments.vondrak_disturbed_base", __doc__ or "", Path(__file__).parent, study, arguments, runs=100)


if __name__ == "__main__":
    assert set(GRADES) == set(driving.SCALE_PPM)
    sys.exit(main())
