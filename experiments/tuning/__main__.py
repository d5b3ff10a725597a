"""`python -m experiments.tuning`: numbers of the methods by gradient, by genetic algorithm and on grids."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from experiments.command import run  # noqa: E402
from experiments.genetic import GENERATIONS, SETTINGS  # noqa: E402
from experiments.page import Page  # noqa: E402
from experiments.progress import progress  # noqa: E402
from experiments.tuning import pictures, tables  # noqa: E402
from experiments.tuning.findings import findings  # noqa: E402
from experiments.tuning.problems import CUTOFF_STARTS, PROBLEMS, cutoff_tune  # noqa: E402
from experiments.tuning.searches import EVALUATIONS, search  # noqa: E402
from experiments.tuning.trial import tried  # noqa: E402
from jaxalign.tune import run as tune  # noqa: E402

STEPS = 60
INTRODUCTION = """\
The loss is the RMSE of the heading over the last 50 s of simulated runs, the same for all searches and evaluations of a
problem. Gradient: Adam on free numbers within the bounds, {steps} steps at most, stopped where runs held out get no
better (those are not counted); of its steps the one is taken that those runs like best, which need not be the least.
Genetic algorithm: the settings of the Vondrak paper (population {population}, crossover {crossover}, mutation
{mutation}; {generations} generations, 20 bits a number, over the bounds of the library, of logarithms). Grid: {grid}
points over the same bounds. An evaluation aligns each of the runs once; one with a gradient counts as one here and
costs more time, which the seconds show (they hold the compilation). moba has its smooth gate: of the published hard one
the threshold has no derivative.

The robust filter's R is not a number of its own: its estimate depends on Q and P0 over R alone, and its Huber threshold
is in units of R's root."""


def study(runs: int, seed: int) -> Page:
    """Everything, and the page on it."""
    few = runs < 10  # to see that it works: the first problem, one condition
    problems = PROBLEMS[:1] if few else PROBLEMS
    conditions = (1,) if few else (1, 2, 3, 4)
    found, own, other = [], {}, {}
    with progress("problems", len(problems)) as bar:
        for problem in problems:
            searched = search(problem, runs, seed, 5 if few else STEPS, 40 if few else EVALUATIONS)
            found.append(searched)
            own[problem.label], other[problem.label] = (tried(searched, away, seed) for away in (False, True))
            jax.clear_caches()
            bar.update(1)
    cutoffs = {
        (condition, start): tune(cutoff_tune(condition, start, max(2, runs // 4), seed))
        for condition in conditions
        for start in CUTOFF_STARTS
    }
    page = Page()
    page.add(
        "# Tuning by gradient",
        f"Written by `python -m experiments.tuning --runs {runs} --seed {seed}`.",
        INTRODUCTION.format(steps=STEPS, generations=GENERATIONS, grid=EVALUATIONS, **SETTINGS),
        "## What comes out",
        findings(found, own, other, cutoffs),
        "## Searches",
        tables.search_table(found),
        "## Numbers",
        tables.number_table(found),
        "## On new runs",
        f"Heading RMSE of {4 * runs} runs of another seed (fewer where the problem has fewer).",
        tables.trial_table(found, own, other),
        "## Vondrak's cut-off by the misfit J",
        "The minimum for white noise is at 0.489 Hz for a split at 0.5 Hz.",
        tables.cutoff_table(cutoffs),
    )
    page.picture("landscapes", "Loss along each number", pictures.landscapes(found))
    page.picture("convergence", "Best loss over the evaluations", pictures.convergence(found))
    return page


def main(arguments: Sequence[str] | None = None) -> int:
    """Study and write."""
    return run("experiments.tuning", __doc__ or "", Path(__file__).parent, study, arguments, runs=128)


if __name__ == "__main__":
    sys.exit(main())
