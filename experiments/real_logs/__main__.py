"""`python -m experiments.real_logs`: one table of all real logs, into results.md.

The logs are not part of the project: give their folder (``--data``), laid out as data/*/*.npz.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from experiments.progress import progress  # noqa: E402
from jaxalign import Log, Measurements, Solution, align, choose, estimate_aid_sd, parametrization, read  # noqa: E402
from jaxalign.aids import AbstractAid, BodyVelocity, NavVelocity, Standing  # noqa: E402
from jaxalign.errors import UserError  # noqa: E402
from jaxalign.inertial_unit import PER_SAMPLE, imu_errors  # noqa: E402
from jaxalign.methods import RECIPES, build, build_for  # noqa: E402
from jaxalign.metrics import attitude_error_deg  # noqa: E402

HERE = Path(__file__).parent
MOVING = {
    "oba": ("oba", {}),
    "oba, as published": ("oba_as_published", {}),
    "oba, 60 s window": ("oba", {"observe.window": 60.0}),
    "centred_oba": ("centred_oba", {}),
    "revising_oba": ("revising_oba", {}),
    "robust_map": ("robust_map", {}),
    "auto": ("auto", {}),
}
OWN = {name: recipe for name, recipe in RECIPES.items() if not recipe.published}
STANDING = {name: (name, {}) for name, recipe in OWN.items() if recipe.takes(Standing())} | {
    "dual_vector, RLS": ("dual_vector_as_published", {"vectors": "rls"}),
    "velocity_q, unit vectors": ("velocity_q", {"estimate.normalise": True}),
    "quaternion_kf, each 0.02 s": ("quaternion_kf", {"front_end.interval_samples": 2, "estimate.averaging": 0.0}),
    "rls_quaternion_kf, each 0.02 s": ("rls_quaternion_kf", {"front_end.interval_samples": 2}),
    "robust_map": ("robust_map", {"front_end.interval_samples": 100}),
    "auto": ("auto", {}),
}
FIGURES = parametrization.parameters(imu_errors("mems"))
MEMS = {f"imu.{path}": value for path, value in FIGURES.items() if path not in PER_SAMPLE}
OUTLIERS, FACTOR, DRAWS = 0.02, 200.0, 20  # probability, times the noise of the aid, draws per log
# The first 300 s by an independent toolbox: pitch, roll, yaw in degrees.
TOOLBOX = {
    "inertial-frame Wahba": (0.8036, 0.3108, -90.608),
    "inertial-frame position fit": (0.8036, 0.3110, -90.625),
    "inertial-frame velocity fit": (0.8036, 0.3105, -90.575),
    "velocity Kalman filter": (0.8034, 0.3105, -90.582),
    "gyrocompass loop": (0.8033, 0.3108, -90.632),
    "averaging analytic coarse alignment": (0.876, 0.287, -83.25),
}


def at(time: np.ndarray, t: float) -> int:
    """The row nearest to a time."""
    return int(np.argmin(np.abs(time - t)))


def made(name: str, log: Log, parameters: dict[str, Any] | None = None, aid_sd: float | None = None) -> Any:
    """A method by name; "auto": what is chosen for the log."""
    if name == "auto":
        return choose(log, aid_sd=aid_sd).method
    return build_for(tuple(one.aid for one in log.aids), name, parameters)


def aligned(method: Any, log: Log, seconds: float) -> Solution:
    """Rows at every epoch; of the batch estimator, which starts anew for each, so many seconds apart."""
    if not method.rows_are_costly:
        return align(method, log)
    return align(
        method, log, every=max(round(seconds / ((method.front_end.interval_samples or log.epoch_samples) * log.dt)), 1)
    )


def moving_table(logs: list[Log]) -> list[str]:
    """Heading and tilt errors over time."""
    out = [
        "| log | method | aid noise m/s | heading error deg at 100 s | 200 s | 300 s | end | stated sd | tilt error "
        "deg at 300 s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for log in logs:
        for label, (name, parameters) in MOVING.items():
            solution = aligned(made(name, log, parameters), log, 100.0)
            error, time = attitude_error_deg(solution, log), np.asarray(solution.time)
            assert error is not None
            deviations = solution.euler_sd_deg
            stated = "" if deviations is None else f"{deviations[-1, 2]:.3f}"
            cells = [f"{error[at(time, t), 2]:+.3f}" for t in (100, 200, 300, time[-1])]
            tilt = np.linalg.norm(error[at(time, 300), :2])
            noise = f"{float(solution.aid_sd[-1]):.4f}"
            out.append(f"| {log.name} | {label} | {noise} | {' | '.join(cells)} | {stated} | {tilt:.4f} |")
    return out


def with_outliers(log: Log, sd: float, draw: int) -> Log:
    """Some velocities after the first off by white noise of many times the aid's, on all axes."""
    rng, velocity = np.random.default_rng(draw), log.aids[0].value
    hit = rng.random(len(velocity)) < OUTLIERS
    hit[0] = False
    jumps = rng.normal(size=velocity.shape) * FACTOR * sd
    return log.with_aid(dataclasses.replace(log.aids[0], value=velocity + np.where(hit[:, None], jumps, 0.0)))


