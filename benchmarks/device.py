"""`python -m benchmarks.device`: all that a GPU can tell, in one call of at most five minutes, into device.md.

The same answers as the CPU, throughput and memory of studies, the batch estimator over more and more runs, compile
times. Each row is printed and written when it is there; a row that would not end in time is left out, and after the
last second the program ends with what it has. Without a GPU a small form runs on the CPU, and nothing is written.
"""

from __future__ import annotations

import argparse
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.machine import machine

LIMIT_S = 290.0
SCENARIO = "dvl-sturn"
AGREE_DEG = 1e-9


class Sizes(NamedTuple):
    """How much is asked for."""

    same: tuple[str, ...]  # methods compared with the CPU
    runs: tuple[int, ...]  # of `oba`
    methods: tuple[str, ...]
    method_runs: int
    sampled: int  # runs at sample fidelity
    batch: tuple[int, ...]  # runs of robust_map side by side


GPU = Sizes(
    same=("oba", "rkf_oba", "moba", "robust_map"),
    runs=(1000, 10_000, 100_000, 1_000_000),
    methods=("roba", "rkf_oba", "moba", "request"),
    method_runs=100_000,
    sampled=2000,
    batch=(64, 512, 4096, 16_384),
)
QUICK = Sizes(("oba",), (1000, 4000), ("roba",), 1000, 100, (8,))


class Clock:
    """Seconds since the start, and whether a row still fits.

    Args:
        limit: seconds for all.
    """

    def __init__(self, limit: float):
        self.start, self.limit = time.monotonic(), limit

    @property
    def left(self) -> float:
        """Seconds until the limit."""
        return self.limit - (time.monotonic() - self.start)

    def fits(self, seconds: float) -> bool:
        """Whether a row that takes so long still ends in time."""
        return seconds < self.left


class Page:
    """The lines of device.md: printed as they come, and written, if there is a place for them."""

    def __init__(self, path: Path | None):
        self.path, self.lines = path, []

    def add(self, *lines: str) -> None:
        """Some more."""
        self.lines += lines
        print(*lines, sep="\n", flush=True)
        if self.path is not None:
            self.path.write_text("\n".join([*self.lines, ""]))


def timed(call: Callable[[], Any]) -> tuple[float, float]:
    """Seconds to compile, and of a second call."""
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        jax.block_until_ready(call())
        seconds.append(time.perf_counter() - start)
    return max(seconds[0] - seconds[1], 0.0), seconds[1]


def peak_gb(device: Any) -> float:
    """Most memory of the device that was in use so far, GB; NaN where it does not say."""
    return (device.memory_stats() or {}).get("peak_bytes_in_use", np.nan) / 1e9


