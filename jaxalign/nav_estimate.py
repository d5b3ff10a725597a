"""What an alignment hands on: the navigation state with its unknowns, and one joint covariance with named blocks."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.aids.base import STATE_VECTORS
from jaxalign.errors import UserError
from jaxalign.rotation import dcm_from_quat

__all__ = ["Block", "NavEstimate", "blocks_of"]

Block = tuple[str, int, int]
"""Name, first row and row after the last one of a part of the covariance."""
_SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # its own inverse, and a rotation


def blocks_of(**sizes: int) -> tuple[Block, ...]:
    """Blocks of so many rows each, one after the other."""
    out, end = [], 0
    for name, size in sizes.items():
        out.append((name, end, end + size))
        end += size
    return tuple(out)


class NavEstimate(eqx.Module):
    """Where the vehicle is, how it moves, what is known of its sensors, and how sure all that is.

    A pytree of the rows of a solution; ``jax.tree.map(lambda x: x[k], estimate)`` is one of them. Errors have one sign:
    the estimate is the truth moved by the error. So for attitude ``C_est = (I - [phi x]) C_true``, and for all else
    ``estimate = truth + error``. An error-state filter starts with this state and this covariance, its error zero.

    Attributes:
        time: (K,) of validity, s since epoch 0.
        q_nb: (K, 4) attitude.
        velocity: (K, 3) over the Earth, m/s, n.
        position: (K, 3) latitude (rad), longitude (rad), height (m) of the trajectory found.
        gyro_bias: (K, 3) rad/s, b.
        accel_bias: (K, 3) m/s^2, b.
        unknowns: (K, c) of the aids, SI, in the order of their blocks.
        covariance: (K, n, n) joint, SI: attitude (rad, n), velocity, gyro_bias, accel_bias, and what else there is.
        blocks: names of its parts with their rows (static).
        axes: "ENU/RFU": n is East-North-Up, b right-forward-up; or "NED/FRD" (static).
        attitude_error: in the axes "n", or "b": ``C_est = C_true (I - [theta x])``, ``theta = C_bn phi`` (static).
    """

    time: Float[Array, "*K"]
    q_nb: Float[Array, "*K 4"]
    velocity: Float[Array, "*K 3"]
    position: Float[Array, "*K 3"]
    gyro_bias: Float[Array, "*K 3"]
    accel_bias: Float[Array, "*K 3"]
    unknowns: Float[Array, "*K c"]
    covariance: Float[Array, "*K n n"]
    blocks: tuple[Block, ...] = eqx.field(static=True)
    axes: Literal["ENU/RFU", "NED/FRD"] = eqx.field(static=True, default="ENU/RFU")
    attitude_error: Literal["n", "b"] = eqx.field(static=True, default="n")

    def rows_of(self, name: str) -> slice:
        """The rows of a block.

        Raises:
            UserError: there is none of that name.
        """
        for known, start, stop in self.blocks:
            if known == name:
                return slice(start, stop)
        raise UserError(f"no block {name!r} in this covariance: there is {', '.join(name for name, *_ in self.blocks)}")

    def block(self, *names: str) -> Float[Array, "*K m m"]:
        """The joint covariance of some parts, in this order.

        Raises:
            UserError: there is none of a name.
        """
        index = np.concatenate([np.arange(self.covariance.shape[-1])[self.rows_of(name)] for name in names])
        return self.covariance[..., index[:, None], index]

    def sd(self, name: str) -> Float[Array, "*K m"]:
        """Standard deviations of a part."""
        return jnp.sqrt(jnp.diagonal(self.block(name), axis1=-2, axis2=-1))

    def in_ned(self) -> NavEstimate:
        """The estimate with n North-East-Down and b forward-right-down; unknowns of the aids stay as they are."""
        if self.axes == "NED/FRD":
            return self
        turned = {name: self._turned(getattr(self, name)) for name in ("velocity", "gyro_bias", "accel_bias")}
        w, x, y, z = (self.q_nb[..., i] for i in range(4))
        moved = dataclasses.replace(self, **turned, q_nb=jnp.stack([w, y, x, -z], axis=-1), axes="NED/FRD")
        return moved._with_errors({name: _SWAP for name, *_ in self.blocks if name in STATE_VECTORS})

    def with_body_errors(self) -> NavEstimate:
        """The estimate with the attitude error in b, as many error-state filters and factors have it."""
        if self.attitude_error == "b":
            return self
        c_bn = jnp.swapaxes(dcm_from_quat(self.q_nb), -1, -2)
        return dataclasses.replace(self, attitude_error="b")._with_errors({"attitude": c_bn})

    @staticmethod
    def _turned(v: Any) -> Any:
        return jnp.stack([v[..., 1], v[..., 0], -v[..., 2]], axis=-1)

    def _with_errors(self, matrices: dict[str, Any]) -> NavEstimate:
        """With blocks of three multiplied from both sides."""
        n = self.covariance.shape[-1]
        whole = jnp.broadcast_to(jnp.eye(n), (*self.covariance.shape[:-2], n, n))
        for name, matrix in matrices.items():
            rows = self.rows_of(name)
            whole = whole.at[..., rows, rows].set(matrix)
        return dataclasses.replace(self, covariance=whole @ self.covariance @ jnp.swapaxes(whole, -1, -2))