def recipes_table(logs: list[Log], aid: AbstractAid) -> list[str]:
    """Every recipe: heading errors after 300 s as the log is, and with outliers."""
    logs = [log.crop(0.0, min(300.0, log.duration)) for log in logs]
    names = [name for name, recipe in OWN.items() if recipe.takes(aid)]
    out = [f"| log | noise m/s | {' | '.join(names)} |", "|---|---|" + "---|" * len(names)]
    sizes: dict[str, list[float]] = {name: [] for name in names}
    for log in logs:
        epochs = build("oba", aid).epochs(log)
        sd = estimate_aid_sd(epochs)
        seen = [with_outliers(log, sd, draw) for draw in range(DRAWS)]
        cells = []
        for name in names:
            clean, *bad = (heading_error(made(name, x, aid_sd=sd), x, sd) for x in (log, *seen))
            sizes[name] += [abs(x) for x in bad]
            cells.append(f"{clean:+.2f} ({np.median(np.abs(bad)):.2f}, {np.max(np.abs(bad)):.2f})")
        out.append(f"| {log.name} | {sd:.4f} | {' | '.join(cells)} |")
    pooled = (f"{np.sqrt(np.mean(np.square(x))):.2f}" for x in sizes.values())
    return [*out, f"| RMS of all draws | | {' | '.join(pooled)} |"]


def heading_error(method: Any, log: Log, sd: float) -> float:
    """Deg, at the end."""
    error = attitude_error_deg(align(method, log, every=log.epochs, aid_sd=sd), log)
    assert error is not None
    return float(error[-1, 2])


def satellite_like(path: Path) -> Log:
    """A log with the reference's velocity in n for an aid, in place of its Doppler log."""
    with np.load(path) as arrays:
        velocity = arrays["v_n_true"]
    log = read(path)
    return dataclasses.replace(log, aids=(Measurements(NavVelocity(), log.aids[0].time, velocity),))


