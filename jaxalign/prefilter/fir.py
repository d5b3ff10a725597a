"""A multirate low-pass filter: decimate in steps, filter at the lowest rate, interpolate back by the same steps.

At 200 Hz a Hamming-windowed low-pass of 0.5 Hz would need 1600 taps; after two decimations by five it needs 65.
All filters are centred, so the whole has no delay. The record is extended evenly at its ends (mirrored about the end
sample): an odd extension doubles the noise of the end sample, which ruins the record (6 deg of heading on a real log).
"""

from __future__ import annotations

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.errors import UserError
from jaxalign.parameters import tunable
from jaxalign.prefilter.base import AbstractPrefilter

__all__ = ["Fir"]

_ANTI_ALIAS_TAPS = 33
_ANTI_ALIAS_CUTOFF = 0.25  # of the rate after decimation: aliases of the passband lie 100 dB down, the passband is flat


def _low_pass(taps: int, cutoff: Any, xp: Any = jnp) -> Any:
    """Hamming-windowed sinc of unit gain at zero; cut-off in cycles per sample, gain 0.5 there."""
    n = np.arange(taps) - (taps - 1) / 2
    h = xp.sinc(2 * cutoff * n) * np.hamming(taps)
    return h / xp.sum(h)


def _anti_alias(factor: int) -> np.ndarray:
    """Low-pass for a decimation or interpolation by a factor, with double zeros at all images of zero frequency.

    Without them gravity itself comes back from the interpolation with a ripple (0.7 %, or 7 mg).
    """
    box = np.ones(factor) / factor
    return np.convolve(_low_pass(_ANTI_ALIAS_TAPS, _ANTI_ALIAS_CUTOFF / factor, np), np.convolve(box, box))


def _gain(h: Any, frequency: Any) -> Any:
    """Of a centred symmetric filter, at frequencies in cycles per sample."""
    n = np.arange(len(h)) - (len(h) - 1) / 2
    return jnp.sum(h * jnp.cos(2 * jnp.pi * jnp.asarray(frequency)[..., None] * n), axis=-1)


def _convolve(x: Any, h: Any, stride: int = 1, dilation: int = 1) -> Any:
    """Centred convolution of columns (n, c), zeros beyond the ends; take or insert every so many samples."""
    half = (len(h) - 1) // 2
    out = jax.lax.conv_general_dilated(
        x.T[:, None, :], h[None, None, ::-1], (stride,), ((half, half + dilation - 1),), lhs_dilation=(dilation,)
    )
    return out[:, 0, :].T


class Fir(AbstractPrefilter):
    """Cascade of Hamming-windowed low-pass filters with decimation.

    Attributes:
        cutoff: frequency (Hz) of gain 0.5 of the filter at the lowest rate; below a quarter of it.
        rate: the lowest rate, Hz: decimation goes in steps of at most five while the rate stays at or above it.
        taps: of the filter at the lowest rate, odd: its transition is 3.3 rate / taps wide.
        frame: in which the specific force is filtered, "inertial" or "body".

    Source: the multirate filter that the Vondrak paper compares with (its Scheme 3; Lian et al.'s inertial-frame
    alignment); 200-40-8 Hz as there, number of taps and way back to the full rate ours.
    """

    cutoff: Float[Array, ""] = tunable(0.5, unit="Hz", bounds=(1e-2, 20.0))
    rate: float = eqx.field(static=True, default=8.0)
    taps: int = eqx.field(static=True, default=65)
    frame: Literal["inertial", "body"] = eqx.field(static=True, default="inertial")

    def __check_init__(self):
        if not 0 < self.rate < np.inf:
            raise UserError(f"rate = {self.rate}: the lowest rate must be a positive number of Hz")
        if self.taps < 3 or self.taps % 2 == 0:
            raise UserError(f"taps = {self.taps}: must be an odd number, at least 3")

    def factors(self, dt: float) -> tuple[int, ...]:
        """Decimation factors for a sampling interval (s)."""
        left, out = 1.0 / dt / self.rate * (1 + 1e-9), []
        while left >= 2:
            out.append(int(min(5, left)))
            left /= out[-1]
        return tuple(out)

    def _filters(self, dt: float) -> tuple[tuple[int, ...], list[Any], Any]:
        factors = self.factors(dt)
        steps = [_anti_alias(k) for k in factors]
        return factors, steps, _low_pass(self.taps, self.cutoff * (dt * int(np.prod(factors))))

    def __call__(self, x: Float[Array, "samples axes"], dt: float) -> Float[Array, "samples axes"]:
        """The filtered record; differentiable in it and in the cut-off."""
        factors, steps, last = self._filters(dt)
        n, total = x.shape[0], int(np.prod(factors))
        reach = (self.taps // 2 + 1) * total + 2 * sum(
            len(h) // 2 * int(np.prod(factors[:i])) for i, h in enumerate(steps)
        )
        left = -(-reach // total) * total  # the record's first sample stays one of the decimated
        right = left + -(n + 2 * left) % total
        y = jnp.pad(x, ((left, right), (0, 0)), mode="reflect")
        for k, h in zip(factors, steps, strict=True):
            y = _convolve(y, h, stride=k)
        y = _convolve(y, last)
        for k, h in zip(factors[::-1], steps[::-1], strict=True):
            y = _convolve(y, h * k, dilation=k)
        return y[left : left + n]

    def response(self, frequency: Any, dt: float) -> Any:
        """Gain at frequencies (Hz), from a sine to the sine of the same frequency; aliases are 100 dB down."""
        factors, steps, last = self._filters(dt)
        out, scale = 1.0, dt
        for k, h in zip(factors, steps, strict=True):
            out = out * _gain(h, jnp.asarray(frequency) * scale) ** 2
            scale *= k
        return out * _gain(last, jnp.asarray(frequency) * scale)
