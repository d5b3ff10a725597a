"""`python -m benchmarks.prefilter`: the filters of records on one core; into prefilter.md.

Compile time apart from run time; ratios in one run against scipy's banded Cholesky, which solves the same normal
equations and loses half of the digits. Run on an idle machine.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # before JAX starts its threads

import jax
import numpy as np
from scipy.linalg import solveh_banded

jax.config.update("jax_enable_x64", True)

from benchmarks.machine import best_ms, machine  # noqa: E402
from jaxalign.prefilter import Fir, Vondrak, Wavelet, filtered_force, theta_from_cutoff  # noqa: E402

DT, CUTOFF, SAMPLES = 0.005, 0.5, 60_000


def smooth(x: Any, cutoff: Any = CUTOFF) -> Any:
    """Vondrak's filter."""
    return Vondrak(cutoff=cutoff)(x, DT)


def record(samples: int, records: int | None = None) -> np.ndarray:
    """White noise about gravity, (records,) samples, 3."""
    shape = (samples, 3) if records is None else (records, samples, 3)
    return 9.8 + 0.1 * np.random.default_rng(0).normal(size=shape)


def compiled(function: Any, *arguments: Any) -> tuple[Any, float, float]:
    """Program, seconds to trace and compile, MB of temporary memory."""
    start = time.perf_counter()
    program = jax.jit(function).lower(*arguments).compile()
    spent = time.perf_counter() - start
    memory = program.memory_analysis()
    assert memory is not None
    return program, spent, memory.temp_size_in_bytes / 1e6


def cholesky(x: np.ndarray) -> np.ndarray:
    """Smooth by scipy: normal matrix and its banded Cholesky factor."""
    n, third = len(x), np.array([-1.0, 3.0, -3.0, 1.0])
    band = np.zeros((4, n))
    for j in range(4):
        for i in range(4 - j):
            band[j, i : i + n - 3] += third[i] * third[i + j]
    band *= 1.0 / (float(theta_from_cutoff(CUTOFF)) * DT**6)
    band[0] += 1.0
    return solveh_banded(band, x, lower=True)


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "prefilter.md")
    options = parser.parse_args()
    x, small = record(SAMPLES), record(SAMPLES) * 1e-5
    lines = [
        "# Filters of records",
        "",
        f"Written by `python -m benchmarks.prefilter` on one core of {machine()}.",
        "",
        f"{SAMPLES} samples x 3 axes at {1 / DT:g} Hz, cut-off {CUTOFF:g} Hz; smallest of 10 calls (median"
        " in brackets).",
        "",
        "| filter | compile s | run ms | temporary memory MB |",
        "|---|---|---|---|",
    ]
    programs = {
        "Vondrak": (smooth, (x,)),
        "Vondrak, with its gradient (data, cut-off)": (
            jax.grad(lambda x, c: (smooth(x, c) ** 2).sum(), (0, 1)),
            (x, CUTOFF),
        ),
        "Vondrak, force in inertial space": (lambda a, x: filtered_force(Vondrak(), a, x, DT), (small, x)),
        "FIR cascade": (lambda x: Fir()(x, DT), (x,)),
        "wavelet (PyWavelets, host)": (lambda x: Wavelet()(x, DT), (x,)),
    }
    alone = float("nan")
    for name, (function, arguments) in programs.items():
        program, spent, memory = compiled(function, *arguments)
        low, median = best_ms(lambda program=program, arguments=arguments: program(*arguments), 10)
        alone = low if name == "Vondrak" else alone
        lines.append(f"| {name} | {spent:.2f} | {low:.1f} ({median:.1f}) | {memory:.1f} |")
    low, median = best_ms(lambda: cholesky(x), 10)
    lines.append(f"| scipy banded Cholesky, the same normal equations | | {low:.1f} ({median:.1f}) | |")
    exact = np.asarray(jax.jit(smooth)(x))
    lines += [
        "",
        f"Vondrak takes {alone / low:.1f} times as long as the banded Cholesky, which differs from it by up to "
        f"{np.abs(cholesky(x) - exact).max():.1e} m/s^2 (rounding of the Cholesky factor).",
        "",
        "Vondrak over the length of the record and the number of records (one program, vmapped):",
        "",
        "| records | samples | run ms | ns per value | temporary memory MB |",
        "|---|---|---|---|---|",
    ]
    for records, samples in ((1, 15_000), (1, 60_000), (1, 240_000), (10, 60_000), (100, 60_000)):
        some = record(samples, records)
        program, _, memory = compiled(jax.vmap(smooth), some)
        low, _ = best_ms(lambda program=program, some=some: program(some), 5)
        lines.append(f"| {records} | {samples} | {low:.1f} | {1e6 * low / some.size:.0f} | {memory:.1f} |")
    options.output.write_text("\n".join([*lines, ""]))
    print("\n".join(lines))
    print(f"wrote {options.output}")


if __name__ == "__main__":
    main()
