"""`python -m benchmarks.robust_map`: the batch estimator over many runs at once, beside recursions; into robust_map.md.

Compile time (tracing and XLA) apart from run time; all in one process. Run on an idle machine.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)

from benchmarks.machine import machine  # noqa: E402
from jaxalign import epochs_from_log  # noqa: E402
from jaxalign.aids import NavVelocity  # noqa: E402
from jaxalign.batch import RobustMap  # noqa: E402
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors  # noqa: E402
from jaxalign.methods import build  # noqa: E402
from jaxalign.metrics import attitude_error_deg  # noqa: E402
from jaxalign.simulate import intervals_of, measure_epochs, scenario, simulate, truth  # noqa: E402
from jaxalign.tune.objective import taken  # noqa: E402

RUNS, READOUTS = 1000, 5
SCENARIO = "dvl-sturn"
OTHERS = ("oba", "centred_oba", "revising_oba")
GRADIENTS = 100
OF_THE_AID = ("scale", "mounting", "slow")


def timed(call: Callable[[], Any], times: int = 2) -> tuple[float, float]:
    """Seconds of the first call, and the smallest of some more."""
    seconds = []
    for _ in range(1 + times):
        start = time.perf_counter()
        jax.block_until_ready(call())
        seconds.append(time.perf_counter() - start)
    return seconds[0], min(seconds[1:])


def one_log(label: str, method: RobustMap, made: Any) -> str:
    """A row: one attitude of one simulated log, at its end."""
    log = simulate(made, seed=1)
    epochs = epochs_from_log(log)
    last = np.array([len(epochs) - 1])
    first, run = timed(lambda: method.solve(epochs, last), 5)
    found = method.solve(epochs, last)
    error, sd, record = attitude_error_deg(found, log), found.sd, found.filter
    assert error is not None
    assert sd is not None
    assert record is not None
    states, sd = record.covariance.shape[-1], np.rad2deg(sd[-1, 2])
    cells = label, len(epochs), states, f"{first - run:.1f}", f"{1e3 * run:.0f}", f"{error[-1, 2]:.2f}", f"{sd:.2f}"
    return f"| {' | '.join(map(str, cells))} |"


def logs() -> list[str]:
    """One log at a time: the usual, many states, biases that an uncalibrated low-cost unit has, and two hours."""
    made = scenario(SCENARIO, outliers="fixed")
    usual = RobustMap(imu=made.imu)
    wild = scenario("gps-zigzag")
    gyro = dataclasses.replace(wild.imu.gyro, bias_deg_h=[7000.0, -4000.0, 5000.0])
    accel = dataclasses.replace(wild.imu.accel, bias_ug=[5000.0, 2000.0, -5000.0])
    wild = dataclasses.replace(wild, imu=ImuErrors(gyro, accel))
    poor = ImuErrors(GyroErrors(7000.0, 0.3), AccelErrors(2e4, 200.0))
    rows = [
        ("as above", usual, made),
        ("scale, misalignment and a slow error of the aid", RobustMap(imu=usual.imu, calibrate=OF_THE_AID), made),
        (
            "GNSS; gyroscope biases 4000 to 7000 deg/h, 8 starts",
            RobustMap(imu=poor, aids=(NavVelocity(),), headings=8),
            wild,
        ),
        ("two hours", usual, scenario(SCENARIO, outliers="fixed", duration=7200.0)),
    ]
    lines = [
        "",
        "One log, one attitude at its end; smallest of 5 calls. Error and standard deviation of the heading.",
        "",
        "| | epochs | states | compile s | ms | error deg | sd deg |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        lines.append(one_log(*row))
        print(lines[-1], flush=True)
    return lines


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "robust_map.md")
    parser.add_argument("--runs", type=int, default=RUNS)
    options = parser.parse_args()
    made = scenario(SCENARIO, outliers="fixed")
    intervals = intervals_of(truth(made), made.epoch_samples)
    devices = jax.devices()
    runs = options.runs // len(devices) * len(devices)
    keys = jax.random.split(jax.random.key(0), runs)
    epochs = jax.block_until_ready(jax.jit(lambda keys: measure_epochs(intervals, made, keys))(keys))
    every = made.epochs // READOUTS
    robust = RobustMap(imu=made.imu)

    def solver(method: Any, count: int) -> Callable[[], Any]:
        share = runs // count
        parts = [
            jax.device_put(taken(epochs, np.arange(i * share, (i + 1) * share)), device)
            for i, device in enumerate(devices[:count])
        ]
        whole = jax.jit(lambda part: method.solve_runs(part, every).q_nb)

        def together() -> Any:
            with ThreadPoolExecutor(count) as pool:
                return list(pool.map(lambda part: jax.block_until_ready(whole(part)), parts))

        return together

    lines = [
        "# The batch estimator",
        "",
        f"Written by `python -m benchmarks.robust_map` on {machine()}.",
        "",
        f"{runs} runs of {SCENARIO} ({made.epochs} epochs, 2 % outliers) in one call, read out at 0, {every}, ... "
        f"{made.epochs}: {READOUTS} attitudes each and the start. Smallest of 2 calls.",
        "",
        "| method | cores | compile s | run s | ms per run | over oba |",
        "|---|---|---|---|---|---|",
    ]
    base: dict[int, float] = {}
    for label, method in {**{name: build(name, "body") for name in OTHERS}, "robust_map": robust}.items():
        for count in sorted({1, len(devices)}):
            first, run = timed(solver(method, count))
            base.setdefault(count, run)
            cells = f"{first - run:.1f} | {run:.2f} | {1e3 * run / runs:.2f} | {run / base[count]:.1f}"
            lines.append(f"| {label} | {count} | {cells} |")
            print(lines[-1], flush=True)

    few = taken(epochs, np.arange(GRADIENTS))
    direction = jnp.array([0.3, -0.5, 1.0])

    def loss(numbers: Any) -> Any:
        imu = ImuErrors(GyroErrors(numbers[0], numbers[1]), AccelErrors(numbers[2], numbers[3]))
        found = RobustMap(imu=imu).solve_runs(few, np.array([made.epochs]))
        return jnp.sum((found.q_nb[:, 0, 1:] @ direction) ** 2)

    gyro, accel = robust.imu.gyro, robust.imu.accel
    numbers = jnp.stack([gyro.bias_deg_h, gyro.walk_deg_sqrt_h, accel.bias_ug, accel.density_ug_sqrt_hz])
    value, slope = jax.jit(loss), jax.jit(jax.grad(loss))
    (_, plain), (first, reverse) = timed(lambda: value(numbers)), timed(lambda: slope(numbers))
    finite = bool(jnp.all(jnp.isfinite(slope(numbers))))
    lines += [
        "",
        f"Reverse mode, {GRADIENTS} runs, one attitude at the end, by the four figures of the inertial unit: "
        f"{1e3 * reverse / GRADIENTS:.0f} ms per run, {reverse / plain:.1f} times the value's "
        f"{1e3 * plain / GRADIENTS:.0f} (compile {first - reverse:.0f} s); all finite: {finite}.",
    ]
    print(lines[-1])
    lines += [*logs(), ""]
    options.output.write_text("\n".join(lines))
    print(f"wrote {options.output}")


if __name__ == "__main__":
    main()
