"""The result of an alignment."""

from __future__ import annotations

from enum import IntFlag
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from jaxalign.errors import UserError
from jaxalign.host import dcm_from_quat, euler_covariance, euler_from_quat, heading_deg
from jaxalign.vector import root

__all__ = ["FilterRecord", "Solution", "Status", "check_threshold", "status_bits"]


class Status(IntFlag):
    """Bits of ``Solution.status``; 0 means that all is well."""

    UNDEFINED = 1
    """No unique attitude yet: fewer than two directions so far."""
    HEADING_UNOBSERVABLE = 2
    """The directions have not opened beyond the noise of the aid: the heading means little."""
    AID_MISSING = 4
    """No aid sample at this epoch: the attitude is that of the samples before it."""
    NON_FINITE = 8
    """The sums hold a NaN or an infinity; nothing after this epoch is to be used."""
    UNUSED = 16
    """The aid has a sample here, but no vector came of it, or its weight is zero."""
    SINGULAR = 32
    """The filter's innovation covariance was singular at some epoch: from there on it takes no vectors."""
    INDICATIVE = 64
    """The covariance leaves something out that matters here: take it as a hint."""


def status_bits(*, defined: Any, observable: Any, aided: Any, finite: Any, unused: Any = False, xp: Any = jnp) -> Any:
    """``Solution.status`` of rows.

    Args:
        defined: whether there is an attitude.
        observable: whether the heading means something.
        aided: whether the aid has a sample at this epoch.
        finite: whether all numbers are.
        unused: whether the aid has a sample, but nothing came of it.
        xp: jax.numpy, or numpy on the host.
    """
    bits = (
        (~defined, Status.UNDEFINED),
        (~observable, Status.HEADING_UNOBSERVABLE),
        (~aided, Status.AID_MISSING),
        (~finite, Status.NON_FINITE),
        (unused, Status.UNUSED),
    )
    return sum((xp.where(is_set, xp.int32(bit), xp.int32(0)) for is_set, bit in bits), xp.int32(0))


def check_threshold(heading_sd_deg: float) -> None:
    """Refuse a standard deviation (deg) that no heading falls below.

    Raises:
        UserError: it is not above zero.
    """
    if not heading_sd_deg > 0:
        raise UserError(f"the heading's standard deviation cannot fall below {heading_sd_deg} deg")


class FilterRecord(eqx.Module):
    """What a filter with an error model tells beside the attitude.

    Attributes:
        gyro_bias: (K, 3) rad/s, b.
        accel_bias: (K, 3) m/s^2, b.
        covariance: (K, n, n) of its error states, SI.
        innovation: (K, m) measured minus predicted at this epoch; zero where there was no update. None: no filter.
        innovation_covariance: (K, m, m), or None.
        updated: (K,) 1 where there was an update, else 0; or None.
        log_likelihood: (K,) of the measurements up to this epoch by the model, but for a constant; or None.
        calibration: (K, m) of the aid, as ``RobustMap.calibrate`` has it: scale factor, misalignment (rad, b), latency
            (s), lever arm (m, b); or None.
    """

    gyro_bias: Float[Array, "*K 3"]
    accel_bias: Float[Array, "*K 3"]
    covariance: Float[Array, "*K n n"]
    innovation: Float[Array, "*K m"] | None = None
    innovation_covariance: Float[Array, "*K m m"] | None = None
    updated: Float[Array, "*K"] | None = None
    log_likelihood: Float[Array, "*K"] | None = None
    calibration: Float[Array, "*K m"] | None = None


