"""Scenarios of one's own from a TOML file.

    name = "harbour"
    base = "dvl-sturn"           # a named scenario to start from, with its options; what follows replaces its parts
    options = { outliers = "fixed" }

    duration = 300.0             # s
    imu_rate = 200.0             # Hz
    epoch = 1.0                  # s: of the aid, or of the vectors of a standing vehicle
    aid = "body"                 # one aid: its kind, "body", "nav", "heading"; or "static": none
    aid_sd = 0.1                 # in its unit (m/s, rad)
    bias = "sign"                # how a run draws the biases of its unit: sign, gaussian, fixed

    [[aids]]                     # or several, in place of the two
    kind = "heading"             # and its options: name = "compass"; of a velocity components = ["forward"]
    sd = 0.01                    # in its unit, one, or of each component
    interval = 0.1               # s between values, a whole number of epochs (default: one epoch)
    unknowns = { offset = 0.05 } # true values of its unknowns, SI
    unknown_sd = { offset = 0.1 } # or deviations with which runs draw them
    faults = [{ kind = "gap", start = 20.0, stop = 30.0 }]

    [site]
    lat_deg = 54.3               # with lon_deg, h (m)

    [gyro]                       # each one number or three: [0.02, 0.02, 0.05]
    bias_deg_h = 0.02
    walk_deg_sqrt_h = 0.005
    noise_deg_h = 0.0            # per sample
    bias_walk_deg_h_sqrt_h = 0.1 # without it the bias is constant

    [accel]
    bias_ug = 50.0
    density_ug_sqrt_hz = 50.0    # also noise_ug, bias_walk_ug_sqrt_h

    [[faults]]                   # of the aid, applied in this order
    kind = "fixed"               # probability, factor, single_axis, first; "segment": ends, probability, factor, ...;
    probability = 0.02           # "jump": probability, low, high, first; "gap": start, stop;
                                 # "dead": component (from 0), start, stop

    [[imu_faults]]               # of the inertial unit, applied in this order (docs/faults.md); with --fidelity samples
    kind = "warm-up"             # time_constant, gyro_deg_h, accel_ug, drawn; numbers are one, or one for each axis
    time_constant = 60.0
    gyro_deg_h = 5.0             # "drift": gyro_deg_h_h, accel_ug_h, drawn;
                                 # "scale-factor", "misalignment": gyro_percent, accel_percent, drawn;
                                 # "g-sensitivity": deg_h_g, drawn;
                                 # "increment-quantisation": gyro_arcsec, accel_mm_s;
                                 # "rate-quantisation": gyro_deg_s, accel_mg; "saturation": gyro_deg_s, accel_g;
                                 # "vibration": frequency, gyro_deg_s, accel_mg, random_phase;
                                 # "zeros", "stuck": start, stop, triad ("gyro", "accel", "both"), axes ("xyz");
                                 # "spikes": gyro_deg_s, accel_g, and probability or times; "point-samples": every

    [force]                      # of a shaken base
    amplitude_mg = 10.0          # frequency = [1.0, 5.0], random_start

    [motion]                     # one of: s_turn, accelerate_and_turn, zigzag, road, swaying_base, sway_underway,
    name = "s_turn"              # static_base; with its arguments: speed = 3.0

    [trajectory]                 # or signals of time, which add up: angles in degrees, velocities in m/s
    pitch = 2.0                  # a constant
    roll = { mean = 0.5, sines = [[3.0, 8.0, 0.0]] }           # amplitude, period (s), phase (deg)
    yaw = { mean = 10.0, ramps = [[-4.0, 40.0, 60.0]], steps = [[90.0, 150.0, 5.0]] }
                                 # ramps: rate per s, begin, end (s); steps: size, centre, width (s) of a tanh
    [trajectory.velocity]
    frame = "body"               # right, forward, up; "nav": east, north, up; "course": speed, course (deg)
    forward = { mean = 3.0, sines = [[0.2, 10.0, 0.0]] }

Without `base` the site, aid, imu_rate, epoch, duration and a motion or trajectory are needed; the rest is perfect.
"""

