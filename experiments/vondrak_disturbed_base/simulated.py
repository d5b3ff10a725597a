"""The simulations of section 6: heading errors of the schemes under the four conditions."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.monte_carlo import Errors, monte_carlo, run_keys
from experiments.vondrak_disturbed_base.schemes import FINES, GRADES, SCHEMES, behind, fine_of, floor_deg, grade_of
from jaxalign.earth import STANDARD_GRAVITY
from jaxalign.inertial_unit import AccelErrors, ImuErrors
from jaxalign.methods import build
from jaxalign.simulate import Scenario, SineForce, scenario

__all__ = ["COARSE", "CONDITIONS", "SWEEP_MG", "disturbed", "hundred", "sweep", "ten_tests", "two_vectors"]

CONDITIONS = (1, 2, 3, 4)
SWEEP_MG = (1.0, 10.0, 100.0)
LONG, SHORT = 300.0, 150.4  # s; the sines have whole periods in the first, but not in the second
COARSE = "coarse: 2 vectors, Hann"
LENGTHS = (61.7, 180.6)  # neither the parts nor the time between them are whole periods
Found = dict[str, dict[str, Errors]]
"""Scheme -> what -> errors."""


def disturbed(condition: int, amplitude_mg: float | None = None, **options: Any) -> Scenario:
    """A condition of Table 2; all of them of one structure, so that one program serves all.

    Args:
        condition: 1 to 4.
        amplitude_mg: of (28) in conditions 2 and 4; None: the accelerometer bias, as printed.
        **options: of the scenario.
    """
    made = scenario("disturbed", condition=condition, amplitude_mg=amplitude_mg, **options)
    force = made.force or SineForce(0.0 * STANDARD_GRAVITY)
    return dataclasses.replace(made, force=force, name="disturbed")


def _found(made: Scenario, methods: dict[str, Any], every: dict[str, int], runs: int, seed: int, title: str) -> Found:
    labels = {(scheme, what): behind(p, m) for scheme, p in SCHEMES.items() for what, m in methods.items()}
    flat = {f"{scheme}|{what}": method for (scheme, what), method in labels.items()}
    strides = {label: every[label.partition("|")[2]] for label in flat}
    errors = monte_carlo(made, flat, runs, seed, every=strides, title=title)
    return {scheme: {what: errors[f"{scheme}|{what}"] for what in methods} for scheme in SCHEMES}


def _fines(condition: int) -> dict[str, Any]:
    numbers = GRADES[grade_of(condition)]
    return {what: fine_of(numbers, sd, form) for what, (sd, form) in FINES.items()}


def ten_tests(runs: int, seed: int, conditions: Sequence[int] = CONDITIONS, duration: float = LONG) -> dict[int, Found]:
    """Fig. 9: equal positive biases, noise of Table 2 per sample; coarse by TRIAD on 60 s, fine on 300 s."""
    out = {}
    for condition in conditions:
        made = disturbed(condition, bias="fixed", duration=duration)
        methods = {"TRIAD, 60 s": build("triad"), **_fines(condition)}
        every = {"TRIAD, 60 s": 600, **dict.fromkeys(FINES, 10 if duration == LONG else 16)}
        out[condition] = _found(made, methods, every, runs, seed, f"condition {condition}, {runs} tests")
    return out


def hundred(runs: int, seed: int, conditions: Sequence[int] = CONDITIONS) -> dict[int, tuple[Found, np.ndarray]]:
    """Biases drawn, noise as densities: errors of 150 s, and what the biases alone leave (runs,), deg."""
    out = {}
    for condition in conditions:
        made = disturbed(condition, bias="gaussian", noise_per="density", duration=SHORT)
        methods = {"TRIAD": build("triad"), **_fines(condition)}
        every = {"TRIAD": made.epochs, **dict.fromkeys(FINES, 16)}
        found = _found(made, methods, every, runs, seed, f"condition {condition}, drawn biases")
        out[condition] = found, floor_deg(made, run_keys(seed, runs))
    return out


def sweep(
    runs: int, seed: int, amplitudes: Sequence[float] = SWEEP_MG
) -> dict[tuple[int, float], tuple[Found, np.ndarray]]:
    """Larger disturbances: (condition, mg) -> as :func:`hundred`."""
    out = {}
    for condition in (2, 4):
        for amplitude in amplitudes:
            made = disturbed(condition, amplitude, bias="gaussian", noise_per="density", duration=SHORT)
            methods = {COARSE: build("dual_vector"), **_fines(condition)}
            found = _found(
                made, methods, dict.fromkeys(methods, 16), runs, seed, f"condition {condition}, {amplitude:g} mg"
            )
            out[condition, amplitude] = found, floor_deg(made, run_keys(seed, runs))
    return out


def two_vectors(runs: int, seed: int, lengths: Sequence[float] = LENGTHS) -> dict[float, Found]:
    """Gravity in inertial space at two times, no biases, 10 mg: (length s) -> errors."""
    methods = {
        "boxcar T/3": build("dual_vector", parameters={"vectors": "boxcar"}),
        "Hann T/3": build("dual_vector"),
    }
    out = {}
    for length in lengths:
        made = disturbed(4, 10.0, duration=length)
        gyro = dataclasses.replace(made.imu.gyro, bias_deg_h=0.0)
        made = dataclasses.replace(made, imu=ImuErrors(gyro, AccelErrors(noise_ug=20.0)))
        every = dict.fromkeys(methods, made.epochs)
        out[length] = _found(made, methods, every, runs, seed, f"two vectors, {length:g} s")
    return out
