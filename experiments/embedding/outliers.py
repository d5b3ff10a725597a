"""The learned weight on outliers that it was not trained with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from experiments.embedding.learned_weight import learn
from experiments.scenarios import with_aid
from jaxalign import Aligner
from jaxalign.estimate import CentredWahba
from jaxalign.methods import build
from jaxalign.observe import BodyVelocityVectors
from jaxalign.simulate import FixedOutliers, Scenario, scenario
from jaxalign.study import Study, run
from jaxalign.tune import Tune, Tuned
from jaxalign.tune import run as tune
from jaxalign.weight import AbstractWeight, Huber, Mahalanobis, Unit

__all__ = ["FEW", "HUBER", "LEARNED", "OTHER", "OTHER_BAD", "SMALL", "TRAINED", "TUNED", "Weights", "weights"]

TRAINED = "2 %, 300 times (trained on)"
LEARNED, HUBER, TUNED = "centred, learned", "centred, Huber", "centred, Huber tuned"
STEPS, TUNING_STEPS = 100, 30
RUNS_A_RUN = 4  # of the evaluation
FEW = 20  # runs: below, a look whether it works
SMALL = "2 %, 10 times"
OTHER = "dvl-accturn"
OTHER_BAD = f"{OTHER}, 2 %, 200 times"


class Weights(NamedTuple):
    """What came out.

    Attributes:
        learned: the training of the network.
        tuned: that of Huber's threshold.
        errors: condition -> method -> (runs, 1) heading RMSE of each run over the last 50 s, deg.
    """

    learned: Tuned
    tuned: Tuned
    errors: dict[str, dict[str, np.ndarray]]


def conditions(runs: int) -> dict[str, Scenario]:
    """What the methods are tried on; with a few runs, to see that it works, not on another scenario."""

    def hit(probability: float, factor: float, **how: object) -> Scenario:
        fault = FixedOutliers(probability, factor, **how)  # pyright: ignore[reportArgumentType]
        return with_aid(scenario("dvl-sturn"), faults=(fault,))

    found = {
        TRAINED: hit(0.02, 300.0),
        "none": hit(0.0, 1.0),
        "segments": scenario("dvl-sturn", outliers="segment"),
        "2 %, 300 times, one axis": hit(0.02, 300.0, single_axis=True),
        "10 %, 300 times": hit(0.1, 300.0),
        "2 %, 30 times": hit(0.02, 30.0),
        SMALL: hit(0.02, 10.0),
        "20 %, 10 times": hit(0.2, 10.0),
        "10 %, 300 times, first velocity too": hit(0.1, 300.0, first="random"),
    }
    if runs < FEW:
        return found
    return found | {
        OTHER: scenario("dvl-accturn"),
        OTHER_BAD: scenario("dvl-accturn", outliers="fixed"),
    }


def centred(weight: AbstractWeight) -> Aligner:
    """The alignment with the first velocity free, and a weight."""
    return Aligner(BodyVelocityVectors(), weight=weight, estimate=CentredWahba())


def weights(runs: int, seed: int) -> Weights:
    """Train on one set of runs, compare on others."""
    tried = conditions(runs)
    learned = learn(tried[TRAINED], CentredWahba(), runs, STEPS if runs >= FEW else FEW, seed)
    asked = Tune(
        tried[TRAINED],
        centred(Huber()),
        ["weight.threshold"],
        "log-rmse",
        runs=runs,
        held_out=runs,
        steps=TUNING_STEPS,
        seed=seed,
        patience=0,
    )
    tuned = tune(asked)
    recipes = ("oba", "roba", "moba") if runs >= FEW else ()
    methods = {
        **{name: build(name, "body") for name in recipes},
        "centred_oba": centred(Unit()),
        "centred, Mahalanobis": centred(Mahalanobis()),
        HUBER: centred(Huber()),
        TUNED: tuned.method,
        LEARNED: learned.method,
    }
    errors = {}
    for condition, made in tried.items():
        found = run(Study(made, methods, RUNS_A_RUN * runs, seed + 1))  # runs of another seed
        assert found is not None
        errors[condition] = {label: np.asarray(found[label].window)[:, 2:] for label in methods}
    return Weights(learned, tuned, errors)
