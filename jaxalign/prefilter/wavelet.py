"""Wavelet low-pass: the approximation at one level, everything finer set to zero. Needs PyWavelets (``[wavelet]``)."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.errors import UserError
from jaxalign.prefilter.base import AbstractPrefilter, Frame

__all__ = ["Wavelet"]


def _library() -> Any:
    try:
        import pywt
    except ImportError as error:
        raise UserError("the wavelet filter needs PyWavelets: pip install 'jaxalign[wavelet]'") from error
    return pywt


class Wavelet(AbstractPrefilter):
    """Approximation of a multilevel discrete wavelet transform (symmetric extension of the ends).

    Runs on the host, also inside ``jit`` and ``vmap``; it has no derivative. On real records its ends are bad.

    Attributes:
        wavelet: an orthogonal wavelet of PyWavelets.
        cutoff: Hz; the level is the one whose band (half the rate, halved per level) ends nearest to it: 8 at 200 Hz.
        frame: in which the specific force is filtered, see :data:`jaxalign.prefilter.base.Frame`.

    Source: the Vondrak paper's Scheme 4 (multiple levels of decomposition); wavelet and level are not stated there.
    """

    wavelet: str = eqx.field(static=True, default="db4")
    cutoff: float = eqx.field(static=True, default=0.5)
    frame: Frame = eqx.field(static=True, default="inertial")

    def __check_init__(self):
        if not 0 < self.cutoff < np.inf:
            raise UserError(f"cutoff = {self.cutoff}: must be a positive number of Hz")
        pywt = _library()
        if self.wavelet not in pywt.wavelist(kind="discrete") or not pywt.Wavelet(self.wavelet).orthogonal:
            raise UserError(f"wavelet = {self.wavelet!r}: must be an orthogonal wavelet of PyWavelets, such as db4")

    def level(self, dt: float) -> int:
        """Levels of decomposition for a sampling interval (s)."""
        return max(0, round(float(np.log2(0.5 / dt / self.cutoff))))

    def __call__(self, x: Float[Array, "samples axes"], dt: float) -> Float[Array, "samples axes"]:
        """The filtered record.

        Raises:
            UserError: a record too short for the level.
        """
        pywt, level, n = _library(), self.level(dt), x.shape[0]
        length = pywt.Wavelet(self.wavelet).dec_len
        if n < (length - 1) * 2**level:
            raise UserError(
                f"a record of {n * dt:g} s is too short for {level} levels of {self.wavelet}: it takes at least "
                f"{(length - 1) * 2**level * dt:.1f} s, or a higher cutoff"
            )

        def low(x: np.ndarray) -> np.ndarray:
            x = np.asarray(x)
            if level == 0:
                return x
            coarse, *fine = pywt.wavedec(x, self.wavelet, mode="symmetric", level=level, axis=-2)
            fine = [np.zeros_like(d) for d in fine]
            return pywt.waverec([coarse, *fine], self.wavelet, mode="symmetric", axis=-2)[..., :n, :]

        shape = jax.ShapeDtypeStruct(x.shape, jnp.float64)
        return jax.pure_callback(low, shape, x, vmap_method="expand_dims")

    def response(self, frequency: Any, dt: float) -> Any:
        """Gain at frequencies (Hz), from a sine to the sine of the same frequency, averaged over its phase.

        The transform is not shift-invariant: a sine also leaves aliases, only 10-20 dB below near the cut-off.
        """
        taps = np.asarray(_library().Wavelet(self.wavelet).dec_lo)
        out = jnp.ones_like(jnp.asarray(frequency, jnp.float64))
        for level in range(self.level(dt)):
            phase = 2 * jnp.pi * jnp.asarray(frequency)[..., None] * (dt * 2**level) * np.arange(len(taps))
            out = out * (jnp.sum(taps * jnp.cos(phase), -1) ** 2 + jnp.sum(taps * jnp.sin(phase), -1) ** 2) / 2
        return out
