"""Errors of the inertial sensors: constant biases, white noise, and the sine disturbance of a shaken base.

Pure functions of a key, to be vmapped over keys. Parameters are array leaves in SI units; the functions
`gyro_errors` and `accel_errors` take the units of the papers.
"""

from __future__ import annotations

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign.earth import STANDARD_GRAVITY
from jaxalign.errors import UserError
from jaxalign.simulate.arguments import choice, leaf
from jaxalign.simulate.random import normals
from jaxalign.units import DEG_H, DEG_SQRT_H, UG

__all__ = ["BiasKind", "SineForce", "TriadErrors", "accel_errors", "gyro_errors", "white"]

BiasKind = Literal["sign", "gaussian", "fixed"]
_KINDS = ("sign", "gaussian", "fixed")


def white(key: PRNGKeyArray, count: int) -> Float[Array, "count 3 *runs"]:
    """Unit white noise on three axes, for one key or an array of them.

    Drawn as one flat float32 vector (several times cheaper than float64, and fine enough for a noise), then
    widened.
    """
    return normals(key, 3 * count).astype(jnp.float64).reshape(count, 3, *key.shape)


def _one(value: Array, what: str) -> Array:
    if value.ndim:
        raise UserError(f"{what}: one number for the three axes is expected, got {value.shape[0]}")
    return value


class TriadErrors(eqx.Module):
    """Errors of three gyroscopes or three accelerometers.

    Attributes:
        bias: (3,) size of the constant bias per axis, rad/s or m/s^2.
        density: white noise of the rate as a density: rad/sqrt(s) (angle random walk) or m/s/sqrt(s).
        sample_sd: white noise of the rate as a standard deviation per sample, rad/s or m/s^2.
        kind: how a run draws its bias: "sign" (the size with a random sign on each axis), "gaussian" (the
            size is the standard deviation), "fixed" (the size itself).
    """

    bias: Float[Array, " 3"]
    density: Float[Array, ""]
    sample_sd: Float[Array, ""]
    kind: BiasKind = eqx.field(static=True)

    def __init__(self, bias: Any = 0.0, density: Any = 0.0, sample_sd: Any = 0.0, kind: BiasKind = "sign"):
        self.bias = jnp.broadcast_to(leaf(bias, "bias"), (3,))
        self.density = _one(leaf(density, "noise density", low=0.0), "noise density")
        self.sample_sd = _one(leaf(sample_sd, "noise per sample", low=0.0), "noise per sample")
        self.kind = choice(kind, "kind of bias", _KINDS)

    def draw_bias(self, key: PRNGKeyArray) -> Float[Array, " 3"]:
        """The constant bias of one run (rad/s or m/s^2)."""
        if self.kind == "sign":
            return self.bias * jax.random.rademacher(key, (3,), jnp.float64)
        if self.kind == "gaussian":
            return self.bias * jax.random.normal(key, (3,), jnp.float64)
        return self.bias

    def increment_sd(self, dt: Any) -> Float[Array, ""]:
        """Standard deviation of the noise of one increment over dt (s): rad or m/s."""
        variance = self.density**2 * dt + (self.sample_sd * dt) ** 2
        positive = variance > 0
        return jnp.where(positive, jnp.sqrt(jnp.where(positive, variance, 1.0)), 0.0)

    def increments(self, key: PRNGKeyArray, samples: int, dt: Any) -> Float[Array, "samples 3"]:
        """Errors of the increments of one run (rad or m/s): bias and white noise.

        `draw_bias` with the first half of ``jax.random.split(key)`` gives the bias alone.
        """
        key_bias, key_noise = jax.random.split(key)
        return self.draw_bias(key_bias) * dt + white(key_noise, samples) * self.increment_sd(dt)


