"""What goes wrong with the samples of an inertial unit: coarse, clipped, shaken, lost or far off.

As :mod:`jaxalign.simulate.imu_faults`, whose protocol they keep.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxalign.arguments import check_choice, whole_number
from jaxalign.errors import UserError
from jaxalign.simulate.arguments import leaf
from jaxalign.simulate.imu_faults import AbstractImuFault, check_some, figure
from jaxalign.units import UG
from jaxalign.wgs84 import STANDARD_GRAVITY

__all__ = [
    "IncrementQuantisation",
    "PointSamples",
    "RateQuantisation",
    "Saturation",
    "Spikes",
    "Stuck",
    "Triad",
    "Vibration",
    "Zeros",
]

Triad = Literal["gyro", "accel", "both"]
_TRIADS = ("gyro", "accel", "both")
_AXES = "xyz"
_DEG = np.pi / 180.0
_ARCSEC = _DEG / 3600.0
_TICK = 1e-6  # of a sample: times nearer to each other are one


def _rounded(x: Array, step: Array) -> Array:
    """Rounded to a multiple of a step; as it is where that is zero."""
    there = step > 0
    safe = jnp.where(there, step, 1.0)
    return jnp.where(there, jnp.round(x / safe) * safe, x)


class IncrementQuantisation(AbstractImuFault):
    """Increments in whole pulses; what is left of one is kept for the next, so that sums stay right to half a pulse.

    As ring lasers and units with integrating accelerometers put them out.

    Attributes:
        gyro_arcsec: size of a pulse of the gyroscopes, seconds of arc, one number or three; 0: they have none.
        accel_mm_s: of the accelerometers, mm/s, likewise.
    """

    gyro_arcsec: Float[Array, "*axes"]
    accel_mm_s: Float[Array, "*axes"]

    def __init__(self, gyro_arcsec: Any = None, accel_mm_s: Any = None):
        check_some("IncrementQuantisation", gyro_arcsec=gyro_arcsec, accel_mm_s=accel_mm_s)
        self.gyro_arcsec = figure("IncrementQuantisation", "gyro_arcsec", gyro_arcsec, 0.0)
        self.accel_mm_s = figure("IncrementQuantisation", "accel_mm_s", accel_mm_s, 0.0)

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """Whole multiples of the pulses (rad, m/s)."""

        def pulses(x: Array, size: Array) -> Array:
            whole = _rounded(jnp.cumsum(x, axis=0), size)
            return jnp.where(size > 0, jnp.diff(whole, axis=0, prepend=jnp.zeros((1, 3))), x)

        return pulses(dtheta, self.gyro_arcsec * _ARCSEC), pulses(dvel, self.accel_mm_s * 1e-3)


class RateQuantisation(AbstractImuFault):
    """Rates and forces rounded to the last digit that is put out; what is cut off is lost.

    Attributes:
        gyro_deg_s: last digit of the rates, deg/s, one number or three; 0: they are not rounded.
        accel_mg: last digit of the forces, mg, likewise.
    """

    gyro_deg_s: Float[Array, "*axes"]
    accel_mg: Float[Array, "*axes"]

    def __init__(self, gyro_deg_s: Any = None, accel_mg: Any = None):
        check_some("RateQuantisation", gyro_deg_s=gyro_deg_s, accel_mg=accel_mg)
        self.gyro_deg_s = figure("RateQuantisation", "gyro_deg_s", gyro_deg_s, 0.0)
        self.accel_mg = figure("RateQuantisation", "accel_mg", accel_mg, 0.0)

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """Rounded rates times dt (rad, m/s)."""
        gyro, accel = self.gyro_deg_s * _DEG, self.accel_mg * (1e3 * UG)
        return _rounded(dtheta, gyro * dt), _rounded(dvel, accel * dt)


class Saturation(AbstractImuFault):
    """No axis measures more than its range.

    Attributes:
        gyro_deg_s: range of the gyroscopes, deg/s, one number or three; None: they have no end.
        accel_g: range of the accelerometers, g (9.80665 m/s^2), likewise.
    """

    gyro_deg_s: Float[Array, "*axes"] | None
    accel_g: Float[Array, "*axes"] | None

    def __init__(self, gyro_deg_s: Any = None, accel_g: Any = None):
        check_some("Saturation", gyro_deg_s=gyro_deg_s, accel_g=accel_g)
        self.gyro_deg_s = None if gyro_deg_s is None else figure("Saturation", "gyro_deg_s", gyro_deg_s, 0.0)
        self.accel_g = None if accel_g is None else figure("Saturation", "accel_g", accel_g, 0.0)

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """Increments of at most the range times dt (rad, m/s)."""
        if self.gyro_deg_s is not None:
            most = self.gyro_deg_s * _DEG * dt
            dtheta = jnp.clip(dtheta, -most, most)
        if self.accel_g is not None:
            most = self.accel_g * STANDARD_GRAVITY * dt
            dvel = jnp.clip(dvel, -most, most)
        return dtheta, dvel


class Vibration(AbstractImuFault):
    """A sine that the sensors feel and the vehicle does not follow: of a motor, a propeller, a loose bracket.

    Increments are exact integrals, so a sample of length dt holds sin(pi f dt) / (pi f dt) of it. Several frequencies
    are several of these. (:class:`jaxalign.simulate.SineForce` shakes the base of a vehicle that stands.)

    Attributes:
        frequency: Hz.
        gyro_deg_s: amplitude of the rates, deg/s, one number or three.
        accel_mg: amplitude of the force, mg, likewise.
        random_phase: each run draws the phase of each axis of each triad; False: all are zero (static).
    """

    frequency: Float[Array, ""]
    gyro_deg_s: Float[Array, "*axes"]
    accel_mg: Float[Array, "*axes"]
    random_phase: bool = eqx.field(static=True)

    def __init__(self, frequency: Any, gyro_deg_s: Any = None, accel_mg: Any = None, random_phase: bool = True):
        check_some("Vibration", gyro_deg_s=gyro_deg_s, accel_mg=accel_mg)
        self.frequency = leaf(frequency, "Vibration: frequency", low=1e-6)
        if self.frequency.shape:
            raise UserError(f"Vibration: frequency: one number is expected, got {frequency!r}: one fault for each")
        self.gyro_deg_s = figure("Vibration", "gyro_deg_s", gyro_deg_s)
        self.accel_mg = figure("Vibration", "accel_mg", accel_mg)
        self.random_phase = check_choice("Vibration: random_phase", random_phase, (False, True))

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """With the sines (rad, m/s)."""
        phase = jnp.zeros(6)
        if self.random_phase:
            phase = 2 * jnp.pi * jax.random.uniform(key, (6,), jnp.float64)
        pi_f = jnp.pi * self.frequency
        sines = jnp.sin(2 * pi_f * (t - 0.5 * dt)[:, None] + phase) * (jnp.sin(pi_f * dt) / pi_f)
        gyro, accel = self.gyro_deg_s * _DEG, self.accel_mg * (1e3 * UG)
        return dtheta + gyro * sines[:, :3], dvel + accel * sines[:, 3:]


class _AbstractOutage(AbstractImuFault):
    """Some axes of one triad or of both do not measure for a while.

    Hit are samples that end after `start`, and at `stop` at the latest.
    """

    start: Float[Array, ""]
    stop: Float[Array, ""]
    triad: Triad = eqx.field(static=True)
    axes: str = eqx.field(static=True)

    def __init__(self, start: Any, stop: Any, triad: Triad = "both", axes: str = _AXES):
        kind = type(self).__name__
        self.start = leaf(start, f"{kind}: start")
        self.stop = leaf(stop, f"{kind}: stop")
        self.triad = check_choice(f"{kind}: triad", triad, _TRIADS)
        if not isinstance(axes, str) or not axes or set(axes) - set(_AXES) or len(set(axes)) < len(axes):
            raise UserError(f"{kind}: axes = {axes!r}: some of x, y, z are expected, such as 'xyz' or 'z'")
        self.axes = axes
        concrete = not isinstance(self.start, Tracer) and not isinstance(self.stop, Tracer)
        if concrete and np.any(np.asarray(self.stop) < np.asarray(self.start)):
            raise UserError(f"{kind}: it ends ({stop} s) before it starts ({start} s)")

    @abstractmethod
    def _instead(self, x: Float[Array, "n 3"], during: Bool[Array, " n"]) -> Array:
        """What a triad puts out in place of x during the outage."""

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """The increments (rad, m/s), others where these axes are out."""
        during = (t > self.start + _TICK * dt) & (t <= self.stop + _TICK * dt)
        hit = during[:, None] & jnp.asarray([axis in self.axes for axis in _AXES])
        if self.triad != "accel":
            dtheta = jnp.where(hit, self._instead(dtheta, during), dtheta)
        if self.triad != "gyro":
            dvel = jnp.where(hit, self._instead(dvel, during), dvel)
        return dtheta, dvel


class Zeros(_AbstractOutage):
    """Channels that read zero for a while, as a broken cable or a logger that fills gaps leaves them.

    Attributes:
        start: s; hit are samples that end after it,
        stop: and at this time (s) at the latest.
        triad: "gyro", "accel" or "both" (static).
        axes: some of "xyz" (static).
    """

    def _instead(self, x: Float[Array, "n 3"], during: Bool[Array, " n"]) -> Array:
        return jnp.zeros_like(x)


class Stuck(_AbstractOutage):
    """Channels that repeat their last value for a while (the first one, if nothing was before).

    Attributes:
        start: s; hit are samples that end after it,
        stop: and at this time (s) at the latest.
        triad: "gyro", "accel" or "both" (static).
        axes: some of "xyz" (static).
    """

    def _instead(self, x: Float[Array, "n 3"], during: Bool[Array, " n"]) -> Array:
        return x[jnp.maximum(jnp.argmax(during) - 1, 0)]


class Spikes(AbstractImuFault):
    """Single samples that are far off: of both triads at once, each axis up or down at random.

    Attributes:
        gyro_deg_s: how far the rates are off, deg/s, one number or three.
        accel_g: how far the forces are off, g, likewise.
        probability: per sample; None: `times` say when.
        times: (k,) s, in the samples that are hit; None: at random.
    """

    gyro_deg_s: Float[Array, "*axes"]
    accel_g: Float[Array, "*axes"]
    probability: Float[Array, ""] | None
    times: Float[Array, " k"] | None

    def __init__(self, gyro_deg_s: Any = None, accel_g: Any = None, probability: Any = None, times: Any = None):
        check_some("Spikes", gyro_deg_s=gyro_deg_s, accel_g=accel_g)
        if (probability is None) == (times is None):
            raise UserError("Spikes: give either probability (per sample) or times (s)")
        self.gyro_deg_s = figure("Spikes", "gyro_deg_s", gyro_deg_s)
        self.accel_g = figure("Spikes", "accel_g", accel_g)
        self.probability = None if probability is None else leaf(probability, "Spikes: probability", 0.0, 1.0)
        self.times = None if times is None else jnp.atleast_1d(leaf(times, "Spikes: times", low=0.0))

    def hits(self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any) -> Bool[Array, " n"]:
        """Which samples this key hits."""
        if self.probability is not None:
            return jax.random.uniform(key, t.shape, jnp.float64) < self.probability
        assert self.times is not None
        rows = jnp.searchsorted(t, self.times - _TICK * dt)
        return jnp.zeros(t.shape, bool).at[rows].set(True, mode="drop")

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """With the spikes (rad, m/s)."""
        key_hit, key_sign = jax.random.split(key)
        signs = jax.random.rademacher(key_sign, (len(t), 6), jnp.float64) * dt
        signs = jnp.where(self.hits(key_hit, t, dt)[:, None], signs, 0.0)
        gyro, accel = self.gyro_deg_s * _DEG, self.accel_g * STANDARD_GRAVITY
        return dtheta + gyro * signs[:, :3], dvel + accel * signs[:, 3:]


class PointSamples(AbstractImuFault):
    """A unit logged at a low rate as it happens to be then: no mean over the interval, no integral.

    Of every so many samples the last is logged, and taken for the whole of the interval before it. The log keeps its
    rate: these samples are all alike, which preintegration takes as one long sample of that rate and force. White noise
    of a sample counts for the whole interval, and what shakes faster than the logging is folded into it.

    Attributes:
        every: samples of the scenario between two that are logged (static).
    """

    every: int = eqx.field(static=True)

    def __init__(self, every: int):
        self.every = whole_number("PointSamples: every", every, 2, of="IMU samples")

    def __call__(
        self, key: PRNGKeyArray, t: Float[Array, " n"], dt: Any, dtheta: Float[Array, "n 3"], dvel: Float[Array, "n 3"]
    ) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
        """Blocks of equal increments (rad, m/s); the last, if it is shorter, ends with the record."""
        logged = np.minimum((np.arange(len(t)) // self.every + 1) * self.every, len(t)) - 1
        return dtheta[logged], dvel[logged]