class Solution(eqx.Module):
    """Attitudes at the read-out epochs, and how far to trust them. A pytree; leaves may have leading batch axes.

    Inside traced code every number is finite: where there is no attitude yet, ``q_nb`` is the identity
    and ``defined`` is False, so that a masked loss has a clean gradient. The properties ``C_nb``, ``euler_deg``,
    ``heading_deg`` and :meth:`to_numpy` are for people, on the host: NaN where there is no attitude.

    Attributes:
        time: (K,) s since epoch 0.
        q_nb: (K, 4) attitude, scalar part >= 0.
        defined: (K,) whether the attitude is unique.
        observable: (K,) whether the directions have opened beyond the noise, so that the heading begins to mean
            something (some 20 deg rms where the flag turns, 40 deg in single runs); see
            :class:`jaxalign.spread.Spread`. It knows nothing of
            sensor biases or of a disturbance that is not white.
        eigengap: (K,) relative gap of the 4x4 problem (0 where the method has none); it measures aid noise early on.
        residual: (K, 3) ``alpha - C_n0b0 beta`` of the pair of this epoch with this attitude, m/s, in n0
            (``robust_map``: the noise of its fix).
        weight: (K,) of that pair; 0 where there is none (aid missing here or at the other end of a window).
        alpha: (K, 3) the vector in n0, m/s.
        beta: (K, 3) the vector in b0, m/s, after reconstruction.
        covariance: (K, 3, 3) of the attitude error in n (east, north, up), rad^2, where it is known; else None. What it
            rests on: the filter's model (``fine``), the sensor model (``robust_map``, :func:`jaxalign.assess`).
        status: (K,) bits, see :class:`Status`.
        aid_sd: (K,) the aid's noise that was assumed (``robust_map``: found), m/s.
        filter: biases, covariance and innovations of ``robust_map`` and ``fine``; else None.
    """

    time: Float[Array, "*K"]
    q_nb: Float[Array, "*K 4"]
    defined: Bool[Array, "*K"]
    observable: Bool[Array, "*K"]
    eigengap: Float[Array, "*K"]
    residual: Float[Array, "*K 3"]
    weight: Float[Array, "*K"]
    alpha: Float[Array, "*K 3"]
    beta: Float[Array, "*K 3"]
    covariance: Float[Array, "*K 3 3"] | None
    status: Int[Array, "*K"]
    aid_sd: Float[Array, "*K"]
    filter: FilterRecord | None = None

    def _masked(self, values: ArrayLike) -> np.ndarray:
        out = np.array(values)
        out[~np.asarray(self.defined)] = np.nan
        return out

    @property
    def sd(self) -> Float[Array, "*K 3"] | None:
        """(K, 3) standard deviations of the attitude error in n, rad; also inside traced code. Up: of the heading."""
        return None if self.covariance is None else root(jnp.diagonal(self.covariance, axis1=-2, axis2=-1))

    @property
    def euler_sd_deg(self) -> np.ndarray | None:
        """(K, 3) of pitch, roll and heading in degrees on the host, NaN where there is no attitude."""
        if self.covariance is None:
            return None
        variance = np.diagonal(euler_covariance(np.asarray(self.q_nb), np.asarray(self.covariance)), axis1=-2, axis2=-1)
        return self._masked(np.rad2deg(np.sqrt(variance)))

    def aligned(self, heading_sd_deg: float) -> np.ndarray:
        """(K,) on the host: whether the heading's standard deviation is below a threshold, from here on.

        Args:
            heading_sd_deg: the threshold, deg.

        Raises:
            UserError: it is not above zero, or the solution has no covariance.
        """
        check_threshold(heading_sd_deg)
        sd = self.euler_sd_deg
        if sd is None:
            raise UserError("this solution has no standard deviations: jaxalign.assess makes them")
        below = np.nan_to_num(sd[..., 2], nan=np.inf) < heading_sd_deg
        return np.flip(np.logical_and.accumulate(np.flip(below, axis=-1), axis=-1), axis=-1)

    @property
    def C_nb(self) -> np.ndarray:
        """(K, 3, 3) on the host, NaN where there is no attitude."""
        return self._masked(dcm_from_quat(np.asarray(self.q_nb)))

    @property
    def euler_deg(self) -> np.ndarray:
        """(K, 3) pitch, roll, yaw in degrees on the host, NaN where there is no attitude."""
        return self._masked(np.rad2deg(euler_from_quat(np.asarray(self.q_nb))))

    @property
    def heading_deg(self) -> np.ndarray:
        """(K,) clockwise from north, 0..360 deg, on the host, NaN where there is no attitude."""
        return self._masked(heading_deg(euler_from_quat(np.asarray(self.q_nb))[..., 2]))

    def to_numpy(self) -> dict[str, np.ndarray]:
        """Everything a file should hold, as NumPy arrays; NaN where there is no attitude yet."""
        out = {
            "t": np.round(np.asarray(self.time), 9),  # sums of intervals carry rounding that nobody wants to read
            "C_nb": self.C_nb,
            "q_nb": self._masked(self.q_nb),
            "euler_deg": self.euler_deg,
            "heading_deg": self.heading_deg,
            "observable": np.asarray(self.observable),
            "eigengap": np.asarray(self.eigengap),
            "residual": self._masked(self.residual),
            "weight": np.asarray(self.weight),
            "status": np.asarray(self.status),
            "aid_sd": np.asarray(self.aid_sd),
        }
        if self.covariance is not None:
            variance = np.diagonal(np.asarray(self.covariance), axis1=-2, axis2=-1)
            out["sd_deg"] = self._masked(np.rad2deg(np.sqrt(variance)))
            out["euler_sd_deg"] = self.euler_sd_deg
            out["attitude_covariance"] = self._masked(self.covariance)
        if self.filter is not None:
            out["gyro_bias"] = self._masked(self.filter.gyro_bias)
            out["accel_bias"] = self._masked(self.filter.accel_bias)
            out["covariance"] = self._masked(self.filter.covariance)
            for name in ("innovation", "innovation_covariance", "log_likelihood", "calibration"):
                if (values := getattr(self.filter, name)) is not None:
                    out[name] = self._masked(values)
        return out