def standing_table(log: Log) -> list[str]:
    """Attitude over time, beside an independent toolbox."""
    out = [
        "| method | pitch deg at 300 s | roll | yaw | yaw at 60 s | 100 s | 600 s | end |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for label, (name, parameters) in STANDING.items():
        solution = aligned(made(name, log, parameters), log, 20.0)
        euler, time = solution.euler_deg, np.asarray(solution.time)
        pitch, roll, yaw = euler[at(time, 300)]
        later = " | ".join(f"{euler[at(time, t), 2]:.3f}" for t in (60, 100, 600, time[-1]))
        out.append(f"| {label} | {pitch:.4f} | {roll:.4f} | {yaw:.3f} | {later} |")
    for name, (pitch, roll, yaw) in TOOLBOX.items():
        out.append(f"| toolbox: {name} | {pitch:.4f} | {roll:.4f} | {yaw:.3f} | | | | |")
    return out


def window_table(log: Log, bias: np.ndarray) -> list[str]:
    """Heading errors at the end of 60 s windows in which the speed changes enough."""
    out = [
        "| method | gyro bias | windows | median of the heading error's size, deg | 90 % | median with outliers | 90 % "
        "| within 2 stated sd | lever arm m |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    sd = estimate_aid_sd(build("oba", "nav").epochs(log))
    corrected = dataclasses.replace(log, dtheta=log.dtheta - bias * log.dt)
    for label, name, parameters in (
        ("oba", "oba", {}),
        ("oba, normalised", "oba", {"estimate.normalise": True}),
        ("centred_oba", "centred_oba", {}),
        ("revising_oba", "revising_oba", {}),
        ("robust_map, mems", "robust_map", MEMS),
        ("auto", "auto", {}),
    ):
        for kind, data in (("as it is", log), ("removed (from the reference)", corrected)):
            if name in ("robust_map", "auto") and data is corrected:
                continue
            errors, struck, held, arms = [], [], [], []
            for start in range(0, int(log.duration) - 60, 10):
                part = data.crop(start, start + 60)
                velocity = part.aids[0].value
                change = velocity[-1] - velocity[0]
                if not np.linalg.norm(change) > 8.0:
                    continue
                for sizes, one in ((errors, part), (struck, with_outliers(part, sd, start))):
                    solution = align(made(name, one, parameters), one, every=10**6)
                    error = attitude_error_deg(solution, one)
                    assert error is not None
                    sizes.append(abs(error[-1, 2]))
                    if solution.sd is not None:
                        arms += _lever(solution)
                        held.append(abs(error[-1, 2]) < 2 * np.rad2deg(solution.sd[-1, 2]))
            numbers = [f(x) for x in (errors, struck) for f in (np.median, lambda y: np.percentile(y, 90))]
            told = f"{100 * np.mean(held):.0f} %" if held else ""
            out.append(
                f"| {label} | {kind} | {len(errors)} | {' | '.join(f'{x:.2f}' for x in numbers)} | {told} | "
                f"{_numbers(np.median(arms, axis=0)) if arms else ''} |"
            )
    return out


def _lever(solution: Solution) -> list[np.ndarray]:
    """The lever arm found at the end, if there is one among the unknowns (the last three), m."""
    told = solution.filter
    if told is None or told.calibration is None or told.calibration.shape[1] < 3:
        return []
    return [np.asarray(told.calibration)[-1, -3:]]


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{x:+.2f}" for x in values)


def short_windows(log: Log) -> list[str]:
    """Windows of 20 s by the method chosen: errors and what is said of them."""
    out = [
        "| window s | heading error deg | stated sd | tilt error deg | stated sd | lever arm m |",
        "|---|---|---|---|---|---|",
    ]
    for start in range(0, int(log.duration) - 20, 10):
        part = log.crop(float(start), float(start + 20))
        solution = align(choose(part).method, part, every=10**6)
        error, sd = attitude_error_deg(solution, part), solution.sd
        assert error is not None
        assert sd is not None
        (e, n, u), (se, sn, su) = error[-1], np.rad2deg(np.asarray(sd)[-1])
        out.append(
            f"| {start}-{start + 20} | {u:+.2f} | {su:.2f} | {np.hypot(e, n):.3f} | {np.hypot(se, sn):.3f} "
            f"| {_numbers(_lever(solution)[0])} |"
        )
    return out


def main() -> int:
    """Write results.md."""
    shared = Path(os.environ.get("JAXALIGN_SHARED", "../shared"))
    parser = argparse.ArgumentParser(prog="python -m experiments.real_logs", description=__doc__)
    parser.add_argument("--data", type=Path, default=shared / "data", help="folder of logs (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=HERE / "results.md", help="file to write (default: %(default)s)")
    options = parser.parse_args()
    if not options.data.is_dir():
        print(f"real_logs: error: no folder {options.data}: give the folder of the logs with --data", file=sys.stderr)
        return 2
    try:
        text = report(options.data)
    except UserError as error:
        print(f"real_logs: error: {error}", file=sys.stderr)
        return 2
    options.output.write_text(text)
    print(f"wrote {options.output}")
    return 0


def report(data: Path) -> str:
    """The whole page."""
    with progress("real logs", 8, unit="table") as bar:

        def fresh(rows: list[str]) -> list[str]:
            """Room for further programs: all of them together are more than a process may map."""
            jax.clear_caches()
            bar.update()
            return rows

        return _page(data, fresh)


def _page(data: Path, fresh: Callable[[list[str]], list[str]]) -> str:
    paths = sorted(data.glob("*real_akit/*.npz"))
    auv = [read(path) for path in paths]
    laser = read(data / "lasergyro" / "lasergyro_first_half.imu")
    car = read(data / "n380_car" / "n380_hill.npz")
    with np.load(data / "n380_car" / "n380_hill.npz") as arrays:
        bias = arrays["gyro_bias_vs_ins_rad_s"]
    mems = read(data / "fog_mems" / "psins_fog_mems.npz")
    parts = [
        "# Real logs",
        "",
        "Written by `python -m experiments.real_logs`. Errors are estimate minus reference: heading clockwise, tilt",
        "the norm of the two level errors. The noise of the aid is estimated from each log. `robust_map` takes each",
        "unit for navigation grade (its default); `auto` is what `jaxalign align` does by itself.",
        "",
        "## AUV at sea: FOG INS and DVL (semi_real: synthetic navigation-grade IMU on the real motion, real DVL)",
        "",
        "The gyro of the real logs is rounded to 1e-4 rad/s; that, not the DVL, sets the heading error.",
        "",
        *fresh(moving_table(auv)),
        "",
        "Every recipe, the first 300 s: heading error in deg as the log is, and in brackets the median and the largest",
        f"of {DRAWS} draws with outliers: {100 * OUTLIERS:g} % of the velocities but the first, noise x {FACTOR:g}.",
        "",
        *fresh(recipes_table(auv, BodyVelocity())),
        "",
        "The same logs with the reference's velocity in n for an aid (hardly any noise), which is what a GNSS receiver",
        "would give; outliers as above.",
        "",
        *fresh(recipes_table([satellite_like(path) for path in paths], NavVelocity())),
        "",
        "## Ring-laser unit on a standing, disturbed vehicle (no reference; the file's header says yaw -90.6)",
        "",
        *fresh(standing_table(laser)),
        "",
        "`triad` takes the base as not turning, which it does: the same failure as the toolbox's averaging method.",
        "",
        "## Car: tactical MEMS unit and GNSS velocity, windows of 60 s started every 10 s with |v_end - v_0| > 8 m/s",
        "",
        *fresh(window_table(car, np.asarray(bias))),
        "",
        "The gyro bias (140 deg/h) hides the Earth rate; the heading comes from the accelerations. `auto` takes the",
        "unit for what it is, and finds its biases and the lever arm to the antenna (last column: median over the",
        "windows; right, forward, up). Outliers: as above.",
        "",
        "## Car, nearly straight: MEMS unit and FOG reference, 100 s",
        "",
        *fresh(moving_table([mems])),
        "",
        "Every recipe at the end, as the log is and with outliers as above:",
        "",
        *fresh(recipes_table([mems], NavVelocity())),
        "",
        "The bias of the gyro (140-290 deg/h) and a nearly straight drive leave tens of degrees to a method without",
        "biases. With them and the lever arm to the antenna the accelerations do tell the heading, to what is stated:",
        "",
        *fresh(short_windows(mems)),
        "",
    ]
    return "\n".join(parts)


if __name__ == "__main__":
    sys.exit(main())
