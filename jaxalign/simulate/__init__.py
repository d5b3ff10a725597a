"""Simulated logs: analytic trajectories, exact increments, sensor errors, faults, named scenarios.

    truth(scenario)                    once: perfect increments and the states at the epochs
    measure(truth, scenario, key)      per run: pure, `vmap` it over keys
    measure_epochs(intervals_of(truth, samples), scenario, key)   the same, noise drawn per interval: far cheaper
    simulate("dvl-sturn", seed=1)      both, as a `Log`
    scenario_file("harbour.toml")      a scenario of one's own
    with_mistake(log, "ned")           what people get wrong about a log, recorded or simulated

A new motion is a `Trajectory` of signals; a new fault of an aid is a module ``(key, t, error) -> error``, one
of the inertial unit ``(key, t, dt, dtheta, dvel) -> (dtheta, dvel)``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxalign.lazy import lazily

if TYPE_CHECKING:
    from jaxalign.simulate.aggregate import Intervals, intervals_of, measure_epochs, sample_epochs
    from jaxalign.simulate.aid import SimulatedAid
    from jaxalign.simulate.faults import AbstractFault, DeadComponent, FixedOutliers, Gap, JumpOutliers, SegmentOutliers
    from jaxalign.simulate.file import scenario_file
    from jaxalign.simulate.imu import Truth, exact_increments, specific_force, turn_rate
    from jaxalign.simulate.imu_faults import (
        AbstractImuFault,
        Drift,
        GSensitivity,
        Misalignment,
        ScaleFactor,
        WarmUp,
    )
    from jaxalign.simulate.measurement import (
        Scenario,
        aid_values,
        imu_increments,
        log_of,
        measure,
        noiseless,
        truth,
    )
    from jaxalign.simulate.motions import (
        accelerate_and_turn,
        road,
        s_turn,
        static_base,
        sway_underway,
        swaying_base,
        zigzag,
    )
    from jaxalign.simulate.named import scenario, scenario_options, scenarios, simulate
    from jaxalign.simulate.named_mistakes import MISTAKES, Mistake, with_mistake
    from jaxalign.simulate.sample_faults import (
        IncrementQuantisation,
        PointSamples,
        RateQuantisation,
        Saturation,
        Spikes,
        Stuck,
        Vibration,
        Zeros,
    )
    from jaxalign.simulate.sensors import SineForce, draw_bias
    from jaxalign.simulate.signals import AbstractSignal, Constant, Ramps, Sines, Steps, Sum
    from jaxalign.simulate.trajectory import (
        AbstractVelocity,
        CourseVelocity,
        Trajectory,
        VelocityInBody,
        VelocityInNav,
    )

__all__ = [
    "MISTAKES",
    "AbstractFault",
    "AbstractImuFault",
    "AbstractSignal",
    "AbstractVelocity",
    "Constant",
    "CourseVelocity",
    "DeadComponent",
    "Drift",
    "FixedOutliers",
    "GSensitivity",
    "Gap",
    "IncrementQuantisation",
    "Intervals",
    "JumpOutliers",
    "Misalignment",
    "Mistake",
    "PointSamples",
    "Ramps",
    "RateQuantisation",
    "Saturation",
    "ScaleFactor",
    "Scenario",
    "SegmentOutliers",
    "SimulatedAid",
    "SineForce",
    "Sines",
    "Spikes",
    "Steps",
    "Stuck",
    "Sum",
    "Trajectory",
    "Truth",
    "VelocityInBody",
    "VelocityInNav",
    "Vibration",
    "WarmUp",
    "Zeros",
    "accelerate_and_turn",
    "aid_values",
    "draw_bias",
    "exact_increments",
    "imu_increments",
    "intervals_of",
    "log_of",
    "measure",
    "measure_epochs",
    "noiseless",
    "road",
    "s_turn",
    "sample_epochs",
    "scenario",
    "scenario_file",
    "scenario_options",
    "scenarios",
    "simulate",
    "specific_force",
    "static_base",
    "sway_underway",
    "swaying_base",
    "truth",
    "turn_rate",
    "with_mistake",
    "zigzag",
]

_HOMES = {
    "aggregate": "Intervals intervals_of measure_epochs sample_epochs",
    "aid": "SimulatedAid",
    "faults": "AbstractFault DeadComponent FixedOutliers Gap JumpOutliers SegmentOutliers",
    "file": "scenario_file",
    "imu": "Truth exact_increments specific_force turn_rate",
    "imu_faults": "AbstractImuFault Drift GSensitivity Misalignment ScaleFactor WarmUp",
    "measurement": "Scenario aid_values imu_increments log_of measure noiseless truth",
    "motions": "accelerate_and_turn road s_turn static_base sway_underway swaying_base zigzag",
    "named": "scenario scenario_options scenarios simulate",
    "named_mistakes": "MISTAKES Mistake with_mistake",
    "sample_faults": "IncrementQuantisation PointSamples RateQuantisation Saturation Spikes Stuck Vibration Zeros",
    "sensors": "SineForce draw_bias",
    "signals": "AbstractSignal Constant Ramps Sines Steps Sum",
    "trajectory": "AbstractVelocity VelocityInBody CourseVelocity VelocityInNav Trajectory",
}
__getattr__, __dir__ = lazily(__name__, _HOMES)
