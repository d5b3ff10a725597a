"""The attitude profile matrix: a running sum over pairs, and the eigenproblem that turns it into an attitude."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxalign.estimate.base import Readout
from jaxalign.estimate.davenport import davenport
from jaxalign.observe import Context, Pair
from jaxalign.vector import Mat3, Vec3, where

__all__ = ["Profile", "inverse_lengths"]

# A read-out with a closed Coriolis term needs the attitude that it seeks. Starting from the last attitude, each pass
# shrinks the error by about 2 v / (g t cos(lat)): two passes from scratch leave 3e-5 deg at 60 s. Where the last
# attitude is that of the epoch before, the epochs themselves are the passes, and one is enough.
_PASSES = 2


class Profile(eqx.Module):
    """``sum w alpha beta^T``; beta in two parts where its Coriolis term awaits the attitude."""

    fixed: Mat3
    moment: Mat3 | None
    w_ie: Vec3

    @classmethod
    def zero(cls, coupled: bool) -> Profile:
        """Empty sums; with the second one where pairs come with a moment."""
        return cls(Mat3.zero(), Mat3.zero() if coupled else None, Vec3.zero())

    def scaled(self, factor: Any) -> Profile:
        """The sums times a number."""
        return Profile(self.fixed * factor, None if self.moment is None else self.moment * factor, self.w_ie)

    def plus(self, pair: Pair, weight: Any) -> Profile:
        """With one more pair."""
        weighted = pair.alpha * weight
        moment = None if self.moment is None else self.moment + weighted.outer(pair.moment)
        return Profile(self.fixed + weighted.outer(pair.open_beta), moment, pair.w_ie)

    def read(self, context: Context) -> Readout:
        """Solve; where beta depends on the attitude, feed it in and solve again."""
        if self.moment is None:
            return _readout(self.fixed)
        attitude, known = context.attitude, context.defined
        for _ in range(1 if context.fresh else _PASSES):
            w_ie_b0 = where(known, attitude.conjugate().rotate(self.w_ie), Vec3.zero())
            found = _readout(self.fixed + self.moment.map_rows(w_ie_b0.cross))
            attitude, known = found.attitude, found.defined
        return found


def _readout(profile: Mat3) -> Readout:
    found = davenport(profile)
    positive = found.value > 0
    return Readout.of_gap(found.vector, jnp.where(positive, found.gap / jnp.where(positive, found.value, 1.0), 0.0))


def inverse_lengths(pair: Pair) -> Any:
    """``1 / (|alpha| |beta|)``, the factor that makes a pair one of unit vectors; zero for a null pair."""
    product = pair.alpha.norm() * pair.beta.norm()
    positive = product > 0
    return jnp.where(positive, 1.0 / jnp.where(positive, product, 1.0), 0.0)
