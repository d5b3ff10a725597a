"""Logs as NumPy archives (.npz): the project's own format.

Keys: dt_imu (s), dtheta (N, 3) rad, dvel (N, 3) m/s, aid_every (IMU samples per epoch), aid_frame ("body", "nav" or
"static"), aid_v (M+1, 3) m/s (not for "static"), lat, lon (rad), h (m); b = right-forward-up, n = East-North-Up.
Optional: C_nb_true (M+1, 3, 3), aid_sd (m/s), t0 (s). Other keys are ignored.

That is the form of a log with one whole velocity at the epochs, or none. Else, in place of the three: aids, a JSON
text, a list of kind and options of each aid, and for the aid of number i aid_i_time (n,) s since epoch 0, aid_i_value
(n, m) in its unit (NaN where missing) and perhaps aid_i_sd.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from jaxalign import checks
from jaxalign.aids import BodyVelocity, NavVelocity, Standing, aid_of, from_plain, plain
from jaxalign.arguments import whole_number
from jaxalign.errors import UserError
from jaxalign.files import existing_file, first_line, replacing
from jaxalign.log import Log
from jaxalign.measurements import Measurements

__all__ = ["read_npz", "write_npz"]

_REQUIRED = ("dt_imu", "dtheta", "dvel", "aid_every", "lat", "lon", "h")
_OPTIONAL = ("aid_frame", "aid_v", "aids", "C_nb_true", "aid_sd", "t0")
_AID = re.compile(r"aid_\d+_(time|value|sd)")
_KINDS = (Standing.kind, BodyVelocity.kind, NavVelocity.kind)  # of the form with one aid


def read_npz(path: str | os.PathLike[str]) -> Log:
    """Reads a log (module docstring: the keys).

    Increments stored as float32 are converted, and the log says so in its warnings.

    Raises:
        UserError: no file, no archive, damaged, keys missing, or what `Log` refuses.
    """
    path = existing_file(path)
    data = _load(path)
    missing = [key for key in _REQUIRED if key not in data]
    if "aids" not in data:
        missing += [key for key in ("aid_frame",) if key not in data]
    kind = str(data.get("aid_frame", ""))
    if "aid_frame" in data and kind != Standing.kind and "aid_v" not in data:
        missing.append("aid_v")
    if missing:
        raise UserError(
            f"{path}: missing {', '.join(missing)}; a log needs {', '.join(_REQUIRED)}, aid_frame and, unless "
            "aid_frame is 'static', aid_v (or aids)"
        )
    if "aids" not in data and kind not in _KINDS:
        raise UserError(f"{path}: aid_frame is {kind!r}: it must be one of {', '.join(_KINDS)}")
    warnings = []
    for key in ("dtheta", "dvel"):
        if data[key].dtype == np.float32:
            data[key] = data[key].astype(np.float64)
            warnings.append(f"{key} is stored as float32: about 7 digits are left of each increment")
    return Log(
        dtheta=data["dtheta"],
        dvel=data["dvel"],
        dt=data["dt_imu"],
        epoch_samples=data["aid_every"],
        aids=_several(path, data) if "aids" in data else _one(path, data, kind),
        lat=data["lat"],
        lon=data["lon"],
        h=data["h"],
        C_nb=data.get("C_nb_true"),
        t0=data.get("t0", 0.0),
        name=path.stem,
        warnings=tuple(warnings),
    )


def write_npz(log: Log, path: str | os.PathLike[str]) -> None:
    """Writes a log (module docstring: the keys) under exactly this name, complete or not at all.

    Raises:
        UserError: the place cannot be written to.
    """
    data: dict[str, Any] = {
        "dt_imu": log.dt,
        "dtheta": log.dtheta,
        "dvel": log.dvel,
        "aid_every": log.epoch_samples,
        "lat": log.lat,
        "lon": log.lon,
        "h": log.h,
        "t0": log.t0,
    }
    if log.C_nb is not None:
        data["C_nb_true"] = log.C_nb
    if _simple(log):
        data["aid_frame"] = log.aids[0].aid.kind if log.aids else Standing.kind
        for one in log.aids:
            data["aid_v"] = one.value
            if one.sd is not None:
                data["aid_sd"] = one.sd
    else:
        data["aids"] = json.dumps([plain(one.aid) for one in log.aids])
        for i, one in enumerate(log.aids):
            data[f"aid_{i}_time"], data[f"aid_{i}_value"] = one.time, one.value
            if one.sd is not None:
                data[f"aid_{i}_sd"] = one.sd
    with replacing(path) as stream:
        np.savez(stream, **data)


def _simple(log: Log) -> bool:
    """Whether there is at most one aid, a whole velocity with the usual name at all epochs."""
    if not log.aids:
        return True
    one, at = log.aids[0], np.arange(log.epochs + 1) * log.interval
    usual = any(one.aid == kind() for kind in (BodyVelocity, NavVelocity))
    alike = len(one.time) == len(at) and np.allclose(one.time, at, rtol=0, atol=1e-6 * log.dt)
    return len(log.aids) == 1 and usual and alike and not one.partial and not isinstance(one.sd, np.ndarray)


def _one(path: Path, data: dict[str, Any], kind: str) -> tuple[Measurements, ...]:
    """The aid of a log in the form with one."""
    if kind == Standing.kind:
        return ()
    value, every = np.asarray(data["aid_v"]), whole_number(f"{path}: aid_every", data["aid_every"], floats=True)
    dt = checks.finite_number(str(path), "dt_imu", data["dt_imu"])
    epochs = len(np.asarray(data["dtheta"])) // every
    if value.shape != (epochs + 1, 3):
        raise UserError(
            f"{path}: aid_v has shape {value.shape}: ({epochs + 1}, 3) is expected, a row per epoch from 0 to {epochs}"
        )
    return (Measurements(aid_of(kind), np.arange(len(value)) * (every * dt), value, data.get("aid_sd")),)


def _several(path: Path, data: dict[str, Any]) -> tuple[Measurements, ...]:
    """The aids of a log in the form with any."""
    try:
        aids = [from_plain(one) for one in json.loads(str(data["aids"]))]
        return tuple(
            Measurements(aid, data[f"aid_{i}_time"], data[f"aid_{i}_value"], data.get(f"aid_{i}_sd"))
            for i, aid in enumerate(aids)
        )
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    except (ValueError, TypeError, KeyError) as error:
        raise UserError(f"{path}: its aids cannot be read ({first_line(error)}): make it again") from None


def _load(path: Path) -> dict[str, Any]:
    try:
        with open(path, "rb") as stream:
            archive = np.load(stream, allow_pickle=False)
            if isinstance(archive, np.ndarray):
                raise UserError(f"{path}: a single array, not an .npz archive of a log")
            of_aids = [key for key in archive if _AID.fullmatch(key)]
            return {key: archive[key] for key in (*_REQUIRED, *_OPTIONAL, *of_aids) if key in archive}
    except UserError:
        raise
    except PermissionError:
        raise UserError(f"{path}: cannot be read: permission denied") from None
    except ValueError as error:
        raise UserError(f"{path}: not an .npz archive of plain arrays ({first_line(error)})") from None
    except Exception as error:  # damaged bytes fail in zipfile, zlib, NumPy and its header parser, each in its own way
        raise UserError(f"{path}: damaged or incomplete .npz archive ({first_line(error)}): make it again") from None
