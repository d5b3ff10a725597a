"""The result of an alignment."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntFlag
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from jaxalign.errors import UserError
from jaxalign.host import dcm_from_quat, euler_covariance, euler_from_quat, heading_deg
from jaxalign.nav_estimate import Block, NavEstimate
from jaxalign.vector import root

__all__ = ["AidRecord", "FilterRecord", "Solution", "Status", "assembled", "check_threshold"]


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


def _status_bits(*, defined: Any, observable: Any, aided: Any, finite: Any, unused: Any = False, xp: Any = jnp) -> Any:
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


class AidRecord(eqx.Module):
    """What a method made of one aid.

    Attributes:
        residual: (K, m) of the fix of this epoch: measured minus predicted, in the unit of the aid (``robust_map``: its
            noise, smoothed; a recursion of vectors: of the vector, n0).
        weight: (K,) of that fix.
        sd: (K,) standard deviation of its noise: assumed, or found by a method that does so.
        valid: (K,) whether there is a fix.
    """

    residual: Float[Array, "*K m"]
    weight: Float[Array, "*K"]
    sd: Float[Array, "*K"]
    valid: Bool[Array, "*K"]


class FilterRecord(eqx.Module):
    """What a filter with an error model tells beside the attitude.

    Attributes:
        gyro_bias: (K, 3) rad/s, b.
        accel_bias: (K, 3) m/s^2, b.
        covariance: (K, n, n) of its error states, SI (``Solution.nav`` names them).
        innovation: (K, m) measured minus predicted at this epoch; zero where there was no update. None: no filter.
        innovation_covariance: (K, m, m), or None.
        updated: (K,) 1 where there was an update, else 0; or None.
        log_likelihood: (K,) of the measurements up to this epoch by the model, but for a constant; or None.
        calibration: (K, m) unknowns of the aids, SI; ``method.unknowns`` says which are where; or None.
        figures: (K, p) of the inertial unit and of the aids that were fitted; ``method.figures`` has their names and
            units; or None.
    """

    gyro_bias: Float[Array, "*K 3"]
    accel_bias: Float[Array, "*K 3"]
    covariance: Float[Array, "*K n n"]
    innovation: Float[Array, "*K m"] | None = None
    innovation_covariance: Float[Array, "*K m m"] | None = None
    updated: Float[Array, "*K"] | None = None
    log_likelihood: Float[Array, "*K"] | None = None
    calibration: Float[Array, "*K m"] | None = None
    figures: Float[Array, "*K p"] | None = None


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
            :class:`jaxalign.observability.Observability`. It knows nothing of sensor biases or of a disturbance that is
            not white.
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
        nav: navigation state, unknowns and joint covariance, for whoever goes on from here, of a method that has a
            covariance; else None.
        aids: name -> what was made of each aid (``residual``, ``weight`` and ``aid_sd`` are those of the first that
            tells a velocity).
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
    aids: dict[str, AidRecord] = eqx.field(default_factory=dict)
    nav: NavEstimate | None = None

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
            for name in ("innovation", "innovation_covariance", "log_likelihood", "calibration", "figures"):
                if (values := getattr(self.filter, name)) is not None:
                    out[name] = self._masked(values)
        if self.nav is not None:
            out |= {key: self._masked(getattr(self.nav, key)) for key in ("velocity", "position")}
            sizes = {name: stop - start for name, start, stop in self.nav.blocks}
            out["covariance_names"] = np.repeat(list(sizes), list(sizes.values()))
        if len(self.aids) > 1 or any(aid.residual.shape[-1] != 3 for aid in self.aids.values()):
            for name, aid in self.aids.items():
                out[f"{name}_residual"] = self._masked(aid.residual)
                out |= {f"{name}_{key}": np.asarray(getattr(aid, key)) for key in ("weight", "sd", "valid")}
        return out


def assembled(
    *,
    time: Any,
    q_nb: Any,
    defined: Any,
    observable: Any,
    finite: Any,
    aided: Any,
    residual: Any,
    weight: Any,
    alpha: Any,
    beta: Any,
    aid_sd: Any,
    aids: dict[str, tuple[Any, Any, Any, Any]],
    eigengap: Any = 0.0,
    covariance: Any = None,
    filter: dict[str, Any] | None = None,
    nav: dict[str, Any] | None = None,
    blocks: tuple[Block, ...] = (),
    unused: Any = False,
    status: Any = 0,
    xp: Any = jnp,
    put: Callable[[Any], Any] = lambda tree: tree,
) -> Solution:
    """A solution of one row or many: where there is no attitude, the identity and zeros; and the bits.

    Args:
        time: see :class:`Solution`; likewise those below that are not named here.
        q_nb: any where not ``defined``.
        defined: whether there is an attitude; not where the numbers are not finite.
        observable: whether the heading means something, where there is one.
        finite: whether all numbers are.
        aided: whether an aid has a sample at this epoch.
        unused: whether it has one, but nothing came of it.
        status: further bits.
        residual: any where not ``defined``; likewise covariance and filter.
        weight: of the vector.
        alpha: the vector in n0.
        beta: the vector in b0.
        aid_sd: noise of the aid.
        aids: name -> residual, weight, sd, validity (:class:`AidRecord`).
        eigengap: of a method that has one.
        covariance: of the attitude, if known.
        filter: fields of a :class:`FilterRecord`, or None.
        nav: fields of a :class:`NavEstimate` that are not among the others: velocity, position, unknowns, covariance.
        blocks: of its covariance.
        xp: jax.numpy, or numpy on the host.
        put: what brings arrays from the host to where they must be.
    """
    defined = defined & finite
    observable = observable & defined
    bits = _status_bits(defined=defined, observable=observable, aided=aided, finite=finite, unused=unused, xp=xp)

    def masked(x: Any) -> Any:
        return xp.where(defined.reshape(*defined.shape, *[1] * (x.ndim - defined.ndim)), x, 0.0)

    def all_masked(tree: Any) -> Any:
        return jax.tree.map(masked, tree)

    positive = xp.where(q_nb[..., :1] < 0, -q_nb, q_nb)
    rows = {
        "time": time,
        "q_nb": xp.where(defined[..., None], positive, xp.asarray([1.0, 0.0, 0.0, 0.0])),
        "defined": defined,
        "observable": observable,
        "eigengap": eigengap + xp.zeros(defined.shape),
        "residual": masked(residual),
        "weight": weight,
        "alpha": alpha,
        "beta": beta,
        "covariance": all_masked(covariance),
        "status": status + bits,
        "aid_sd": aid_sd,
    }
    of_aids = {name: (masked(residual), *rest) for name, (residual, *rest) in aids.items()}
    rows, of_filter, of_aids, of_nav = put((rows, all_masked(filter), of_aids, all_masked(nav)))
    told = None if of_filter is None else FilterRecord(**of_filter)
    handed = None
    if of_nav is not None and told is not None:
        biases = {"gyro_bias": told.gyro_bias, "accel_bias": told.accel_bias}
        handed = NavEstimate(time=rows["time"], q_nb=rows["q_nb"], **biases, **of_nav, blocks=blocks)
    records = {name: AidRecord(*x) for name, x in of_aids.items()}
    return Solution(**rows, filter=told, aids=records, nav=handed)
