"""Blocks of runs over devices, processes and hosts.

Each device runs the program of one device on blocks of its own. One program partitioned over all of them (a mesh) would
be optimised otherwise than that of a single device, and its results differ in the last bits: measured 2e-10 deg.
"""

from __future__ import annotations

import os
import socket
import time
from contextlib import suppress
from typing import Any

import jax
import numpy as np
from jax.experimental import multihost_utils

from jaxalign.errors import UserError
from jaxalign.files import first_line

__all__ = ["agreed", "everyone", "is_first", "join", "placed", "use_all_cores"]

_PATIENCE_S = 120
_ARRAYS = (jax.Array, np.ndarray, np.generic)


def join(coordinator: str | None = None, processes: int | None = None, rank: int | None = None) -> None:
    """Become one of several processes of a study (`jax.distributed`); before anything else of JAX runs.

    Args:
        coordinator: "host:port" of process 0; None: from the cluster's environment (SLURM, Open MPI, ...).
        processes: how many there are.
        rank: which of them this is, from 0.

    Raises:
        UserError: some but not all of them given, nobody answers, or no cluster's environment.
    """
    given = [x is not None for x in (coordinator, processes, rank)]
    if any(given) and not all(given):
        raise UserError(
            "distributed: give the coordinator (host:port), the number of processes and the rank of this one; or none "
            "of them under SLURM"
        )
    if processes is not None and rank is not None and not 0 <= rank < processes:
        raise UserError(f"distributed: rank {rank} of {processes} processes: it must be from 0 to {processes - 1}")
    if coordinator is not None:
        host, _, port = coordinator.rpartition(":")
        if not host or not port.isdigit():
            raise UserError(f"distributed: coordinator {coordinator!r}: write it as host:port")
        if rank:
            _answers(host.strip("[]"), int(port))
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    try:
        jax.distributed.initialize(coordinator, processes, rank, initialization_timeout=_PATIENCE_S)
    except Exception as error:
        raise UserError(f"distributed: the processes did not come together: {first_line(error)}") from None
    if jax.device_count() != jax.process_count() * jax.local_device_count():
        raise UserError("distributed: all processes need the same number of devices (on a CPU, of cores they may use)")


def _answers(host: str, port: int) -> None:
    """Wait for process 0: JAX itself would end with a crash report."""
    end = time.monotonic() + _PATIENCE_S
    while True:
        try:
            socket.create_connection((host, port), timeout=5).close()
        except OSError as error:
            if time.monotonic() > end:
                raise UserError(f"distributed: nobody answers at {host}:{port} ({error}): start process 0") from None
            time.sleep(0.2)
        else:
            return


def use_all_cores() -> None:
    """Let the cores of a CPU be devices of one thread's work each.

    Without effect where a number of devices has been chosen, or JAX has run already.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if getattr(jax.config, "jax_num_cpu_devices", 0) < 1 and "host_platform_device_count" not in os.environ.get(
        "XLA_FLAGS", ""
    ):
        with suppress(RuntimeError):
            jax.config.update("jax_num_cpu_devices", cores)


def is_first() -> bool:
    """Whether this process speaks and writes."""
    return jax.process_index() == 0


def placed(tree: Any, device: Any) -> Any:
    """The arrays of a tree on a device, to stay there; those that do already as they are, for each copy takes its time.

    One that may yet go elsewhere is compiled for as another kind of argument: devices would not share a program.
    """
    there = {device}
    leaves, structure = jax.tree.flatten(tree)
    stays = [isinstance(x, jax.Array) and x.committed and x.devices() == there for x in leaves]
    moves = [isinstance(x, _ARRAYS) and not stay for x, stay in zip(leaves, stays, strict=True)]
    moved = iter(jax.device_put([x for x, yes in zip(leaves, moves, strict=True) if yes], device))
    return structure.unflatten(next(moved) if yes else x for x, yes in zip(leaves, moves, strict=True))


def agreed(value: np.ndarray) -> np.ndarray:
    """What process 0 has, in every process."""
    if jax.process_count() == 1:
        return value
    return _together(lambda: multihost_utils.broadcast_one_to_all(value))


def _together(collective: Any) -> np.ndarray:
    try:
        return np.asarray(collective())
    except Exception as error:
        raise UserError(f"distributed: another process has stopped, see its message ({first_line(error)})") from None


def everyone(tree: Any) -> list[Any]:
    """The arrays (NumPy) of each process, in every process: in one message, whose size is that of the tree alone."""
    if jax.process_count() == 1:
        return [tree]
    leaves, structure = jax.tree.flatten(tree)
    message = np.concatenate([np.ascontiguousarray(x).reshape(-1).view(np.uint8) for x in leaves])
    ends = np.cumsum([x.nbytes for x in leaves])
    out = []
    for received in _together(lambda: multihost_utils.process_allgather(message)):
        parts = np.split(received, ends[:-1])
        arrays = [part.copy().view(x.dtype).reshape(x.shape) for part, x in zip(parts, leaves, strict=True)]
        out.append(jax.tree.unflatten(structure, arrays))
    return out
