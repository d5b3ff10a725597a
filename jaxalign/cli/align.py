"""``jaxalign align``: from a log to an attitude."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxalign.errors import UserError

if TYPE_CHECKING:
    from jaxalign.inertial_unit import ImuErrors
    from jaxalign.log import Log
    from jaxalign.method import AbstractMethod

__all__ = ["add"]

_ROWS = 50  # of a method whose rows are costly


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
        help="auto (default: robust_map, with unknowns and grade of the inertial unit that fit the log), or one of "
        "`jaxalign methods`",
    )
    command.add_argument(
        "--method-file", metavar="FILE", help="a method with its numbers, as written by `jaxalign tune --output` (JSON)"
    )
    command.add_argument(
        "--prefilter",
        metavar="NAME",
        help="low-pass filter of the specific force of a standing vehicle, see `jaxalign methods` (default: none)",
    )
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SLOT.FIELD=VALUE",
        help="a parameter of the method, e.g. observe.window=60, front_end.prefilter.cutoff=0.5; may be repeated",
    )
    command.add_argument(
        "--every",
        type=int,
        metavar="N",
        help="read out the attitude every N epochs (default 1; for robust_map, whose rows are costly, 50 rows at most)",
    )
    command.add_argument(
        "--imu",
        metavar="GRADE",
        help="of the inertial unit: navigation, tactical or mems, or a TOML file of its figures ([gyro] bias_deg_h, "
        "walk_deg_sqrt_h and [accel] bias_ug, density_ug_sqrt_hz, each a number or three); auto, robust_map and fine "
        "use it, and any other method states standard deviations (default of auto: by the data)",
    )
    command.add_argument(
        "--aligned",
        type=float,
        metavar="DEG",
        help="say from when on the heading's standard deviation is below DEG (with --imu, or a method that knows it)",
    )
    command.add_argument("--output", metavar="OUT.npz", help="write the attitudes and all that goes with them")
    command.add_argument("--plot", metavar="OUT.png", help="write a picture: .png, .pdf or .svg (needs matplotlib)")
    command.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    import jax
    import numpy as np
    from tqdm import tqdm

    import jaxalign
    from jaxalign.alignment import align
    from jaxalign.cli.report import check_outputs, read_log
    from jaxalign.cli.summary import summary
    from jaxalign.epochs import check_every
    from jaxalign.files import replacing
    from jaxalign.front_end import aids_for
    from jaxalign.inertial_unit import imu_figures
    from jaxalign.method_file import method_entries
    from jaxalign.solution import check_threshold
    from jaxalign.uncertainty import assess

    if options.aligned is not None:
        check_threshold(options.aligned)
    if options.every is not None:
        check_every(options.every)
    plots = None
    if options.plot:
        from jaxalign import plots

        plots.require()
    check_outputs(options, [options.file, options.columns, options.method_file])
    log = read_log(options)
    imu = None if options.imu is None else imu_figures(options.imu).at_rate(1.0 / log.dt)
    name, method, reasons = _method(options, log, imu)  # to choose one takes solutions of the log
    moving = None if log.velocity_aid is None else log.velocity_aid.velocity
    if method.standing and moving is not None:
        speed = float(np.nanmedian(np.linalg.norm(moving, axis=1)))
        if speed > 0.5:
            raise UserError(
                f"{name} takes the vehicle as standing, but the aid of {log.name} says {speed:.1f} m/s: use a method "
                "that takes its aid (oba, centred_oba), or cut out a standing part with --start and --end"
            )
    if options.aligned is not None and imu is None and not method.has_covariance:
        raise UserError(
            f"--aligned: {name} knows no standard deviations by itself: say what unit it is with --imu navigation, "
            "tactical or mems"
        )
    every = _every(options, method, log)
    with tqdm(total=_ROWS, unit="row", delay=1.0, disable=None, leave=False) as bar:

        def done(rows: int) -> None:
            bar.update(rows)

        if imu is None:
            found = align(method, log, every, options.aid_sd, done)
        else:
            found = assess(method, log, imu, every, options.aid_sd, done=done)
        solution = jax.block_until_ready(found)

    # Files first: a reader of the printed lines that leaves early (head) must not cost the results.
    observed = [seen for _, seen in aids_for(log, method.aids)]
    of_log = [None if seen is None else seen.sd for seen in observed]
    stated = {
        aid.name: sd if options.aid_sd is None else options.aid_sd for aid, sd in zip(method.aids, of_log, strict=True)
    }
    first = stated[method.aids[0].name]
    written = []
    if options.output:
        recipe = {
            **method_entries(name, method),
            "every": every,
            "imu": options.imu,
            "aid_sd": np.asarray(solution.aid_sd[-1] if first is None else first).tolist(),
            "aid_sd_from": "data" if first is None else "user" if options.aid_sd is not None else "log",
            "log": log.name,
            "jaxalign": jaxalign.__version__,
        }
        arrays = {**solution.to_numpy(), "recipe": np.array(json.dumps(recipe))}
        arrays["t"] = arrays["t"] + log.t0
        with replacing(options.output) as stream:
            np.savez_compressed(stream, **arrays)
        written.append(options.output)
    if plots is not None:
        figure = plots.attitude(solution, log, title=f"{log.name}: {name}")
        with replacing(options.plot) as stream:
            figure.savefig(stream, format=Path(options.plot).suffix[1:].lower())
        written.append(options.plot)
    lines = summary(log, name, method, solution, stated, options.aligned, reasons)
    for line in (*lines, *(f"wrote {path}" for path in written)):
        print(line)
    return 0


def _every(options: argparse.Namespace, method: AbstractMethod, log: Log) -> int:
    """Epochs between rows."""
    if options.every is not None or not method.rows_are_costly:
        return 1 if options.every is None else options.every
    count = _rows(log, method)
    return max(-(-count // _ROWS), 1)


def _rows(log: Log, method: AbstractMethod) -> int:
    """About how many epochs there will be."""
    from jaxalign.front_end import aids_for

    fixes = max((len(seen.time) for _, seen in aids_for(log, method.aids) if seen is not None), default=0)
    return max(fixes - 1, log.epochs * log.epoch_samples // (method.front_end.interval_samples or log.epoch_samples))


def _method(
    options: argparse.Namespace, log: Log, imu: ImuErrors | None
) -> tuple[str, AbstractMethod, tuple[str, ...]]:
    """Name, method, and why it was chosen if it was not named."""
    from jaxalign.auto import choose
    from jaxalign.cli.report import assignments
    from jaxalign.front_end import aids_for
    from jaxalign.method_file import read_method
    from jaxalign.methods import build_for, with_settings

    settings = assignments(options.set)
    if options.method_file is None:
        name = options.method or "auto"
        if name == "auto" and options.prefilter is None:
            choice = choose(log, imu, options.aid_sd, settings)
            return choice.name, choice.method, choice.reasons
        if name == "auto":
            raise UserError("--prefilter: auto takes none: name a method for a standing vehicle, --method gravity_q")
        return (
            name,
            _with_imu(build_for(tuple(one.aid for one in log.aids), name, settings, options.prefilter), imu),
            (),
        )
    if options.method is not None or options.prefilter is not None:
        flag = "--method" if options.method is not None else "--prefilter"
        raise UserError(f"{flag} and --method-file: give one of them, the file says all of the method")
    name, method, _ = read_method(options.method_file)
    try:
        aids_for(log, method.aids)
    except UserError as error:
        raise UserError(
            f"{options.method_file} holds {name}: {error}: make one for it (jaxalign tune), or name one with --method"
        ) from None
    return name, _with_imu(with_settings(name, method, settings), imu), ()


def _with_imu(method: AbstractMethod, imu: ImuErrors | None) -> AbstractMethod:
    """With the figures of the inertial unit, if they are given and the method uses any."""
    return method if imu is None else method.with_imu(imu)
