"""What the numbers were measured on, and how to measure."""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from jaxalign.compilation import configure

__all__ = ["best_ms", "machine", "peak_gb"]

configure(cache=False)  # loops as the command line has them, but programs compiled anew: some measure that


def machine() -> str:
    """One line: processor, cores, versions."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    flags = ""
    if cpuinfo.exists():
        lines = dict(line.split(":", 1) for line in cpuinfo.read_text().splitlines() if ":" in line)
        fields = {key.strip(): value.strip() for key, value in lines.items()}
        model = fields.get("model name", model)
        flags = ", AVX-512" if "avx512f" in fields.get("flags", "") else ""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    device = jax.devices()[0].device_kind
    return f"{model}{flags}, {cores} cores; device {device}; Python {platform.python_version()}, JAX {jax.__version__}"


def peak_gb() -> float:
    """Peak memory of this process in GB (since its program began, which `ru_maxrss` does not say)."""
    status = Path("/proc/self/status")
    if not status.exists():
        return float("nan")
    return next(int(line.split()[1]) / 1e6 for line in status.read_text().splitlines() if line.startswith("VmHWM"))


def best_ms(function: Callable[[], Any], repeats: int = 30) -> tuple[float, float]:
    """Smallest and median wall time of a call in ms, results waited for (the first call is not counted)."""
    jax.block_until_ready(function())
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function())
        times.append(1e3 * (time.perf_counter() - start))
    return min(times), statistics.median(times)