from __future__ import annotations

import dataclasses
import inspect
import os
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxalign.aids import Standing, from_plain
from jaxalign.arguments import nearest
from jaxalign.earth import Site
from jaxalign.errors import UserError
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors
from jaxalign.simulate import motions
from jaxalign.simulate.aid import SimulatedAid
from jaxalign.simulate.faults import AbstractFault, DeadComponent, FixedOutliers, Gap, JumpOutliers, SegmentOutliers
from jaxalign.simulate.imu_faults import (
    AbstractImuFault,
    Drift,
    GSensitivity,
    Misalignment,
    ScaleFactor,
    WarmUp,
)
from jaxalign.simulate.measurement import Scenario
from jaxalign.simulate.named import scenario
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
from jaxalign.simulate.sensors import SineForce
from jaxalign.simulate.signals import AbstractSignal, Constant, Ramps, Sines, Steps
from jaxalign.simulate.trajectory import AbstractVelocity, CourseVelocity, Trajectory, VelocityInBody, VelocityInNav

__all__ = ["scenario_file"]

_MOTIONS: dict[str, Callable[..., Trajectory]] = {
    f.__name__: f
    for f in (
        motions.s_turn,
        motions.accelerate_and_turn,
        motions.zigzag,
        motions.road,
        motions.swaying_base,
        motions.sway_underway,
        motions.static_base,
    )
}
_FAULTS: dict[str, type[AbstractFault]] = {
    "fixed": FixedOutliers,
    "segment": SegmentOutliers,
    "jump": JumpOutliers,
    "gap": Gap,
    "dead": DeadComponent,
}
_IMU_FAULTS: dict[str, type[AbstractImuFault]] = {
    "warm-up": WarmUp,
    "drift": Drift,
    "scale-factor": ScaleFactor,
    "misalignment": Misalignment,
    "g-sensitivity": GSensitivity,
    "increment-quantisation": IncrementQuantisation,
    "rate-quantisation": RateQuantisation,
    "saturation": Saturation,
    "vibration": Vibration,
    "zeros": Zeros,
    "stuck": Stuck,
    "spikes": Spikes,
    "point-samples": PointSamples,
}
_VELOCITY: dict[str, tuple[Callable[..., AbstractVelocity], tuple[str, ...]]] = {
    "body": (VelocityInBody, ("right", "forward", "up")),
    "nav": (VelocityInNav, ("east", "north", "up")),
    "course": (CourseVelocity, ("speed", "course")),
}
_DEG = np.pi / 180.0


def scenario_file(path: str | os.PathLike[str]) -> Scenario:
    """The scenario of a TOML file (see the module's docstring).

    Raises:
        UserError: no such file, no TOML, a key, value or combination that makes no scenario; with file, table and key.
    """
    path = Path(path)
    if not path.is_file():
        raise UserError(f"{path}: no such scenario file")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: not a TOML file: {str(error).splitlines()[0]}") from None
    try:
        return _scenario(table, path.stem)
    except UserError as error:
        raise UserError(f"{path}: {error}") from None


