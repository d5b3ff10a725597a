"""What the Vondrak paper chooses the smoothing factor by: its printed objective, and the usable reconstruction of it.

Both are pure functions of spectra, differentiable where they are defined; :func:`jaxalign.prefilter.misfit` is the
better choice. With S the density of the force before and S' after the filter, the paper compares means of S - S' below
and above the cut-off, in dB here (no unit is stated):

``printed``
    phi = exp(dL) (ln dH + 1) / ln dH, (27). dL is not negative, so phi exceeds one almost everywhere and grows without
    bound as everything is smoothed away: degenerate.
``reconstructed``
    phi = exp(-|dL|) ln dH / ln(dH + 1): the only combination of these terms that tends to one from below. It
    chooses 2 to 9 Hz and passes the disturbance it should remove; what it converges on is leakage of the tapers.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxalign.prefilter.objectives import low_band

__all__ = ["changes_db", "printed", "reconstructed"]

_FLOOR = 1e-300


def changes_db(
    frequency: Float[ArrayLike, " f"],
    before: Float[ArrayLike, " f"],
    after: Float[ArrayLike, " f"],
    split: float = 0.5,
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """(25), (26): mean decrease (dB) of a spectrum by a filter, up to the split (Hz) and above it.

    Densities below 1e-300 count as 1e-300: a perfect filter has no infinite decrease.

    Raises:
        UserError: the split is outside the spectrum.
    """
    low = low_band(frequency, split)
    difference = 10 * (
        jnp.log10(jnp.maximum(jnp.asarray(before), _FLOOR)) - jnp.log10(jnp.maximum(jnp.asarray(after), _FLOOR))
    )
    return jnp.mean(difference[low]), jnp.mean(difference[~low])


def _log_above_one(x: Any) -> tuple[Any, Any]:
    """Ln x where x > 1, else a harmless number, and the mask."""
    ok = x > 1.0
    return jnp.log(jnp.where(ok, x, jnp.e)), ok


def printed(low_db: Any, high_db: Any) -> tuple[Any, Any]:
    """(27) as printed, and whether it is defined (high_db > 1; elsewhere 0 is returned: it has a pole at 1)."""
    log, ok = _log_above_one(jnp.asarray(high_db))
    return jnp.where(ok, jnp.exp(low_db) * (log + 1.0) / log, 0.0), ok


def reconstructed(low_db: Any, high_db: Any) -> tuple[Any, Any]:
    """(27) with its signs and fraction turned so that it tends to one; (value, defined). 0, its limit, up to 1 dB."""
    log, ok = _log_above_one(jnp.asarray(high_db))
    one_more = jnp.log(jnp.where(ok, jnp.asarray(high_db), jnp.e) + 1.0)
    return jnp.where(ok, jnp.exp(-jnp.abs(low_db)) * log / one_more, 0.0), ok
