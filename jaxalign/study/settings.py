"""What a study is: scenario, methods, runs, and how they are judged; checked before anything is traced."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxalign.aids import AbstractAid, plain
from jaxalign.arguments import check_choice, whole_number
from jaxalign.errors import UserError
from jaxalign.method import AbstractMethod
from jaxalign.methods import build_for
from jaxalign.normalised import Normalised
from jaxalign.precision import require_x64
from jaxalign.simulate import Scenario, scenario
from jaxalign.simulate.random import DRAW
from jaxalign.study.epochs_spec import FIDELITIES, Fidelity

__all__ = ["Study", "described"]

_LAST_S = 50.0
_version = cache(metadata.version)


@dataclass(frozen=True)
class Study:
    """Methods over the same simulated runs of a scenario.

    Attributes:
        scenario: a :class:`jaxalign.simulate.Scenario` or the name of one.
        methods: label -> method; or names of recipes.
        runs: how many.
        seed: of all the runs; run i is the same whatever the methods, chunks and devices.
        every: epochs of the scenario between two read-outs; by default 10, or all of a scenario with fewer.
        fidelity: "increments" draws the noise per epoch interval (exact to first order, far cheaper);
            "samples" per IMU sample: for prefilters, disturbances of the base and faults of the unit, and to compare.
        tolerance_deg: of `within` and of the convergence time.
        window: (start, stop) s over which the accuracy of a run is taken: start < t <= stop. By default the last 50 s,
            or the last half of a shorter scenario.

    Raises:
        UserError: float32, or a value that makes no study.
    """

    scenario: Normalised[str | Scenario, Scenario] = Normalised()
    methods: Normalised[Sequence[str] | Mapping[str, Any], Mapping[str, Any]] = Normalised()
    runs: int = 1000
    seed: int = 0
    every: Normalised[int | None, int] = Normalised(None)
    fidelity: Fidelity = "increments"
    tolerance_deg: float = 1.0
    window: Normalised[tuple[float, float] | None, tuple[float, float]] = Normalised(None)

    def __post_init__(self):
        require_x64()
        made = _scenario(self.scenario)
        end = made.epochs * made.epoch_samples / made.imu_rate
        every, window = self.every, self.window
        put = {
            "scenario": made,
            "methods": _methods(self.methods, made),
            "runs": whole_number("runs", self.runs, 2, 10**9),
            "seed": whole_number("seed", self.seed, 0, 2**63 - 1),
            "every": min(10, made.epochs) if every is None else whole_number("every", every, 1, made.epochs),
            "tolerance_deg": _positive("tolerance_deg", self.tolerance_deg),
            "window": (end - min(_LAST_S, end / 2), end) if window is None else window,
        }
        for name, value in put.items():
            object.__setattr__(self, name, value)
        check_choice("fidelity", self.fidelity, FIDELITIES)
        _check_window(self.window, end, self.every * made.epoch_samples / made.imu_rate)

    @property
    def block(self) -> int:
        """Runs of a block, the unit of work: it depends on the study and the kind of device alone."""
        most, memory = (1024, 1e8) if jax.default_backend() == "cpu" else (16384, 2e9)
        made = self.scenario
        a_run = 8 * (20 * made.epochs + 30 * (made.epochs // self.every + 1))  # bytes: what is drawn, what is read out
        fits = 1 << max(4, int(memory // a_run).bit_length() - 1)
        quarter = -(-self.runs // 4)  # a few blocks, for a few devices
        few = min(16, 1 << (self.runs - 1).bit_length())
        return min(most, fits, max(few, 1 << (quarter - 1).bit_length()))

    @property
    def settings(self) -> dict[str, Any]:
        """All that decides the numbers, JSON-ready."""
        made = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return {
            "jaxalign": _version("jaxalign"),
            "jax": f"{jax.__version__}, jaxlib {_version('jaxlib')}",
            "device": jax.local_devices()[0].device_kind,
            "block": self.block,
            "draw": DRAW,
            "xla_flags": _flags(),
            **described(made),
        }


def _flags() -> list[str]:
    """How XLA compiles here, as far as the last bits depend on it: not on the number of devices."""
    given = os.environ.get("XLA_FLAGS", "").split()
    return sorted(
        flag for flag in given if not flag.startswith(("--xla_force_host_platform_device_count", "--xla_dump"))
    )


def described(value: Any) -> Any:
    """Modules, arrays and plain values as nested dictionaries and lists, every number of them."""
    if isinstance(value, eqx.Module):
        fields = {f.name: described(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"kind": type(value).__qualname__, **fields}
    if isinstance(value, AbstractAid):
        return plain(value)
    if isinstance(value, Mapping):
        return {str(key): described(x) for key, x in value.items()}
    if isinstance(value, tuple | list):
        return [described(x) for x in value]
    if isinstance(value, jax.Array | np.ndarray | np.generic):
        return np.asarray(value).tolist()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return repr(value)


def _scenario(given: Any) -> Scenario:
    if isinstance(given, Scenario):
        return given
    if not isinstance(given, str):
        raise UserError(f"scenario = {given!r}: must be a Scenario or the name of one")
    return scenario(given)


def _methods(given: Any, made: Scenario) -> dict[str, Any]:
    if isinstance(given, str):
        raise UserError(f"methods = {given!r}: give a list of names, or a mapping of labels to methods")
    if not isinstance(given, Mapping):
        names = list(given)
        if twice := [name for name in names if names.count(name) > 1]:
            raise UserError(f"methods: {twice[0]} is named twice; give a mapping of labels to methods")
        given = {name: build_for(tuple(one.aid for one in made.aids), name) for name in names}
    if not given:
        raise UserError("methods: name at least one")
    for label, method in given.items():
        if not isinstance(method, AbstractMethod):
            raise UserError(f"methods: {label} = {method!r} is no method: build one with jaxalign.methods.build")
        require_x64(method)
    return dict(given)


def _positive(name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not 0 < number < np.inf:
        raise UserError(f"{name} = {value!r}: must be a positive number of degrees")
    return number


def _check_window(window: Any, end: float, spacing: float) -> None:
    try:
        start, stop = (float(x) for x in window)
    except (TypeError, ValueError):
        raise UserError(f"window = {window!r}: must be two times in s") from None
    last = np.floor(min(stop, end) / spacing + 1e-9) * spacing
    if not 0 <= start < stop or not (start < last or start < end - 1e-6 <= stop):
        raise UserError(
            f"window = {start:g} .. {stop:g} s: no read-out is in it; they come every {spacing:g} s until {end:g} s"
        )