def _scenario(table: Mapping[str, Any], stem: str) -> Scenario:
    known = ("name", "base", "options", "duration", "imu_rate", "epoch", "aid", "aid_sd", "aids", "bias")
    _check_keys(table, (*known, "site", "gyro", "accel", "faults", "imu_faults", "force", "motion", "trajectory"), "")
    parts: dict[str, Any] = {"name": _text(table, "name", stem)}
    if "base" in table:
        options = dict(_table(table, "options"))
        if "duration" in table:
            options["duration"] = _number(table, "duration")
        base = scenario(_text(table, "base"), **options)
        parts = {f.name: getattr(base, f.name) for f in dataclasses.fields(base)} | parts
    else:
        if "options" in table:
            raise UserError("options: they belong to a named scenario: say which with base = ...")
        missing = [key for key in ("site", "imu_rate", "epoch", "duration") if key not in table]
        if not {"aid", "aids"} & set(table):
            missing.insert(1, "aid")
        if not {"motion", "trajectory"} & set(table):
            missing.append("motion or trajectory")
        if missing:
            raise UserError(f"{', '.join(missing)}: missing (or start from a named scenario with base = ...)")
    for key in ("duration", "imu_rate"):
        if key in table:
            parts[key] = _number(table, key)
    if "bias" in table:
        parts["bias"] = _text(table, "bias")
    if "epoch" in table or ("imu_rate" in table and "base" in table):
        epoch = _number(table, "epoch") if "epoch" in table else parts["epoch_samples"] / base.imu_rate  # pyright: ignore[reportPossiblyUnboundVariable]
        every = epoch * parts["imu_rate"]
        if not 1 <= every < np.inf or abs(every - round(every)) > 1e-6:
            raise UserError(
                f"epoch: {epoch:g} s are {every:g} IMU samples at {parts['imu_rate']:g} Hz: not a whole number"
            )
        parts["epoch_samples"] = round(every)
    makers: dict[str, tuple[str, Callable[[Any], Any]]] = {
        "site": ("site", _site),
        "force": ("force", lambda x: _called(SineForce.of_mg, x, "force", ("frequency", "random_start"))),
        "motion": ("trajectory", _motion),
        "trajectory": ("trajectory", _trajectory),
    }
    triads = {
        key: _triad(kind, _table(table, key), key)
        for key, kind in (("gyro", GyroErrors), ("accel", AccelErrors))
        if key in table
    }
    parts["imu"] = dataclasses.replace(parts.get("imu", ImuErrors()), **triads)
    if "motion" in table and "trajectory" in table:
        raise UserError("motion and trajectory: give one of them")
    for key, (field, make) in makers.items():
        if key in table:
            parts[field] = make(_table(table, key))
    if "imu_faults" in table:
        parts["imu_faults"] = _faults(table["imu_faults"], "imu_faults", _IMU_FAULTS)
    if {"aid", "aid_sd", "faults", "aids"} & set(table):
        parts["aids"] = _aids(table, parts.get("aids", ()), parts["epoch_samples"] / parts["imu_rate"])
    return Scenario(**parts)


def _aids(table: Mapping[str, Any], base: tuple[SimulatedAid, ...], epoch: float) -> tuple[SimulatedAid, ...]:
    """The aids: listed, or one by its kind, noise and faults, in part those of the scenario to start from."""
    if "aids" in table:
        if more := [key for key in ("aid", "aid_sd", "faults") if key in table]:
            raise UserError(f"{more[0]}: it stands in [[aids]] where there are several")
        if not isinstance(table["aids"], list):
            raise UserError("aids: write each as a table [[aids]]")
        return tuple(_aid(one, f"aids {i + 1}", epoch) for i, one in enumerate(table["aids"]))
    given: dict[str, Any] = {}
    if "aid_sd" in table:
        given["sd"] = _number(table, "aid_sd")
    if "faults" in table:
        given["faults"] = _faults(table["faults"], "faults", _FAULTS)
    kind = _text(table, "aid") if "aid" in table else (base[0].aid.kind if base else Standing.kind)
    if kind == Standing.kind:
        return ()
    if len(base) > 1:
        there = ", ".join(one.aid.name for one in base)
        raise UserError(f"aid, aid_sd, faults: the base has several aids ({there}): write all of them as [[aids]]")
    if not base:
        return (SimulatedAid(from_plain({"kind": kind}), **given),)
    if kind == base[0].aid.kind:
        return (dataclasses.replace(base[0], **given),)
    aid = from_plain({"kind": kind})
    if aid.unit == base[0].aid.unit:
        given = {"sd": base[0].sd, "faults": base[0].faults} | given
    elif "sd" not in given:
        raise UserError(f"aid_sd: missing: that of the base is in {base[0].aid.unit}, a {kind} is in {aid.unit}")
    return (SimulatedAid(aid, **given),)


