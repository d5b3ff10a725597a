"""Figures of the inertial unit and of its aids that are fitted with the attitude, and what is believed beforehand.

Logarithms, in this order: bias (deg/h), white noise (deg/sqrt(h)) of the gyroscopes; bias (ug), white noise
(ug/sqrt(Hz)) of the accelerometers; wander of both biases (deg/h/sqrt(s), ug/sqrt(s)); then of each aid the standard
deviation of its slow error, if it has one, and that of its white noise, in its unit. Lanes are the last axis.

Inertial units lie along a line in the space of these logarithms, from navigation grade to what is in a telephone: the
prior is that line with a spread about it, and any place along it is as good as another.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.aids import AbstractAid
from jaxalign.batch.measurement import unknowns_of
from jaxalign.batch.problem import Model
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors
from jaxalign.units import DEG_H, DEG_SQRT_H, UG

__all__ = [
    "LARGE_BIASES",
    "UNIT",
    "WHITE",
    "Beliefs",
    "Layout",
    "applied",
    "beliefs",
    "described",
    "least_figures",
    "log_prior",
    "on_the_line",
]

UNIT = 6
"""Figures of the inertial unit."""
WHITE = (1, 3)
"""Those of its white noise."""
_LN10 = float(np.log(10.0))
_LINE = np.array([-1.30, -2.00, 2.00, 1.70, -4.0, -0.7])  # decimal logarithms, navigation grade (u = 0)
_SLOPE = np.array([5.33, 2.48, 2.70, 1.30, 5.3, 1.7])  # to the unit of a telephone (u = 1)
_SPREAD = np.array([0.4, 0.35, 0.4, 0.35, 0.5, 0.5])  # about the line
_MIDDLE, _ALONG = 0.45, 0.4  # of u
_LEAST = np.array([0.05, 0.003, 50.0, 10.0, 1e-5, 1e-2])  # less is not believed
_LEAST_AID = 1e-7  # in its unit
_RAW = 0.35 * _LN10  # white noise in use about that of quiet stretches
_BELOW, _ABOVE = 0.05 * _LN10, 2.0  # white noise of an aid about the stated one
_FREE = 1e-9  # precision of a figure with no belief of its own
LARGE_BIASES = (7000.0, 40000.0)
"""deg/h and ug: those of a unit that nobody has calibrated."""
_MOST_WALK = (3.0, 2000.0)  # deg/sqrt(h), ug/sqrt(Hz), to begin with


class Layout(NamedTuple):
    """Where the figures of the aids are.

    Attributes:
        slow: of each aid the number of the figure of its slow error, or None.
        noise: of each aid that of its white noise.
        size: how many figures there are.
    """

    slow: tuple[int | None, ...]
    noise: tuple[int, ...]
    size: int

    @classmethod
    def of(cls, model: Model) -> Layout:
        """Of the aids of a model and their unknowns."""
        slow: list[int | None] = []
        noise: list[int] = []
        end = UNIT
        for names in model.unknown:
            if "slow" in names:
                slow.append(end)
                end += 1
            else:
                slow.append(None)
            noise.append(end)
            end += 1
        return cls(tuple(slow), tuple(noise), end)


class Beliefs(eqx.Module):
    """What is believed of the figures beforehand.

    Attributes:
        mean: (p, 1) of the logarithms.
        precision: (p, p) of them.
        raw: (2, L) logarithms of the white noise in quiet stretches (deg/sqrt(h), ug/sqrt(Hz)), or None.
        stated: (a, L) logarithm of the white noise of each aid as it was stated.
        fixed: (p,) 1 for figures that are known and not fitted, else 0.
        rate: (3, L) mean rate of a vehicle that does not turn, rad/s, b; or None.
        rate_sd: (L,) how well it tells the bias of the gyroscopes, rad/s; or None.
        standing: of each aid whether its noise is never less than stated (static).
    """

    mean: Float[Array, "p 1"]
    precision: Float[Array, "p p"]
    raw: Any
    stated: Float[Array, "a L"]
    fixed: Float[Array, " p"]
    rate: Any = None
    rate_sd: Any = None
    standing: tuple[bool, ...] = eqx.field(static=True, default=())


def beliefs(
    model: Model,
    stated: Any,
    raw: Any = None,
    imu: ImuErrors | None = None,
    centre: tuple[float, ...] | None = None,
    rate: Any = None,
    rate_sd: Any = None,
) -> Beliefs:
    """The prior of the figures.

    Args:
        model: its aids and their unknowns.
        stated: (a, 1) or (a, L) standard deviation of the white noise of each aid, in its unit.
        raw: (2,) or (2, L) white noise in quiet stretches, rad/sqrt(s) and m/s/sqrt(s), or None.
        imu: figures that are known.
        centre: bias and white noise of both triads (in the units of the figures) that are about right, in place of the
            line.
        rate: see :class:`Beliefs`.
        rate_sd: likewise.
    """
    layout = Layout.of(model)
    mean, precision = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    if centre is None:
        mean[:UNIT] = _LINE + _SLOPE * _MIDDLE
        covariance = np.diag(_SPREAD**2) + _ALONG**2 * np.outer(_SLOPE, _SLOPE)
    else:
        mean[:UNIT] = _LINE + _SLOPE * _place(np.log10(centre))
        mean[:4] = np.log10(centre)
        covariance = np.diag(_SPREAD**2)
    precision[:UNIT, :UNIT] = np.linalg.inv(covariance)
    places = zip(model.aids, layout.slow, layout.noise, strict=True)
    for aid, slow, noise in places:
        if slow is not None:
            unknown = aid.known_unknowns["slow"]
            mean[slow], precision[slow, slow] = np.log10(unknown.sd), 1.0 / unknown.decades**2
        precision[noise, noise] = _FREE
    mean, precision = mean * _LN10, precision / _LN10**2
    stated = jnp.log(stated)
    shifted = jnp.asarray(mean)[:, None] * jnp.ones(stated.shape[-1])
    for i, noise in enumerate(layout.noise):
        shifted = shifted.at[noise].set(stated[i])
    fixed = np.zeros(layout.size)
    if imu is not None:
        known = _figures_of(imu)
        shifted = shifted.at[:UNIT].set(known)
        fixed[:UNIT] = 1.0
    if raw is not None:
        raw = jnp.log(jnp.asarray(raw).reshape(2, -1) / jnp.array([[DEG_SQRT_H], [UG]]))
    return Beliefs(
        shifted,
        jnp.asarray(precision),
        raw,
        stated,
        jnp.asarray(fixed),
        rate,
        rate_sd,
        tuple(aid.implied for aid in model.aids),
    )


def _place(logs: np.ndarray) -> float:
    """Where along the line a unit is, by four figures."""
    weight = _SLOPE[:4] / _SPREAD[:4] ** 2
    return float(np.clip(weight @ (logs[:4] - _LINE[:4]) / (weight @ _SLOPE[:4]), 0.0, 1.0))


def _figures_of(imu: ImuErrors) -> Any:
    """(6, 1) logarithms of known figures; of three axes the root mean square."""

    def one(x: Any) -> Any:
        return jnp.sqrt(jnp.mean(jnp.square(jnp.asarray(x, jnp.float64))))

    zero = jnp.zeros(())
    gyro, accel = imu.gyro, imu.accel
    walks = (gyro.bias_walk, accel.bias_walk)
    figures = [
        one(gyro.bias) / DEG_H,
        one(gyro.density) / DEG_SQRT_H,
        one(accel.bias) / UG,
        one(accel.density) / UG,
        *((zero if walk is None else one(walk)) / unit for walk, unit in zip(walks, (DEG_H, UG), strict=True)),
    ]
    return jnp.log(jnp.maximum(jnp.stack(figures), 1e-12))[:, None]


def on_the_line(belief: Beliefs, large: bool) -> Float[Array, "p L"]:
    """Figures to begin with: on the line at the raw noise, or with large biases (and about twice the raw noise)."""
    lanes = belief.stated.shape[-1]
    start = jnp.broadcast_to(belief.mean, (len(belief.mean), lanes))
    middle = jnp.asarray((_LINE + _SLOPE * _MIDDLE) * _LN10)[:, None]
    raw = middle[jnp.array([1, 3])] if belief.raw is None else belief.raw
    known = belief.fixed[:, None] > 0
    if large:
        top = jnp.asarray((_LINE + _SLOPE) * _LN10)[:, None] * jnp.ones(lanes)
        walks = jnp.minimum(raw + jnp.log(2.0), jnp.log(jnp.array(_MOST_WALK))[:, None]) * jnp.ones(lanes)
        biases = jnp.log(jnp.array(LARGE_BIASES))[:, None] * jnp.ones(lanes)
        unit = jnp.stack([biases[0], walks[0], biases[1], walks[1], top[4], top[5]])
    else:
        places = [(raw[i] / _LN10 - _LINE[j]) / _SLOPE[j] for i, j in enumerate((1, 3))]
        u = jnp.clip(jnp.minimum(*places), 0.0, 1.0)
        unit = (jnp.asarray(_LINE)[:, None] + jnp.asarray(_SLOPE)[:, None] * u) * _LN10 * jnp.ones(lanes)
    unit = jnp.where(known[:UNIT], start[:UNIT], unit)
    return jnp.concatenate([unit, start[UNIT:]])


def least_figures(belief: Beliefs, layout: Layout) -> Float[Array, "p L"]:
    """(p, L) below which none is believed; known figures stay what they are."""
    lanes = belief.stated.shape[-1]
    least = jnp.asarray(np.log(np.concatenate([_LEAST, np.full(layout.size - UNIT, _LEAST_AID)])))[:, None]
    least = least * jnp.ones(lanes)
    for i, noise in enumerate(layout.noise):
        if belief.standing[i]:
            least = least.at[noise].set(belief.stated[i])
    return jnp.where(belief.fixed[:, None] > 0, -jnp.inf, least)


def log_prior(belief: Beliefs, layout: Layout, theta: Any) -> tuple[Any, Any, Any]:
    """Logarithm of the prior (L,), its gradient (p, L) and its curvature (p, p, L), as a positive matrix."""
    d = jnp.where(belief.fixed[:, None] > 0, 0.0, theta - belief.mean)
    lanes = theta.shape[-1]
    pull = belief.precision @ d
    value = -0.5 * jnp.sum(d * pull, axis=0)
    slope, curve = -pull, belief.precision[:, :, None] * jnp.ones(lanes)
    if belief.raw is not None:
        for i, j in enumerate((1, 3)):
            off = theta[j] - belief.raw[i]
            value = value - 0.5 * (off / _RAW) ** 2
            slope = slope.at[j].add(-off / _RAW**2)
            curve = curve.at[j, j].add(1.0 / _RAW**2)
    for i, j in enumerate(layout.noise):
        off = theta[j] - belief.stated[i]
        sd = jnp.where(off < 0, _BELOW, _ABOVE)
        value = value - 0.5 * (off / sd) ** 2
        slope = slope.at[j].add(-off / sd**2)
        curve = curve.at[j, j].add(1.0 / sd**2)
    if belief.rate is not None:
        v = jnp.exp(2 * theta[0]) * DEG_H**2
        total, square = v + belief.rate_sd**2, jnp.sum(belief.rate**2, axis=0)
        value = value - 0.5 * square / total - 1.5 * jnp.log(total)
        slope = slope.at[0].add((square / total - 3.0) * v / total)
        curve = curve.at[0, 0].add(6.0 * (v / total) ** 2)
    return value, slope, curve


def applied(model: Model, belief: Beliefs, theta: Any) -> Model:
    """The model with these figures (p, L)."""
    layout = Layout.of(model)
    gyro_bias, walk, accel_bias, density, gyro_wander, accel_wander = (jnp.exp(x)[None] for x in theta[:UNIT])
    mean = model.gyro_mean
    if belief.rate is not None:  # it does not turn: its mean rate is the bias, but for the Earth's and its sway
        variance, told = (gyro_bias * DEG_H) ** 2, belief.rate_sd**2
        mean = belief.rate * variance / (variance + told)
        gyro_bias = jnp.sqrt(variance * told / (variance + told)) / DEG_H
    imu = ImuErrors(
        GyroErrors(gyro_bias, walk, bias_walk_deg_h_sqrt_h=60.0 * gyro_wander),
        AccelErrors(accel_bias, density, bias_walk_ug_sqrt_h=60.0 * accel_wander),
    )
    sd = (model.sd if model.sd.ndim > 1 else model.sd[:, None]) * jnp.ones(theta.shape[-1])
    for aid_places, slow in zip(unknowns_of(model.aids, model.unknown), layout.slow, strict=True):
        if slow is not None:
            sd = sd.at[aid_places["slow"]].set(jnp.exp(theta[slow]))
    held = tuple(jnp.exp(2 * theta[j]) for j in layout.noise)
    return dataclasses.replace(model, imu=imu, sd=sd, gyro_mean=mean, held=held)


def described(aids: tuple[AbstractAid, ...], layout: Layout) -> tuple[tuple[str, str], ...]:
    """Name and unit of each figure."""
    out = [
        ("gyro bias", "deg/h"),
        ("gyro white noise", "deg/sqrt(h)"),
        ("accelerometer bias", "ug"),
        ("accelerometer white noise", "ug/sqrt(Hz)"),
        ("wander of the gyro bias", "deg/h/sqrt(s)"),
        ("wander of the accelerometer bias", "ug/sqrt(s)"),
    ]
    for aid, slow in zip(aids, layout.slow, strict=True):
        if slow is not None:
            out.append((f"slow error of {aid.name}", aid.unit))
        out.append((f"noise of {aid.name}", aid.unit))
    return tuple(out)
