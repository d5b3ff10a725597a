"""A standing vehicle in inertial space: what its gyros and accelerometers have summed up by each epoch."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxalign.earth import earth_rate
from jaxalign.epochs import Epochs
from jaxalign.observability import Observability
from jaxalign.propagation import advance_body
from jaxalign.vector import Quat, Vec3, mean_rotated, root

__all__ = ["InertialRecord"]


class InertialRecord(eqx.Module):
    """Everything per epoch that whole-record methods choose from; leaves of shape (M+1,).

    Attributes:
        time: s.
        q_b0b: from the gyros.
        q_n0n: the Earth's.
        alpha: -int C_n0n g dt, m/s.
        beta: int C_b0b f dt, m/s.
        turned: sum of the rotation vectors of the intervals, in b, rad.
        force: sum of the velocity increments, in b, m/s.
    """

    time: Float[Array, " epochs"]
    q_b0b: Quat
    q_n0n: Quat
    alpha: Vec3
    beta: Vec3
    turned: Vec3
    force: Vec3

    @classmethod
    def of(cls, epochs: Epochs) -> InertialRecord:
        """From the epochs of a standing vehicle."""
        rows, site = epochs.rows, epochs.site

        def advance(q, row):
            q, gained = advance_body(q, row.rotation, row.dvel)
            return q, (q, gained)

        def running(v: Vec3) -> Vec3:
            return jax.tree.map(jnp.cumsum, v)

        q_b0b, gained = jax.lax.scan(advance, Quat.identity(), rows)[1]
        time = jnp.cumsum(rows.dt)
        angle = earth_rate(site.lat) * time
        up = mean_rotated(angle, Vec3(0.0 * time, 0.0 * time, site.gravity * time))
        beta = running(gained)
        turned = rows.rotation.log()
        # An interval's dvel stands in b at its start; half the rotation back makes it the mean over the interval.
        force = Quat.exp(turned * -0.5).rotate(rows.dvel)
        return cls(time, q_b0b, Quat.exp(angle), up, beta, running(turned), running(force))

    def at(self, index: Any) -> InertialRecord:
        """Some epochs of it."""
        return jax.tree.map(lambda x: x[index], self)

    def _observability(self) -> Observability:
        steps = jax.tree.map(lambda x: jnp.diff(x, prepend=x[:1]), self.alpha)
        return Observability.of(steps, np.arange(len(self.time)) > 0).cumulated()

    def observable(self, aid_sd: Any) -> Bool[Array, " epochs"]:
        """Whether gravity has turned beyond the noise of the force, per epoch: see :mod:`jaxalign.observability`."""
        return self._observability().observable(aid_sd, steps=True)

    def heading_sd(self, aid_sd: Any) -> Float[Array, ""]:
        """What the turning of gravity over the whole record allows at best, rad; 1 where it has not turned."""
        scatter = self._observability().scatter()[-1]
        turned = scatter > 0
        return jnp.where(turned, aid_sd / root(jnp.where(turned, scatter, 1.0)), 1.0)
