"""What a person wants to read of an alignment, line by line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxalign.aids import AbstractAid
from jaxalign.front_end import aids_for
from jaxalign.log import Log
from jaxalign.method import AbstractMethod
from jaxalign.metrics import attitude_error_deg, component_rms
from jaxalign.parametrization import parameters
from jaxalign.prefilter import AbstractPrefilter
from jaxalign.solution import FilterRecord, Solution, Status
from jaxalign.tables import aligned
from jaxalign.units import DEG_H, UG

__all__ = ["summary"]

_ROWS = 12  # of the table
_FEW = 20  # innovations to judge by
_SUSPECT, _BROKEN = 3.0, 30.0  # misfits, in standard deviations of the noise


class _Residuals(NamedTuple):
    """What the fixes of an aid are off.

    Attributes:
        name: of the aid; empty where there is one.
        value: (K, m) in its unit for people; zero where there is none.
        unit: that.
        used: (K,) which count.
        sd: (K,) standard deviation of its noise, in that unit.
    """

    name: str
    value: np.ndarray
    unit: str
    used: np.ndarray
    sd: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """(K,) root mean square of the components that there are."""
        return component_rms(self.value)


def _residuals(method: AbstractMethod, solution: Solution) -> list[_Residuals]:
    """Of each aid."""
    only = len(method.aids) == 1
    if only and (method.aids[0].full_velocity or method.aids[0].implied):
        return [
            _Residuals("", np.asarray(solution.residual), "m/s", method.counted(solution), np.asarray(solution.aid_sd))
        ]
    out = []
    for aid in method.aids:
        found = solution.aids[aid.name]
        factor, unit = (float(np.rad2deg(1.0)), "deg") if aid.unit == "rad" else (1.0, aid.unit)
        used = np.asarray(solution.defined) & np.asarray(found.valid) & (np.asarray(found.weight) > 0)
        value, sd = np.asarray(found.residual) * factor, np.asarray(found.sd) * factor
        out.append(_Residuals("" if only else aid.name, value, unit, used, sd))
    return out


def _attitudes(log: Log, method: AbstractMethod, solution: Solution, error: np.ndarray | None) -> str:
    numbers = solution.to_numpy()
    time, status = numbers["t"] + log.t0, numbers["status"]
    sd = numbers.get("euler_sd_deg")
    deviation = [] if sd is None else ["its sd deg"]
    residuals = _residuals(method, solution)
    several = len(residuals) > 1
    misfit = "residual sd" if several else f"residual {residuals[0].unit}"
    head = ["time s", "pitch deg", "roll deg", "heading deg", *deviation, "observable", misfit]
    rows = []
    for k in np.unique(np.linspace(min(1, len(time) - 1), len(time) - 1, _ROWS).round().astype(int)):
        pitch, roll, _ = numbers["euler_deg"][k]
        if several:  # of all components together
            whitened = [one.size[k] / one.sd[k] for one in residuals if one.used[k]]
            size = f"{np.sqrt(np.mean(np.square(whitened))):.2f}" if whitened else "-"
        else:
            size = f"{float(np.linalg.norm(residuals[0].value[k])):.4f}"
        rows.append(
            [
                f"{time[k]:.1f}",
                f"{pitch:.4f}",
                f"{roll:.4f}",
                f"{numbers['heading_deg'][k]:.3f}",
                *([] if sd is None else [f"{sd[k, 2]:.3f}"]),
                "yes" if numbers["observable"][k] else "no",
                "no aid" if status[k] & Status.AID_MISSING else size,
            ]
        )
        if error is not None:
            rows[-1].append(f"{error[k, 2]:.3f}")
    return aligned(head if error is None else [*head, "heading error deg"], rows).replace("nan", " - ")


def _trust(log: Log, method: AbstractMethod, solution: Solution, interval: float) -> list[str]:
    """How far to trust the heading."""
    out = []
    time, seen = np.asarray(solution.time) + log.t0, np.asarray(solution.observable)
    noise = "noise of the force" if method.standing else "noise of the aid"
    if not solution.defined[-1]:
        out.append(f"NO ATTITUDE to the end: the method never saw {method.needs}")
    elif seen[-1]:
        first = int(np.flatnonzero(~seen)[-1]) + 1 if not seen.all() else 0
        steps = np.diff(np.asarray(solution.time))
        sparse = " (rows are that far apart)" if steps.size and steps.max() > 1.5 * interval else ""
        rest = (
            ": its standard deviation is below 20 deg"
            if method.judges_by_covariance
            else f", as far as the {noise} is concerned"
        )
        out.append(f"heading observable from {time[first]:.1f} s on{sparse}{rest}")
    elif method.judges_by_covariance:
        out.append("heading NOT observable: its standard deviation is above 20 deg; pitch and roll only")
    else:
        out.append(f"heading NOT observable: the directions never open beyond the {noise}; pitch and roll only")
    ratio = method.misfit(solution, interval)
    if ratio > _BROKEN:
        out.append(
            f"  but the vectors miss by {ratio:.0f} times that noise: the model does not fit (biases of a low-cost "
            "unit? wrong site, axes or units?): do not trust the heading"
        )
    elif ratio > _SUSPECT:
        out.append(
            f"  but the vectors miss by {ratio:.0f} times that noise: slow errors rule (sensor biases, drift of the "
            "aid, disturbance): the heading is less certain than the noise alone would make it"
        )
    note = " (of reconstructed vectors: they hide outliers and biases)" if method.fits_vectors else ""
    for one in _residuals(method, solution):
        if one.used.any():
            size, what = one.size[one.used], f"residual of {one.name}" if one.name else "residual"
            axes = " per axis" if one.value.shape[1] > 1 else ""
            rms = np.sqrt(np.mean(size**2))
            out.append(f"{what}{axes}: rms {rms:.4f}, largest {size.max():.4f} {one.unit}{note}")
    if solution.covariance is not None and solution.filter is not None and solution.defined[-1]:
        if solution.filter.innovation is not None:
            sd = np.sqrt(np.diagonal(solution.covariance, axis1=1, axis2=2))
            out += _belief(sd, solution.filter, method.front_end.prefilter is not None)
        out += _found(solution.filter, method)
    for _, seen in aids_for(log, method.aids):
        if seen is not None and (lost := int(seen.missing.sum())):
            what = "aid" if len(method.aids) == 1 else seen.name
            out.append(f"{what} missing at {lost} of {len(seen.time)} of its epochs: skipped and bridged")
    singular = (np.asarray(solution.status) & Status.SINGULAR) != 0
    if singular.any():
        since = time[np.flatnonzero(singular)[0]]
        out.append(f"THE FILTER IS SINGULAR from {since:.1f} s on: no vector since then was used; do not use it")
    if np.asarray(solution.status)[-1] & Status.NON_FINITE:
        out.append("THE RESULT IS NOT FINITE: the data overflow somewhere; do not use it")
    return out


def _described(prefilter: AbstractPrefilter) -> str:
    values = ", ".join(f"{path} {value}" for path, value in parameters(prefilter).items())
    return f"{type(prefilter).__name__} ({values})"


def _sure(solution: Solution, t0: float, aligned: float | None, filtered: bool) -> list[str]:
    """Standard deviations at the end, and since when they are good enough."""
    sd = solution.euler_sd_deg
    assert sd is not None
    hint = bool(np.asarray(solution.status)[-1] & Status.INDICATIVE)
    note = f" (indicative only: {'a prefilter colours the noise' if filtered else 'no small angle'})" if hint else ""
    pitch, roll, heading = sd[-1]
    out = [f"standard deviations at the end: pitch {pitch:.4f}, roll {roll:.4f}, heading {heading:.3f} deg{note}"]
    if aligned is not None:
        enough = solution.aligned(aligned)
        first = float(np.asarray(solution.time)[enough.argmax()]) + t0
        out.append(
            f"ALIGNED from {first:.1f} s on: heading better than {aligned:g} deg"
            if enough[-1]
            else f"NOT ALIGNED: the heading's standard deviation is not below {aligned:g} deg"
        )
    return out


def _belief(sd: Any, told: FilterRecord, filtered: bool) -> list[str]:
    """What the filter says of itself."""
    east, north, up = np.rad2deg(np.asarray(sd)[-1])
    out = [f"the filter's own standard deviations: east {east:.4f}, north {north:.4f}, heading {up:.4f} deg"]
    out += _surprise(told, filtered)
    first = np.rad2deg(np.asarray(sd)[1, 2]) if len(sd) > 1 else np.inf
    if up > 0.5 * first:
        out.append(
            "  the heading is hardly better known than at its start: it is the coarse one, give it a longer record"
        )
    return out


def _found(told: FilterRecord, method: AbstractMethod) -> list[str]:
    """Biases, and what was found of the aid with its standard deviations."""
    gyro, accel = np.asarray(told.gyro_bias)[-1] / DEG_H, np.asarray(told.accel_bias)[-1] / UG
    out = [f"  biases (right, forward, up): gyros {_numbers(gyro)} deg/h, accelerometers {_numbers(accel)} ug"]
    if told.calibration is None:
        return out
    values = np.asarray(told.calibration)[-1]
    sd = np.sqrt(np.diagonal(np.asarray(told.covariance)[-1])[-len(values) :])

    def shown(where: slice, scale: float = 1.0) -> str:
        return ", ".join(f"{scale * x:.3g} +- {scale * s:.2g}" for x, s in zip(values[where], sd[where], strict=True))

    parts = []
    shown_as = _units(method)
    for name, where in method.unknowns.items():
        scale, unit = shown_as[name]
        parts.append(f"{name.replace('.', ' ')} {shown(where, scale)} {unit}".rstrip())
    return [*out, f"  of the aid: {'; '.join(parts)}"]


def _units(method: AbstractMethod) -> dict[str, tuple[float, str]]:
    """Of each unknown of the aids the factor and the unit in which it is shown."""
    out = {}
    for aid in method.aids:
        for name, unknown in aid.known_unknowns.items():
            shown = {"rad": (float(np.rad2deg(1.0)), "deg"), "1": (100.0, "%")}.get(unknown.unit, (1.0, unknown.unit))
            out[name if len(method.aids) == 1 else f"{aid.name}.{name}"] = shown
    return out


def _surprise(told: FilterRecord, filtered: bool) -> list[str]:
    """How large the innovations of a filter are against what it expects."""
    from jaxalign.fine import nis

    if told.innovation is None or told.innovation_covariance is None:
        return []
    used = np.asarray(told.updated) > 0
    if used.sum() < _FEW:
        return []
    size = told.innovation.shape[1]
    ratio = float(np.mean(nis(told.innovation[used], told.innovation_covariance[used]))) / size
    judged = ""
    if filtered:
        judged = ": behind a prefilter that is no test, and the standard deviations are not honest"
    elif ratio > 2:
        judged = ": its noise is stated too small (filter.velocity_sd?): do not trust its standard deviations"
    elif ratio < 0.5:
        judged = ": its noise is stated too large (filter.velocity_sd?): its standard deviations are cautious"
    return [f"  its innovations squared are {ratio:.2g} times what it expects{judged}"]


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{x:.3g}" for x in values)


def _aids(log: Log) -> str:
    """What aids a log has, in a few words."""
    return ", ".join(one.aid.described for one in log.aids) or "no aid (standing)"


def _noise(method: AbstractMethod, solution: Solution, aid: AbstractAid, stated: Any, interval: float) -> str:
    """The noise of an aid, and where it comes from."""
    found = float(solution.aids[aid.name].sd[-1])
    whose = "the aid" if len(method.aids) == 1 else aid.name
    kind, source = f"white noise of {whose}", "estimated from the data" if stated is None else "as stated"
    if aid.implied:
        kind = f"noise of the force, integrated over {interval:g} s,"
    if method.finds_noise:
        kind = "disturbance of the velocity" if aid.implied else f"noise of {whose}"
        if stated is None:
            source = "by the data"
        else:
            said = float(np.sqrt(np.mean(np.square(stated))))
            source = f"by the data; stated: {_with_unit(said, aid.unit)}".removesuffix(f" {aid.unit}")
    return f"{kind} {_with_unit(found, aid.unit)} ({source})"


def _with_unit(value: float, unit: str) -> str:
    return f"{np.degrees(value):.2g} deg" if unit == "rad" else f"{value:.2g} {unit}"


def summary(
    log: Log,
    name: str,
    method: AbstractMethod,
    solution: Solution,
    stated: Mapping[str, Any],
    aligned: float | None = None,
    reasons: Sequence[str] = (),
) -> list[str]:
    """All of it.

    Args:
        log: that was aligned.
        name: of the method.
        method: itself.
        solution: what it found.
        stated: noise of each aid by its name; None: it was estimated from the log.
        aligned: threshold of the heading's standard deviation, deg.
        reasons: why the method was chosen.
    """
    solution = jax.device_get(solution)  # a row of an array on a device is a program to be compiled
    interval = (method.front_end.interval_samples or log.epoch_samples) * log.dt
    noises = [_noise(method, solution, aid, stated.get(aid.name), interval) for aid in method.aids]
    prefilter = method.front_end.prefilter
    filtered = None if prefilter is None else _described(prefilter)
    error = attitude_error_deg(solution, log)
    pitch, roll, _ = solution.euler_deg[-1]
    out = [
        f"{log.name}: {_aids(log)}, {log.duration:g} s, IMU {1 / log.dt:g} Hz, epochs of {interval:g} s",
        f"method {name}; {'; '.join(noises)}",
        *(f"  {reason}" for reason in reasons),
        *([] if filtered is None else [f"specific force behind {filtered}"]),
        *(f"warning: {warning}" for warning in log.warnings),
        "",
        _attitudes(log, method, solution, error),
        "",
        *_trust(log, method, solution, interval),
    ]
    if not solution.defined[-1]:
        return out
    if solution.covariance is not None:
        out += _sure(solution, log.t0, aligned, prefilter is not None)
    if error is not None:
        e, n, u = error[-1]
        out.append(f"error against the reference at the end: east {e:.4f}, north {n:.4f}, heading {u:.3f} deg")
    end = float(solution.time[-1]) + log.t0
    out.append(
        f"at {end:.1f} s: pitch {pitch:.4f} deg, roll {roll:.4f} deg, heading {solution.heading_deg[-1]:.3f} deg"
    )
    return out
