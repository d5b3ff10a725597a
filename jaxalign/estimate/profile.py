"""The attitude profile matrix: a running sum over pairs, and the eigenproblem that turns it into an attitude."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxalign.estimate.base import Readout
from jaxalign.estimate.eigenproblem import davenport
from jaxalign.observe import Context, Pair
from jaxalign.vector import Mat3, Quat, Vec3, where

__all__ = ["CentredSums", "Profile", "inverse_lengths"]

# A read-out with a closed Coriolis term needs the attitude that it seeks. Starting from the last attitude, each pass
# shrinks the error by about 2 v / (g t cos(lat)): two passes from scratch leave 3e-5 deg at 60 s. Where the last
# attitude is that of the epoch before, the epochs themselves are the passes, and one is enough.
_PASSES = 2


class Profile(eqx.Module):
    """``sum w alpha beta^T``; beta in two parts where its Coriolis term awaits the attitude."""

    fixed: Mat3
    displacement: Mat3 | None
    w_ie: Vec3

    @classmethod
    def zero(cls, coupled: bool) -> Profile:
        """Empty sums; with the second one where pairs come with a displacement."""
        return cls(Mat3.zero(), Mat3.zero() if coupled else None, Vec3.zero())

    def scaled(self, factor: Any) -> Profile:
        """The sums times a number."""
        return Profile(
            self.fixed * factor, None if self.displacement is None else self.displacement * factor, self.w_ie
        )

    def plus(self, pair: Any, weight: Any) -> Profile:
        """With one more pair: anything with alpha, beta_without_coriolis, displacement and w_ie."""
        weighted = pair.alpha * weight
        displacement = None if self.displacement is None else self.displacement + weighted.outer(pair.displacement)
        return Profile(self.fixed + weighted.outer(pair.beta_without_coriolis), displacement, pair.w_ie)

    def read(self, context: Context) -> Readout:
        """Solve; where beta depends on the attitude, feed it in and solve again."""
        if self.displacement is None:
            return _readout(self.fixed)
        attitude, known = context.attitude, context.defined
        for _ in range(1 if context.fresh else _PASSES):
            w_ie_b0 = where(known, attitude.conjugate().rotate(self.w_ie), Vec3.zero())
            found = _readout(self.fixed + self.displacement.map_rows(w_ie_b0.cross))
            attitude, known = found.attitude, found.defined
        return found


class CentredSums(eqx.Module):
    """Sums from which a common offset of the pairs, the first velocity, can be taken out."""

    profile: Profile
    alpha: Vec3
    beta: Vec3
    displacement: Vec3 | None
    weight: Float[Array, "*pairs"]

    @classmethod
    def zero(cls, coupled: bool) -> CentredSums:
        """Empty sums."""
        zero = Vec3.zero()
        return cls(Profile.zero(coupled), zero, zero, zero if coupled else None, zero.x)

    def plus(self, pair: Any, weight: Any) -> CentredSums:
        """With one more pair: anything with alpha, beta_without_coriolis, displacement and w_ie."""
        return CentredSums(
            self.profile.plus(pair, weight),
            self.alpha + pair.alpha * weight,
            self.beta + pair.beta_without_coriolis * weight,
            None if self.displacement is None else self.displacement + pair.displacement * weight,
            self.weight + weight,
        )

    def plus_all(self, pairs: Any, weights: Any) -> CentredSums:
        """With many: the leaves of the pairs and the weights have a first axis, w_ie has none."""
        each = CentredSums.zero(self.displacement is not None).plus(pairs, weights)
        total = jax.tree.map(lambda a, b: a + jnp.sum(b, axis=0) if jnp.ndim(b) else b, self, each)
        return eqx.tree_at(lambda sums: sums.profile.w_ie, total, pairs.w_ie)

    def mean(self, of: Vec3) -> Vec3:
        """A sum over the weight; zero where there is none."""
        positive = self.weight > 0
        return of * jnp.where(positive, 1.0 / jnp.where(positive, self.weight, 1.0), 0.0)

    @property
    def centred(self) -> Profile:
        """The profile of the pairs less their means."""
        mean, profile = self.mean(self.alpha), self.profile
        fixed = profile.fixed - mean.outer(self.beta)
        if profile.displacement is None or self.displacement is None:
            return Profile(fixed, None, profile.w_ie)
        return Profile(fixed, profile.displacement - mean.outer(self.displacement), profile.w_ie)

    def offset(self, attitude: Quat, w_ie_b0: Vec3) -> Vec3:
        """The mean of ``alpha - C beta``."""
        beta = self.beta if self.displacement is None else self.beta + w_ie_b0.cross(self.displacement)
        return self.mean(self.alpha) - attitude.rotate(self.mean(beta))


def _readout(profile: Mat3) -> Readout:
    found = davenport(profile)
    positive = found.value > 0
    return Readout.of_gap(found.vector, jnp.where(positive, found.gap / jnp.where(positive, found.value, 1.0), 0.0))


def inverse_lengths(pair: Pair) -> Any:
    """``1 / (|alpha| |beta|)``, the factor that makes a pair one of unit vectors; zero for a null pair."""
    product = pair.alpha.norm() * pair.beta.norm()
    positive = product > 0
    return jnp.where(positive, 1.0 / jnp.where(positive, product, 1.0), 0.0)
