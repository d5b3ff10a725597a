"""Double precision, or a clear refusal."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from jaxalign.errors import UserError

__all__ = ["require_x64"]


def require_x64(*trees: Any) -> None:
    """Refuse float32: alignment senses 7e-5 rad/s, and float32 integration alone loses degrees of heading.

    Raises:
        UserError: if JAX runs in float32 or an array of the trees is float32; the message says how to mend it.
    """
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise UserError(
            "JAX runs in float32 here, in which alignment loses degrees of heading: call "
            'jax.config.update("jax_enable_x64", True) before building anything, or set JAX_ENABLE_X64=1'
        )
    for path, leaf in (item for tree in trees for item in jax.tree_util.tree_leaves_with_path(tree)):
        dtype = getattr(leaf, "dtype", None)
        if dtype is not None and jnp.issubdtype(dtype, jnp.floating) and dtype != jnp.float64:
            raise UserError(
                f"{jax.tree_util.keystr(path) or 'the input'} is {dtype}: alignment needs float64; enable x64 "
                '(jax.config.update("jax_enable_x64", True)) before building it and pass float64 arrays'
            )