def agreement(sizes: Sizes, device: Any, clock: Clock) -> Iterator[str]:
    """The same epochs aligned on the device and on the CPU, and the same runs drawn on both."""
    from jaxalign.methods import build
    from jaxalign.simulate import intervals_of, measure_epochs, scenario, truth
    from jaxalign.study.devices import placed

    cpu = jax.devices("cpu")[0]
    yield from ("## The same as on the CPU", "", "| what | largest difference | compile s |", "|---|---|---|")
    with jax.default_device(cpu):
        made = scenario(SCENARIO, outliers="fixed")
        intervals, keys = intervals_of(truth(made), made.epoch_samples), jax.random.split(jax.random.key(0), 16)
    draw = jax.jit(jax.vmap(measure_epochs, (None, None, 0)))
    arguments = (intervals, made, keys)
    one, two = draw(*placed(arguments, cpu)), draw(*placed(arguments, device))
    apart = max(
        float(np.max(abs(np.asarray(a) - np.asarray(b)))) for a, b in zip(_floats(one), _floats(two), strict=True)
    )
    yield f"| epochs of 16 runs, m/s and 1 | {apart:.1e} | - |"
    for name in sizes.same:
        if not clock.fits(60):
            yield f"| {name} | no time left | |"
            continue
        method = build(name, "body")
        solve = jax.jit(jax.vmap(lambda e, method=method: method.solve(e, made.epochs // 2).q_nb))
        here = np.asarray(solve(placed(one, cpu)))
        on_device = placed(one, device)
        compiled, _ = timed(lambda solve=solve, on_device=on_device: solve(on_device))
        there = np.asarray(solve(on_device))
        degrees = np.rad2deg(2 * np.max(np.minimum(abs(here - there), abs(here + there))))
        verdict = "" if degrees <= AGREE_DEG else f" **more than {AGREE_DEG:g}**"
        yield f"| {name}, deg | {degrees:.1e}{verdict} | {compiled:.1f} |"
    yield ""


def _floats(tree: Any) -> list[Any]:
    return [x for x in jax.tree.leaves(tree) if jnp.issubdtype(x.dtype, jnp.floating)]


def studies(sizes: Sizes, device: Any, clock: Clock) -> Iterator[str]:
    """Throughput by runs, then by method, then with the noise per sample."""
    from jaxalign.study import Study, run

    yield from ("## Studies", "", "| method | noise | runs | block | compile s | run s | runs/s | peak GB |")
    yield "|---|---|---|---|---|---|---|---|"
    rows = [("oba", "increments", n) for n in sizes.runs]
    rows += [(name, "increments", sizes.method_runs) for name in sizes.methods]
    rows += [("oba", "samples", sizes.sampled)]
    rate, compile_s = 1e3, 20.0
    for name, noise, runs in rows:
        study = Study(SCENARIO, [name], runs, fidelity=noise)  # pyright: ignore[reportArgumentType]
        if not clock.fits(1.5 * compile_s + 2 * runs / rate):
            yield f"| {name} | {noise} | {runs} | no time left | | | | |"
            continue
        compiled, wall = timed(lambda study=study: run(study))
        compile_s = max(compile_s, compiled)
        if name == "oba" and noise == "increments":
            rate = max(rate, runs / wall)
        yield (
            f"| {name} | {noise} | {runs} | {study.block} | {compiled:.1f} | {wall:.2f} | {runs / wall:.3g} | "
            f"{peak_gb(device):.2f} |"
        )
    yield ""


def batch(sizes: Sizes, device: Any, clock: Clock) -> Iterator[str]:
    """`robust_map` over more and more runs at once: two attitudes each."""
    from jaxalign.batch import RobustMap
    from jaxalign.simulate import intervals_of, measure_epochs, scenario, truth

    yield from (
        "## robust_map",
        "",
        "| runs at once | compile s | run s | ms per attitude | peak GB |",
        "|---|---|---|---|---|",
    )
    made = scenario(SCENARIO, outliers="fixed")
    method, intervals = RobustMap(imu=made.imu), intervals_of(truth(made), made.epoch_samples)
    solve = jax.jit(jax.vmap(lambda e: method.solve(e, made.epochs).q_nb))
    draw = jax.jit(jax.vmap(lambda key: measure_epochs(intervals, made, key)))
    compile_s, each = 30.0, 0.0
    for runs in sizes.batch:
        if not clock.fits(1.5 * compile_s + 2 * runs * each):
            yield f"| {runs} | no time left | | | |"
            continue
        epochs = jax.block_until_ready(draw(jax.random.split(jax.random.key(1), runs)))
        compiled, wall = timed(lambda epochs=epochs: solve(epochs))
        compile_s, each = max(compile_s, compiled), wall / runs
        yield f"| {runs} | {compiled:.1f} | {wall:.2f} | {1e3 * wall / runs / 2:.3g} | {peak_gb(device):.2f} |"
    yield ""


def measured(sizes: Sizes, device: Any, clock: Clock, page: Page) -> None:
    """All of it; what does not work is said, and the next thing done."""
    for section in (agreement, studies, batch):
        try:
            for line in section(sizes, device, clock):
                page.add(line)
        except Exception as error:  # no device time is worth losing for one of the three
            page.add("", f"Ended by {type(error).__name__}: {str(error)[:300]}", "")
    page.add(f"All in {clock.limit - clock.left:.0f} s.")


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "device.md")
    parser.add_argument("--quick", action="store_true", help="a small form, on any device; nothing is written")
    parser.add_argument("--seconds", type=float, default=LIMIT_S, help=f"for all of it (default: {LIMIT_S:g})")
    options = parser.parse_args()
    clock = Clock(options.seconds)
    jax.config.update("jax_enable_x64", True)
    device = jax.devices()[0]
    quick = options.quick or device.platform == "cpu"
    if device.platform == "cpu":
        print("no GPU here: the quick form on the CPU; nothing is written")
    page = Page(None if quick else options.output)

    def end() -> None:  # also inside a compilation, which nothing else interrupts
        page.add("", f"Ended after {clock.limit:.0f} s: the rest is missing.")
        os._exit(0)

    alarm = threading.Timer(clock.left, end)
    alarm.daemon = True
    alarm.start()
    page.add("# On a device", "", f"Written by `python -m benchmarks.device` on {machine()}.", "")
    measured(QUICK if quick else GPU, device, clock, page)
    alarm.cancel()
    print("nothing is written" if page.path is None else f"wrote {page.path}")


if __name__ == "__main__":
    main()
