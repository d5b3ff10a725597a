"""`python -m benchmarks.peers`: `oba` on dvl-sturn by our study and by two loops, the same truth and noise model.

All in one go, on all cores; compile time apart. First it checks that the three agree on the same noise.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from benchmarks.machine import peak_gb

RUNS = (1, 100, 1000, 10_000)
EVERY = (10, 1)
_SELF = resource.RUSAGE_SELF


def measured(function: Callable[[], Any]) -> tuple[float, float]:
    """Wall and CPU seconds of a call (the process's threads together)."""
    before = resource.getrusage(_SELF)
    start = time.perf_counter()
    function()
    wall = time.perf_counter() - start
    after = resource.getrusage(_SELF)
    return wall, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def problem() -> tuple[Any, Any, dict[str, Any]]:
    """Scenario, truth, and what the loops take."""
    from jaxalign.simulate import scenario, truth

    made = scenario("dvl-sturn")
    exact = truth(made)
    dt, triads = float(exact.dt), (made.imu.gyro, made.imu.accel)
    arguments = {
        "dtheta": np.asarray(exact.dtheta),
        "dvel": np.asarray(exact.dvel),
        "velocity": np.asarray(exact.velocity_b),
        "biases": np.stack([np.full(3, x.bias) for x in triads]) * dt,
        "sds": np.array([*(float(x.increment_sd(dt)) for x in triads), float(made.aids[0].sd)]),
        "dt": dt,
        "samples": made.epoch_samples,
        "lat": float(made.site.lat),
        "h": float(made.site.h),
    }
    return made, exact, arguments


def agreement() -> dict[str, float]:
    """Largest angle (rad) between ours and each loop at the last epoch, on the same noise."""
    from benchmarks.peers import loop_numba, loop_numpy
    from jaxalign import BodyVelocity, Log, Measurements, align
    from jaxalign.methods import build
    from jaxalign.rotation import dcm_from_quat, quat_from_dcm

    made, exact, a = problem()
    rng = np.random.default_rng(1)
    n, m = len(a["dtheta"]), len(a["velocity"])
    noise = rng.standard_normal(6 * n + 3 * m)
    z, aid = noise[: 6 * n].reshape(n, 6), noise[6 * n :].reshape(m, 3)
    dtheta = a["dtheta"] + a["biases"][0] + a["sds"][0] * z[:, :3]
    dvel = a["dvel"] + a["biases"][1] + a["sds"][1] * z[:, 3:]
    velocity = a["velocity"] + a["sds"][2] * aid
    seen = Measurements(BodyVelocity(), np.asarray(exact.t), velocity, 0.1)
    log = Log(dtheta, dvel, a["dt"], a["samples"], a["lat"], float(made.site.lon), a["h"], (seen,))
    ours = np.asarray(align(build("oba", "body"), log, every=10).q_nb)[-1]
    out = np.empty((m // 10 + 1, 4))
    rest = (a["dt"], a["samples"], 10, a["lat"], a["h"])
    loop_numba.align(a["dtheta"], a["dvel"], a["velocity"], a["biases"], a["sds"], noise, 0, False, *rest, out)
    plain = np.asarray(quat_from_dcm(loop_numpy.align(dtheta, dvel, velocity, *rest)[-1]))

    def angle(p: Any, q: Any) -> float:
        difference = np.asarray(dcm_from_quat(p)).T @ np.asarray(dcm_from_quat(q))
        return float(np.abs(difference - difference.T).max() / 2)

    return {"numba": angle(ours, out[-1]), "NumPy": angle(ours, plain)}


def repeats(runs: int) -> int:
    """How often to measure, the smallest counts: a few milliseconds are soon disturbed."""
    return 20 if runs < 100 else 3 if runs < 5000 else 1


def ours(runs: int, every: int, fidelity: Any) -> tuple[float, float, float]:
    """Seconds to compile, then wall and CPU seconds of a study (its truth is at hand, as that of the loops is)."""
    from jaxalign.study import Study, run

    made, _, _ = problem()

    def study() -> Any:
        return run(Study(made, ["oba"], max(runs, 2), every=every, fidelity=fidelity))

    compiled, _ = measured(study)
    best = min((measured(study) for _ in range(repeats(runs))), key=lambda x: x[0])
    return compiled - best[0], *best


def numba(runs: int, every: int, plain: bool = False) -> tuple[float, float, float]:
    """What the compiled loop takes, noise drawn on the fly: by numba's generator if plain."""
    from benchmarks.peers import loop_numba

    _, _, a = problem()
    arguments = (a["dtheta"], a["dvel"], a["velocity"], a["biases"], a["sds"])
    rest = (a["dt"], a["samples"], every, a["lat"], a["h"])
    compiled, _ = measured(lambda: loop_numba.study(*arguments, 1, plain, *rest))
    best = min(measured(lambda: loop_numba.study(*arguments, runs, plain, *rest)) for _ in range(repeats(runs)))
    return compiled, *best


def plain(runs: int, every: int) -> tuple[float, float, float]:
    """What the NumPy loop takes, one process on one core."""
    from benchmarks.peers import loop_numpy

    _, _, a = problem()
    rng = np.random.default_rng(0)

    def study() -> None:
        for _ in range(runs):
            z = rng.standard_normal((len(a["dtheta"]), 6))
            dtheta = a["dtheta"] + a["biases"][0] + a["sds"][0] * z[:, :3]
            dvel = a["dvel"] + a["biases"][1] + a["sds"][1] * z[:, 3:]
            velocity = a["velocity"] + a["sds"][2] * rng.standard_normal(a["velocity"].shape)
            loop_numpy.align(dtheta, dvel, velocity, a["dt"], a["samples"], every, a["lat"], a["h"])

    return 0.0, *measured(study)


WAYS: dict[str, Callable[[int, int], tuple[float, float, float]]] = {
    "jaxalign, increments": lambda runs, every: ours(runs, every, "increments"),
    "jaxalign, samples": lambda runs, every: ours(runs, every, "samples"),
    "numba loop": numba,
    "numba loop, numba's own normals": lambda runs, every: numba(runs, every, True),
    "NumPy loop": plain,
}


def one(way: str, runs: int, every: int) -> None:
    """Measure in this process and print: compile s, wall s, CPU s, peak memory GB."""
    found = WAYS[way](runs, every)
    print(*found, peak_gb())


def main() -> None:
    """Measure each in a process of its own and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent.parent / "peers.md")
    parser.add_argument("--most", type=int, default=10_000, help="most runs (default: 10000)")
    parser.add_argument("--one", nargs=3, metavar=("WAY", "RUNS", "EVERY"), help="measure one, in this process")
    options = parser.parse_args()
    from jaxalign.study.devices import use_all_cores

    jax.config.update("jax_enable_x64", True)
    use_all_cores()
    if options.one:
        one(options.one[0], int(options.one[1]), int(options.one[2]))
        return
    from benchmarks.machine import machine

    apart = agreement()
    lines = [
        "# A study and its peers",
        "",
        f"Written by `python -m benchmarks.peers` on {machine()}.",
        "",
        "`oba` on dvl-sturn (300 s, IMU 200 Hz, aid 1 Hz), clean: the same truth, noise and algorithm (two-sample "
        "coning,",
        "closed Coriolis term, transport rate). On the same noise the attitudes after 300 s differ from ours by "
        + ", ".join(f"{angle:.0e} rad ({name})" for name, angle in apart.items())
        + ".",
        "Ours and numba use all cores, the NumPy loop one. Smallest of three calls (one run: of twenty; 10000 runs:",
        "one call); compile time is apart. Ours of one",
        "run is a study of two, the least there is, with its statistics. The numba loop",
        "draws its normals by a ziggurat written for it (`ziggurat.py`), several times as fast as numba's own.",
        "Ours with the flag of XLA that the command line sets (`jaxalign.compilation`).",
        "",
        "| read-out | runs | what | compile s | wall ms per run | CPU ms per run | runs/s | numba's wall over it "
        "| numba's CPU over it | GB |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for every in EVERY:
        for runs in [r for r in RUNS if r <= options.most]:
            rows = {}
            for way in WAYS:
                slow = way == "NumPy loop" and runs > 1
                if slow or (every == 1 and way in ("jaxalign, samples", "numba loop, numba's own normals")):
                    continue
                command = [sys.executable, "-m", "benchmarks.peers", "--one", way, str(runs), str(every)]
                text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
                rows[way] = [float(x) for x in text.split()]
                print(way, runs, every, text.strip(), flush=True)
            for way, (compiled, wall, cpu, memory) in rows.items():
                cells = [f"every {every}" if every > 1 else "each epoch", str(runs), way, f"{compiled:.1f}"]
                cells += [f"{1e3 * wall / runs:.3g}", f"{1e3 * cpu / runs:.3g}", f"{runs / wall:.3g}"]
                numba_wall, numba_cpu = rows["numba loop"][1:3]
                cells += [f"{numba_wall / wall:.3g}", f"{numba_cpu / cpu:.3g}", f"{memory:.2f}"]
                lines.append("| " + " | ".join(cells) + " |")
    options.output.write_text("\n".join([*lines, ""]))
    print(f"wrote {options.output}")


if __name__ == "__main__":
    main()
