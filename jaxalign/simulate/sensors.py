"""Errors of the inertial sensors in a run, drawn from what is stated of the unit; and the sines of a shaken base.

Pure functions of a key, to be vmapped over keys. What is stated: :mod:`jaxalign.inertial_unit`.
"""

from __future__ import annotations

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxalign.earth import STANDARD_GRAVITY
from jaxalign.inertial_unit import AbstractTriadErrors
from jaxalign.simulate.arguments import leaf
from jaxalign.simulate.random import fold, normals

__all__ = ["BIAS_KINDS", "WANDER", "BiasKind", "SineForce", "draw_bias", "triad_increments", "white"]

BiasKind = Literal["sign", "gaussian", "fixed"]
BIAS_KINDS = ("sign", "gaussian", "fixed")
WANDER = 2
"""What the key of a triad is folded with to draw the wander of its bias; 0 and 1 are its bias and its noise."""


def white(key: PRNGKeyArray, count: int) -> Float[Array, "count 3 *runs"]:
    """Unit white noise on three axes, for one key or an array of them.

    Drawn as one flat float32 vector (several times cheaper than float64, and fine enough for a noise), then
    widened.
    """
    return normals(key, 3 * count).astype(jnp.float64).reshape(count, 3, *key.shape)


def draw_bias(errors: AbstractTriadErrors, kind: BiasKind, key: PRNGKeyArray) -> Float[Array, " 3"]:
    """The bias of a triad at the start of a run, rad/s or m/s^2.

    Args:
        errors: of the triad; the size of the bias is one number or three.
        kind: "sign" (the size with a random sign on each axis), "gaussian" (the size is the standard deviation),
            "fixed" (the size itself, with its sign).
        key: of the draw.
    """
    if kind == "sign":
        return errors.bias * jax.random.rademacher(key, (3,), jnp.float64)
    if kind == "gaussian":
        return errors.bias * jax.random.normal(key, (3,), jnp.float64)
    return jnp.broadcast_to(errors.bias, (3,))


def triad_increments(
    errors: AbstractTriadErrors, kind: BiasKind, key: PRNGKeyArray, samples: int, dt: Any
) -> Float[Array, "samples 3"]:
    """Errors of the increments of one run (rad or m/s): bias, white noise, and the wander of the bias.

    `draw_bias` with the first half of ``jax.random.split(key)`` gives the bias at the start alone. It takes a step
    after each sample: a random walk.
    """
    key_bias, key_noise = jax.random.split(key)
    out = draw_bias(errors, kind, key_bias) * dt + white(key_noise, samples) * errors.increment_sd(dt)
    if errors.bias_walk is None:
        return out
    steps = white(fold(key, WANDER), samples) * (errors.bias_walk * jnp.sqrt(dt) * dt)
    return out + jnp.cumsum(steps, axis=0) - steps


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
