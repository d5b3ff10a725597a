"""What is tuned: methods, numbers, scenarios, and the scenario that each result is tried on afterwards."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from jaxalign.methods import build
from jaxalign.simulate import Scenario, scenario
from jaxalign.tune import Tune

__all__ = ["CUTOFF_STARTS", "PROBLEMS", "Problem", "cutoff_tune"]

DVL = ("dvl-sturn", {"outliers": "fixed"})
DVL_OTHER = ("dvl-accturn", {"outliers": "segment"})
GPS, GPS_OTHER = ("gps-zigzag", {}), ("gps-zigzag", {"outliers": "jump"})
SWAY = ("sway", {"duration": 300.0, "bias": "gaussian"})
SWAY_OTHER = ("sway", {"duration": 300.0, "bias": "gaussian", "mean_yaw_deg": 60.0})
CUTOFF_STARTS = (0.015, 50.0)
Place = tuple[str, dict[str, Any]]


@dataclass(frozen=True)
class Problem:
    """Numbers of a method in a scenario.

    Attributes:
        label: for tables.
        recipe: of the method.
        aid: that it observes.
        paths: of the numbers.
        place: scenario to tune on.
        other: scenario to try it on.
        settings: of the method at the start, and of the untuned one.
        share: of the runs of the experiment, where they are costly.
    """

    label: str
    recipe: str
    aid: str
    paths: tuple[str, ...]
    place: Place
    other: Place
    settings: dict[str, Any] = field(default_factory=dict)
    share: float = 1.0

    @property
    def method(self) -> Any:
        """Untuned."""
        return build(self.recipe, self.aid, self.settings)

    def made(self, other: bool = False) -> Scenario:
        """The scenario, or the other one."""
        name, options = self.other if other else self.place
        return scenario(name, **options)

    def tune(self, runs: int, seed: int, steps: int) -> Tune:
        """The search by gradient."""
        count = max(4, round(runs * self.share))
        return Tune(
            self.made(),
            self.method,
            self.paths,
            runs=count,
            held_out=4 * count,
            steps=steps,
            rate=0.3,
            seed=seed,
            every=self.every,
            recipe=self.recipe,
        )

    @property
    def every(self) -> int:
        """Epochs of the scenario between two read-outs: 10 s."""
        made = self.made()
        return round(10.0 * made.imu_rate / made.epoch_samples)


SMOOTH = {"weight.gate": "smooth"}
CONSTANT = {"estimate.measurement_noise": "constant"}
PROBLEMS = (
    Problem("roba: Huber's gamma", "roba", "body", ("weight.threshold",), DVL, DVL_OTHER),
    Problem("rkf_oba: Huber's gamma", "rkf_oba", "body", ("reconstruct.threshold",), DVL, DVL_OTHER),
    Problem(
        "rkf_oba: Q and P0 (over R)",
        "rkf_oba",
        "body",
        ("reconstruct.process_variance", "reconstruct.prior_variance"),
        DVL,
        DVL_OTHER,
    ),
    Problem(
        "moba: gamma, delta, threshold",
        "moba",
        "body",
        ("weight.exponent", "weight.delta", "weight.threshold"),
        DVL,
        DVL_OTHER,
        SMOOTH,
    ),
    Problem("request: rho", "request", "nav", ("estimate.rho",), GPS, GPS_OTHER),
    Problem(
        "optimal_request: R and Q",
        "optimal_request",
        "nav",
        ("estimate.variance", "estimate.process_variance"),
        GPS,
        GPS_OTHER,
        {**CONSTANT, "estimate.process_variance": 1e-4},
    ),
    Problem(
        "vo_tvk: kappa, R, P0",
        "vo_tvk",
        "nav",
        ("estimate.kappa", "estimate.variance", "estimate.prior_variance"),
        GPS,
        GPS_OTHER,
        CONSTANT,
    ),
    Problem(
        "quaternion_kf: R and P0",
        "quaternion_kf",
        "static",
        ("estimate.variance", "estimate.prior_variance"),
        SWAY,
        SWAY_OTHER,
        {"estimate.measurement_noise": "fixed"},
        0.125,
    ),
)


def cutoff_tune(condition: int, start: float, runs: int, seed: int) -> Tune:
    """The cut-off of Vondrak's filter by the misfit J, in a condition of Table 2."""
    method = build("fine", prefilter="vondrak", parameters={"front_end.prefilter.cutoff": start})
    made = scenario("disturbed", condition=condition, duration=60.0)
    return Tune(
        made,
        method,
        "front_end.prefilter.cutoff",
        "misfit",
        runs=runs,
        held_out=runs,
        steps=100,
        rate=0.3,
        patience=0,  # the objective has no noise of its own
        seed=seed,
        every=100,
        fidelity="samples",
        recipe="fine",
    )
