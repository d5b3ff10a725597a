"""``jaxalign align``: from a log to an attitude."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxalign.log import Log
    from jaxalign.solution import Solution

__all__ = ["add"]

_ROWS = 12  # of the printed table


def add(commands: Any) -> None:
    """Add the sub-command."""
    from jaxalign.cli.report import add_log_arguments

    command = commands.add_parser(
        "align",
        help="find the attitude of a vehicle from a log",
        description="Find the attitude of a vehicle from a log: prints pitch, roll and heading over time, whether the "
        "heading is observable yet, and how well the vectors fit.",
    )
    add_log_arguments(command)
    command.add_argument(
        "--method",
        metavar="NAME",
        help="see `jaxalign methods` (default: gravity_q without an aid, centred_oba with one)",
    )
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SLOT.FIELD=VALUE",
        help="a parameter of the method, e.g. observe.window=60; may be repeated",
    )
    command.add_argument(
        "--every", type=int, default=1, metavar="N", help="read out the attitude every N epochs (default 1)"
    )
    command.add_argument("--output", metavar="OUT.npz", help="write the attitudes and all that goes with them")
    command.add_argument("--plot", metavar="OUT.png", help="write a picture (needs matplotlib)")
    command.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    import jax

    import jaxalign
    from jaxalign.aligner import align
    from jaxalign.cli.report import assignments, read_log
    from jaxalign.errors import UserError
    from jaxalign.io.files import replacing
    from jaxalign.methods import RECIPES, build
    from jaxalign.parameters import parameters

    log = read_log(options)
    name = options.method or ("gravity_q" if log.aid == "static" else "centred_oba")
    # A method for a standing vehicle ignores the aid; one that takes any aid takes the log's.
    kinds = RECIPES[name].aids if name in RECIPES else ()
    method = build(name, "static" if kinds == ("static",) else log.aid, assignments(options.set))
    plots = None
    if options.plot:
        from jaxalign import plots

        plots.require()
    for path in (options.output, options.plot):
        if path:
            _writable(path)
    if method.aid == "static" and log.velocity is not None:
        speed = float(np.nanmedian(np.linalg.norm(log.velocity, axis=1)))
        if speed > 0.5:
            raise UserError(
                f"{name} takes the vehicle as standing, but the aid of {log.name} says {speed:.1f} m/s: use a method "
                f"that takes a {log.aid!r} aid (oba, centred_oba), or cut out a standing part with --start and --end"
            )
    solution = jax.block_until_ready(align(method, log, options.every))

    estimated = options.aid_sd is None and (log.aid_sd is None or log.aid != method.aid)
    for line in _report(log, name, solution, estimated):
        print(line)
    if options.output:
        recipe = {
            "method": name,
            "aid": method.aid,
            "parameters": parameters(method),
            "every": options.every,
            "aid_sd": float(solution.aid_sd),
            "aid_sd_from": "data" if estimated else "user" if options.aid_sd is not None else "log",
            "log": log.name,
            "jaxalign": jaxalign.__version__,
        }
        arrays = {**solution.to_numpy(), "recipe": np.array(json.dumps(recipe))}
        arrays["t"] = arrays["t"] + log.t0
        with replacing(options.output) as stream:
            np.savez_compressed(stream, **arrays)
        print(f"wrote {options.output}")
    if plots is not None:
        figure = plots.attitude(solution, log, title=f"{log.name}: {name}")
        with replacing(options.plot) as stream:
            figure.savefig(stream, format="png")
        print(f"wrote {options.plot}")
    return 0


def _writable(path: str) -> None:
    """Refuse an output that cannot be written before anything is computed."""
    import tempfile
    from pathlib import Path

    from jaxalign.errors import UserError

    place = Path(path)
    if place.is_dir():
        raise UserError(f"{path} is a folder: name a file to write")
    if not place.parent.is_dir():
        raise UserError(f"{path}: cannot be written: there is no folder {place.parent}")
    try:
        tempfile.TemporaryFile(dir=place.parent).close()
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {error.strerror or error}") from None


def _report(log: Log, name: str, solution: Solution, estimated: bool) -> list[str]:
    """What a person wants to read, line by line."""
    from jaxalign.cli.report import table
    from jaxalign.metrics import attitude_error_deg
    from jaxalign.solution import Status

    numbers = solution.to_numpy()
    time, status = numbers["t"], numbers["status"]
    interval = log.aid_every * log.dt
    aid = {"static": "no aid (standing)", "body": "body velocity", "nav": "navigation velocity"}[log.aid]
    kind = "white noise of the velocity" if log.aid == "static" else "white noise of the aid"
    sd = float(numbers["aid_sd"])
    out = [
        f"{log.name}: {aid}, {log.duration:g} s, IMU {1 / log.dt:g} Hz, epochs of {interval:g} s",
        f"method {name}; {kind} {sd:.2g} m/s ({'estimated from the data' if estimated else 'as stated'})",
        *(f"warning: {warning}" for warning in log.warnings),
        "",
    ]
    picked = np.unique(np.linspace(min(1, len(time) - 1), len(time) - 1, _ROWS).round().astype(int))
    error = attitude_error_deg(solution, log)
    head = ["time s", "pitch deg", "roll deg", "heading deg", "observable", "residual m/s"]
    rows = []
    for k in picked:
        pitch, roll, _ = numbers["euler_deg"][k]
        missing = bool(status[k] & Status.AID_MISSING)
        size = float(np.linalg.norm(numbers["residual"][k]))
        rows.append(
            [
                f"{time[k]:.1f}",
                f"{pitch:.4f}",
                f"{roll:.4f}",
                f"{numbers['heading_deg'][k]:.3f}",
                "yes" if numbers["observable"][k] else "no",
                "no aid" if missing else f"{size:.4f}",
            ]
        )
        if error is not None:
            rows[-1].append(f"{error[k, 2]:.3f}")
    if error is not None:
        head.append("heading error deg")
    out += [table(head, rows).replace("nan", " - "), ""]

    if status[-1] & Status.NON_FINITE:
        out.append("THE RESULT IS NOT FINITE: the data overflow somewhere; do not use it")
    seen = np.flatnonzero(numbers["observable"])
    if seen.size:
        out.append(f"heading observable from {time[seen[0]]:.1f} s on, as far as the noise of the aid is concerned")
    else:
        out.append("heading NOT observable: the directions never open beyond the noise of the aid; pitch and roll only")
    used = (numbers["weight"] > 0) & ((status & Status.UNDEFINED) == 0)
    if used.any():
        size = np.linalg.norm(numbers["residual"][used], axis=1) / np.sqrt(3)
        out.append(f"residual per axis: rms {np.sqrt(np.mean(size**2)):.4f}, largest {size.max():.4f} m/s")
        ratio = float(np.sqrt(np.mean(size**2))) / sd
        if ratio > 30:
            out.append(
                f"  {ratio:.0f} times the white noise: the model does not fit (biases of a low-cost unit? wrong "
                "site, axes or units?): do not trust the heading"
            )
        elif ratio > 3:
            out.append(
                f"  {ratio:.0f} times the white noise: slow errors rule (sensor biases, drift of the aid, "
                "disturbance): the heading is less certain than the noise alone would make it"
            )
    lost = int(np.sum((status & Status.AID_MISSING) != 0))
    if lost:
        out.append(f"aid missing at {lost} of {len(time)} epochs: skipped and bridged")
    if error is not None:
        e, n, u = error[-1]
        out.append(f"error against the reference at the end: east {e:.4f}, north {n:.4f}, heading {u:.3f} deg")
    pitch, roll, _ = numbers["euler_deg"][-1]
    out.append(
        f"at {time[-1]:.1f} s: pitch {pitch:.4f} deg, roll {roll:.4f} deg, heading {numbers['heading_deg'][-1]:.3f} deg"
    )
    return out
