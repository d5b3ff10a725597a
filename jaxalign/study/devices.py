"""Blocks of runs over devices, processes and hosts, on JAX's own engine."""

from __future__ import annotations

import os
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from jaxalign.errors import UserError

__all__ = ["agreed", "gathered", "is_first", "join", "mesh", "numbers", "replicated"]

_AXIS = "blocks"


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
    if coordinator is not None and not coordinator.rpartition(":")[2].isdigit():
        raise UserError(f"distributed: coordinator {coordinator!r}: write it as host:port")
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    try:
        jax.distributed.initialize(coordinator, processes, rank, initialization_timeout=120)
    except (RuntimeError, ValueError) as error:
        raise UserError(f"distributed: the processes did not come together: {str(error).splitlines()[0]}") from None


def use_all_cores() -> None:
    """Let the cores of a CPU be devices of one thread's work each; before anything else of JAX runs.

    Without effect where a platform or a number of devices has been chosen.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if getattr(jax.config, "jax_num_cpu_devices", 0) < 1 and "host_platform_device_count" not in os.environ.get(
        "XLA_FLAGS", ""
    ):
        jax.config.update("jax_num_cpu_devices", cores)


def mesh() -> Mesh:
    """All devices of all processes, in a row."""
    return jax.make_mesh((jax.device_count(),), (_AXIS,), axis_types=(AxisType.Auto,))


def is_first() -> bool:
    """Whether this process speaks and writes."""
    return jax.process_index() == 0


def replicated(tree: Any, over: Mesh) -> Any:
    """The same arrays on every device."""
    sharding = NamedSharding(over, PartitionSpec())

    def put(x: Any) -> Any:
        if not isinstance(x, jax.Array | np.ndarray | np.generic):
            return x
        if jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
            return jax.random.wrap_key_data(put(jax.random.key_data(jnp.asarray(x))))
        return jax.device_put(np.asarray(x), sharding)

    return jax.tree.map(put, tree)


def numbers(first: int, block: int, over: Mesh) -> jax.Array:
    """(devices, block) numbers of the runs from `first` on, a block on each device."""
    shape = over.size, block
    every = first + np.arange(over.size * block).reshape(shape)
    return jax.make_array_from_callback(shape, NamedSharding(over, PartitionSpec(_AXIS)), lambda index: every[index])


def gathered(tree: Any) -> Any:
    """Arrays of all processes on this host, as NumPy, their first axis in the order of the blocks."""
    if jax.process_count() == 1:
        return jax.tree.map(np.asarray, tree)
    return jax.tree.map(np.asarray, multihost_utils.process_allgather(tree, tiled=True))


def agreed(value: np.ndarray) -> np.ndarray:
    """What process 0 has, in every process."""
    if jax.process_count() == 1:
        return value
    return np.asarray(multihost_utils.broadcast_one_to_all(value))
