"""A multirate low-pass filter: decimate in steps, filter at the lowest rate, interpolate back by the same steps.

At 200 Hz a Hamming-windowed low-pass of 0.5 Hz would need 1600 taps; after two decimations by five it needs 65.
All filters are centred, so the whole has no delay. The record is extended evenly at its ends (mirrored about the end
sample): an odd extension doubles the noise of the end sample, which ruins the record (6 deg of heading on a real log).
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.errors import UserError
from jaxalign.parametrization import tunable
from jaxalign.prefilter.base import AbstractPrefilter, Frame

__all__ = ["Fir"]

_RATE, _TAPS = 8.0, 65  # of the filter at the lowest rate: its transition is 0.4 Hz wide
_ANTI_ALIAS_TAPS = 33
_ANTI_ALIAS_CUTOFF = 0.25  # of the rate after decimation: aliases of the passband lie 100 dB down


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
    """Cascade of Hamming-windowed low-pass filters with decimation to 8 Hz.

    Attributes:
        cutoff: frequency (Hz) of gain 0.5 of the filter at the lowest rate; with the decimations before and after it
            the gain is 0.46 at 0.5 Hz.
        frame: in which the specific force is filtered, see :data:`jaxalign.prefilter.base.Frame`.

    Source: the multirate filter that the Vondrak paper compares with (its Scheme 3; Lian et al.'s inertial-frame
    alignment); 200-40-8 Hz as there, number of taps and way back to the full rate ours.
    """

    cutoff: Float[Array, ""] = tunable(0.5, unit="Hz", bounds=(0.2, 1.0))
    frame: Frame = eqx.field(static=True, default="inertial")

    def factors(self, dt: float) -> tuple[int, ...]:
        """Decimation factors for a sampling interval (s): at most five at a time, down to 8 Hz or just above."""
        left, out = 1.0 / dt / _RATE * (1 + 1e-9), []
        while left >= 2:
            out.append(int(min(5, left)))
            left /= out[-1]
        return tuple(out)

    def _filters(self, dt: float) -> tuple[tuple[int, ...], list[Any], Any]:
        factors = self.factors(dt)
        steps = [_anti_alias(k) for k in factors]
        return factors, steps, _low_pass(_TAPS, self.cutoff * (dt * int(np.prod(factors))))

    def __call__(self, x: Float[Array, "samples axes"], dt: float) -> Float[Array, "samples axes"]:
        """The filtered record; differentiable in it and in the cut-off.

        Raises:
            UserError: sampled below 4 Hz.
        """
        if dt > 0.25:
            raise UserError(f"the FIR filter takes records of at least 4 Hz, not {1 / dt:g} Hz")
        factors, steps, last = self._filters(dt)
        n, total = x.shape[0], int(np.prod(factors))
        reach = (_TAPS // 2 + 1) * total + 2 * sum(len(h) // 2 * int(np.prod(factors[:i])) for i, h in enumerate(steps))
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
