"""Flags for XLA, beside those that the user has set."""

from __future__ import annotations

import os

__all__ = ["add_fast_loops", "add_quick_compilation"]

_FLAG = "--xla_backend_extra_options="
_LOOPS = "xla_cpu_small_while_loop_byte_threshold"
_BYTES = 100_000_000
_QUICK = ("--xla_cpu_use_fusion_emitters=false", "--xla_cpu_parallel_codegen_split_count=1")
# First and last version of jaxlib that was tried: XLA aborts on a flag that it does not know.
_KNOWN = ((0, 8), (0, 10))


def add_fast_loops() -> None:
    """Have XLA turn a loop over less than 100 MB into one call on a CPU: a scan over epochs then costs a sixth.

    It goes into ``XLA_FLAGS``, which XLA reads when it starts. A value that is there stays. XLA aborts on a flag that
    it does not know; this one has always been there, and what follows it and begins with ``xla_`` is ignored where it
    means nothing.
    """
    given = os.environ.get("XLA_FLAGS", "").split()
    if any(_LOOPS in flag for flag in given):
        return
    option = f"{_LOOPS}={_BYTES}"
    # The last of two such flags counts: theirs and ours are one.
    last = max((i for i, flag in enumerate(given) if flag.startswith(_FLAG)), default=None)
    if last is None:
        given.append(_FLAG + option)
    else:
        given[last] = f"{given[last]},{option}"
    os.environ["XLA_FLAGS"] = " ".join(given)


def add_quick_compilation(jaxlib: str) -> None:
    """Have XLA compile for a CPU in some two thirds of the time, to code as fast. A flag that is there stays.

    Args:
        jaxlib: its version.
    """
    if not _KNOWN[0] <= tuple(int(x) for x in jaxlib.split(".")[:2]) <= _KNOWN[1]:
        return
    given = os.environ.get("XLA_FLAGS", "").split()
    names = {flag.partition("=")[0] for flag in given}
    given += [flag for flag in _QUICK if flag.partition("=")[0] not in names]
    os.environ["XLA_FLAGS"] = " ".join(given)