def _aid(table: Any, where: str, epoch: float) -> SimulatedAid:
    if not isinstance(table, Mapping):
        raise UserError(f"aids: {table!r} is no table: write each as [[aids]]")
    own = ("sd", "interval", "unknowns", "unknown_sd", "faults")
    try:
        aid = from_plain({key: value for key, value in table.items() if key not in own})
        every = _number(table, "interval", epoch, where) / epoch
        if every < 1 or abs(every - round(every)) > 1e-6:
            raise UserError(f"interval: {every * epoch:g} s are {every:g} epochs: not a whole number")
        values, deviations = (_table(table, key, where) for key in ("unknowns", "unknown_sd"))
        faults = _faults(table.get("faults", []), "faults", _FAULTS)
        return SimulatedAid(aid, table.get("sd", 0.0), faults, values, deviations, round(every))
    except UserError as error:
        raise UserError(f"[{where}] {error}".replace(f"[{where}] [{where}]", f"[{where}]")) from None


def _triad(kind: Callable[..., Any], table: Mapping[str, Any], where: str) -> Any:
    if "bias" in table:
        raise UserError(f"[{where}] bias: say once, above the tables, how runs draw biases: bias = {table['bias']!r}")
    return _called(kind, table, where)


def _site(table: Mapping[str, Any]) -> Site:
    _check_keys(table, ("lat_deg", "lon_deg", "h"), "site")
    lat, lon, h = (
        _number(table, key, default, "site") for key, default in (("lat_deg", None), ("lon_deg", 0), ("h", 0))
    )
    return Site(lat * _DEG, lon * _DEG, h)


def _motion(table: Mapping[str, Any]) -> Trajectory:
    name = _text(table, "name", where="motion")
    if name not in _MOTIONS:
        raise UserError(f"[motion] name: unknown {name!r}; {nearest(name, _MOTIONS)}")
    return _called(_MOTIONS[name], {k: v for k, v in table.items() if k != "name"}, "motion")


def _faults(tables: Any, name: str, known: Mapping[str, Callable[..., Any]]) -> tuple[Any, ...]:
    """Faults of the known kinds, from the tables of a name."""
    if not isinstance(tables, list):
        raise UserError(f"{name}: write each as a table [[{name}]]")
    out = []
    for i, table in enumerate(tables):
        where = f"{name} {i + 1}"
        if not isinstance(table, Mapping):
            raise UserError(f"{name}: {table!r} is no table: write each as [[{name}]]")
        kind = _text(table, "kind", where=where)
        if kind not in known:
            raise UserError(f"[{where}] kind: unknown {kind!r}; {nearest(kind, known)}")
        out.append(_called(known[kind], {k: v for k, v in table.items() if k != "kind"}, where))
    return tuple(out)


def _trajectory(table: Mapping[str, Any]) -> Trajectory:
    _check_keys(table, ("pitch", "roll", "yaw", "velocity"), "trajectory")
    pitch, roll, yaw = (_signal(table.get(key, 0.0), _DEG, f"trajectory.{key}") for key in ("pitch", "roll", "yaw"))
    if "velocity" not in table:
        return Trajectory(pitch, roll, yaw)
    velocity = _table(table, "velocity", "trajectory")
    where = "trajectory.velocity"
    frame = _text(velocity, "frame", where=where)
    if frame not in _VELOCITY:
        raise UserError(f"[{where}] frame: unknown {frame!r}; {nearest(frame, _VELOCITY)}")
    kind, names = _VELOCITY[frame]
    _check_keys(velocity, ("frame", *names), where)
    signals = (_signal(velocity.get(name, 0.0), _DEG if name == "course" else 1.0, f"{where}.{name}") for name in names)
    return Trajectory(pitch, roll, yaw, kind(*signals))