def gyro_errors(
    bias_deg_h: Any = 0.0, walk_deg_sqrt_h: Any = 0.0, noise_deg_h: Any = 0.0, kind: BiasKind = "sign"
) -> TriadErrors:
    """Errors of gyroscopes, in the units of data sheets.

    Args:
        bias_deg_h: constant bias, deg/h, one number or three.
        walk_deg_sqrt_h: angle random walk, deg/sqrt(h) (a density of 1 deg/h/sqrt(Hz) is 1/60 deg/sqrt(h)).
        noise_deg_h: standard deviation of each rate sample, deg/h.
        kind: how a run draws its bias, see `TriadErrors`.

    Raises:
        UserError: for a negative noise or an unknown kind.
    """
    return TriadErrors(
        leaf(bias_deg_h, "bias_deg_h") * DEG_H,
        leaf(walk_deg_sqrt_h, "walk_deg_sqrt_h", low=0.0) * DEG_SQRT_H,
        leaf(noise_deg_h, "noise_deg_h", low=0.0) * DEG_H,
        kind,
    )


def accel_errors(
    bias_ug: Any = 0.0, density_ug_sqrt_hz: Any = 0.0, noise_ug: Any = 0.0, kind: BiasKind = "sign"
) -> TriadErrors:
    """Errors of accelerometers, in the units of data sheets (1 ug = 9.80665e-6 m/s^2).

    Args:
        bias_ug: constant bias, ug, one number or three.
        density_ug_sqrt_hz: noise density, ug/sqrt(Hz).
        noise_ug: standard deviation of each sample, ug.
        kind: how a run draws its bias, see `TriadErrors`.

    Raises:
        UserError: for a negative noise or an unknown kind.
    """
    return TriadErrors(
        leaf(bias_ug, "bias_ug") * UG,
        leaf(density_ug_sqrt_hz, "density_ug_sqrt_hz", low=0.0) * UG,
        leaf(noise_ug, "noise_ug", low=0.0) * UG,
        kind,
    )


class SineForce(eqx.Module):
    """A shaken base: a sum of sines on the specific force, the same on the three axes of b.

    ``e(t) = amplitude / 2 * sum sin(2 pi f (t + shift))`` with f = 1, 5, 10, 20, 50 Hz is (28) of the Vondrak
    paper. Only the force is disturbed, not the attitude, as there. Each run starts at another `shift`, drawn
    within one period of the lowest frequency (`random_start=False`: zero, as printed). Increments are exact
    integrals, so a sample of length dt holds sin(pi f dt) / (pi f dt) of each sine.

    Attributes:
        amplitude: the paper's "Bias", m/s^2.
        frequency: (k,), Hz.
        random_start: draw the shift per run.
    """

    amplitude: Float[Array, ""]
    frequency: Float[Array, " k"]
    random_start: bool = eqx.field(static=True)

    def __init__(self, amplitude: Any, frequency: Any = (1.0, 5.0, 10.0, 20.0, 50.0), random_start: bool = True):
        self.amplitude = leaf(amplitude, "amplitude", low=0.0)
        self.frequency = jnp.atleast_1d(leaf(frequency, "frequency", low=1e-9))
        self.random_start = bool(random_start)

    @classmethod
    def of_mg(cls, amplitude_mg: Any, **rest: Any) -> SineForce:
        """The amplitude in mg (1 mg = 9.80665e-3 m/s^2)."""
        return cls(leaf(amplitude_mg, "amplitude_mg", low=0.0) * (STANDARD_GRAVITY * 1e-3), **rest)

    def increments(self, key: PRNGKeyArray, samples: int, dt: Any) -> Float[Array, "samples 3"]:
        """Velocity increments of the disturbance in one run (m/s)."""
        shift = jnp.zeros(())
        if self.random_start:
            shift = jax.random.uniform(key, (), jnp.float64) / jnp.min(self.frequency)
        middle = (jnp.arange(samples, dtype=jnp.float64) + 0.5) * dt + shift
        total = jnp.zeros(samples)
        for f in self.frequency:
            # The integral of a sine over a sample is its value at the middle times sin(pi f dt) / (pi f).
            total = total + jnp.sin(2 * jnp.pi * f * middle) * jnp.sin(jnp.pi * f * dt) / (jnp.pi * f)
        return jnp.broadcast_to((self.amplitude / 2 * total)[:, None], (samples, 3))
