"""Logs as NumPy archives (.npz): the project's own format.

Keys: dt_imu (s), dtheta (N, 3) rad, dvel (N, 3) m/s, aid_every, aid_frame ("body", "nav" or "static"), aid_v
(M+1, 3) m/s (not for "static"), lat, lon (rad), h (m); b = right-forward-up, n = East-North-Up. Optional:
C_nb_true (M+1, 3, 3), aid_sd (m/s), t0 (s). Other keys are ignored.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from jaxalign.errors import UserError
from jaxalign.io.files import existing_file, first_line, replacing
from jaxalign.log import AIDS, Log

__all__ = ["read_npz", "write_npz"]

_REQUIRED = ("dt_imu", "dtheta", "dvel", "aid_every", "aid_frame", "lat", "lon", "h")
_OPTIONAL = ("aid_v", "C_nb_true", "aid_sd", "t0")


def read_npz(path: str | os.PathLike[str]) -> Log:
    """Reads a log (module docstring: the keys).

    Increments stored as float32 are converted, and the log says so in its warnings.

    Raises:
        UserError: no file, no archive, damaged, keys missing, or what `Log` refuses.
    """
    path = existing_file(path)
    data = _load(path)
    kind = str(data["aid_frame"]) if "aid_frame" in data else ""
    needed = _REQUIRED if kind == "static" else (*_REQUIRED, "aid_v")
    missing = [key for key in needed if key not in data]
    if missing:
        raise UserError(
            f"{path}: missing {', '.join(missing)}; a log needs {', '.join(_REQUIRED)} and, unless "
            "aid_frame is 'static', aid_v"
        )
    if kind not in AIDS:
        raise UserError(f"{path}: aid_frame is {kind!r}: it must be one of {', '.join(AIDS)}")
    warnings = []
    for key in ("dtheta", "dvel"):
        if data[key].dtype == np.float32:
            data[key] = data[key].astype(np.float64)
            warnings.append(f"{key} is stored as float32: about 7 digits are left of each increment")
    return Log(
        dtheta=data["dtheta"],
        dvel=data["dvel"],
        dt=data["dt_imu"],
        aid_every=data["aid_every"],
        aid=kind,
        velocity=None if kind == "static" else data["aid_v"],
        lat=data["lat"],
        lon=data["lon"],
        h=data["h"],
        aid_sd=data.get("aid_sd"),
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
        "aid_every": log.aid_every,
        "aid_frame": log.aid,
        "lat": log.lat,
        "lon": log.lon,
        "h": log.h,
        "t0": log.t0,
    }
    optional = {"aid_v": log.velocity, "C_nb_true": log.C_nb, "aid_sd": log.aid_sd}
    data.update({key: value for key, value in optional.items() if value is not None})
    with replacing(path) as stream:
        np.savez(stream, **data)


def _load(path: Path) -> dict[str, Any]:
    try:
        with open(path, "rb") as stream:
            archive = np.load(stream, allow_pickle=False)
            if isinstance(archive, np.ndarray):
                raise UserError(f"{path}: a single array, not an .npz archive of a log")
            return {key: archive[key] for key in (*_REQUIRED, *_OPTIONAL) if key in archive}
    except UserError:
        raise
    except PermissionError:
        raise UserError(f"{path}: cannot be read: permission denied") from None
    except ValueError as error:
        raise UserError(f"{path}: not an .npz archive of plain arrays ({first_line(error)})") from None
    except Exception as error:  # damaged bytes fail in zipfile, zlib, NumPy and its header parser, each in its own way
        raise UserError(f"{path}: damaged or incomplete .npz archive ({first_line(error)}): make it again") from None