def _signal(value: Any, unit: float, where: str) -> AbstractSignal:
    """A number, or a table of terms that add up."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return Constant(float(value) * unit)
    if not isinstance(value, Mapping):
        raise UserError(f"{where} = {value!r}: must be a number or a table of mean, sines, ramps, steps")
    _check_keys(value, ("mean", "sines", "ramps", "steps"), where)
    total: AbstractSignal = Constant(_number(value, "mean", 0.0, where) * unit)
    if (terms := _triples(value, "sines", where)) is not None:
        if np.any(terms[:, 1] <= 0):
            raise UserError(f"[{where}] sines: the period (the second number) must be positive")
        total = total + Sines(terms[:, 0] * unit, 1.0 / terms[:, 1], terms[:, 2] * _DEG)
    if (terms := _triples(value, "ramps", where)) is not None:
        if np.any(terms[:, 2] <= terms[:, 1]):
            raise UserError(f"[{where}] ramps: rate, begin, end: the end must come after the beginning")
        total = total + Ramps(terms[:, 0] * unit, terms[:, 1], terms[:, 2])
    if (terms := _triples(value, "steps", where)) is not None:
        if np.any(terms[:, 2] <= 0):
            raise UserError(f"[{where}] steps: the width (the third number) must be positive")
        total = total + Steps(terms[:, 0] * unit, terms[:, 1], terms[:, 2])
    return total


def _triples(table: Mapping[str, Any], key: str, where: str) -> np.ndarray | None:
    if key not in table:
        return None
    try:
        array = np.asarray(table[key], float)
    except (TypeError, ValueError):
        array = np.zeros((0, 0))
    if array.ndim != 2 or array.shape[1] != 3 or not np.all(np.isfinite(array)):
        raise UserError(f"[{where}] {key}: must be a list of three numbers each, such as [[3.0, 8.0, 0.0]]")
    return array


def _called(make: Callable[..., Any], table: Mapping[str, Any], where: str, more: Iterable[str] = ()) -> Any:
    """Call with the keys of a table as arguments, none that it does not know."""
    known = [name for name, p in inspect.signature(make).parameters.items() if p.kind != p.VAR_KEYWORD]
    _check_keys(table, (*known, *more), where)
    needed = [
        name
        for name, p in inspect.signature(make).parameters.items()
        if p.default is p.empty and p.kind != p.VAR_KEYWORD and name not in table
    ]
    if needed:
        raise UserError(f"[{where}] {', '.join(needed)}: missing")
    values = {
        k: jnp.asarray(v, jnp.float64) if isinstance(v, list) and v and _numeric(v) else v for k, v in table.items()
    }
    try:
        return make(**values)
    except UserError as error:
        raise UserError(f"[{where}] {error}") from None
    except (TypeError, ValueError) as error:
        raise UserError(f"[{where}] {str(error).splitlines()[0]}") from None


def _numeric(values: Any) -> bool:
    """Whether it is a list of numbers."""
    return isinstance(values, list) and all(isinstance(x, int | float) and not isinstance(x, bool) for x in values)


def _check_keys(table: Mapping[str, Any], known: Iterable[str], where: str) -> None:
    known = list(known)
    for key in table:
        if key not in known:
            raise UserError(f"{f'[{where}] ' if where else ''}unknown key {key!r}; {nearest(key, known)}")


def _table(table: Mapping[str, Any], key: str, where: str = "") -> Mapping[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, Mapping):
        raise UserError(f"{f'[{where}] ' if where else ''}{key} = {value!r}: must be a table of keys")
    return value


def _text(table: Mapping[str, Any], key: str, default: str | None = None, where: str = "") -> str:
    value = table.get(key, default)
    place = f"[{where}] " if where else ""
    if value is None:
        raise UserError(f"{place}{key}: missing")
    if not isinstance(value, str):
        raise UserError(f"{place}{key} = {value!r}: must be a word in quotes")
    return value


def _number(table: Mapping[str, Any], key: str, default: float | None = None, where: str = "") -> float:
    value = table.get(key, default)
    place = f"[{where}] " if where else ""
    if value is None:
        raise UserError(f"{place}{key}: missing")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UserError(f"{place}{key} = {value!r}: must be a number")
    return float(value)
