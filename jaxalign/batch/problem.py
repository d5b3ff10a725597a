"""What the batch estimator is given, what it carries from step to step, and what it reads out.

All that a caller may want to vary without another compiled program is an array: figures of the unit, the epoch up to
which fixes count, the trajectory to start from.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxalign.aids import AbstractAid
from jaxalign.batch.measurement import Unknowns
from jaxalign.batch.trajectory import NominalTrajectory
from jaxalign.earth import Site
from jaxalign.epochs import Epoch
from jaxalign.inertial_unit import ImuErrors
from jaxalign.vector import Quat, Vec3

__all__ = ["LEAST_SD", "AidNoise", "Model", "Problem", "Readout", "State"]

LEAST_SD = 1e-6
"""Noise of an aid, in its unit, below which none is believed."""


class Model(eqx.Module):
    """What is known beforehand; see :class:`jaxalign.RobustMap`. Numbers have shape () or (L,).

    Attributes:
        imu: figures of the inertial unit.
        outlier_probability: beforehand, of a fix.
        outlier_ratio: standard deviation of outliers over that of the others.
        sd: (c,) or (c, L) standard deviations of the unknowns of the aids.
        fade_s: (c,) s: after so long an unknown has renewed itself; infinite for constants.
        tolerance: what a step moves a solution that has converged, in standard deviations.
        unknown: their names, of each aid.
        aid_noise: how it is found; "held": it stays as it is.
        aids: what measures.
        gyro_mean: (3, L) or a number: the bias of the gyroscopes that is expected beforehand, rad/s.
        held: of each aid the variance of its noise (L,), where it is held.
    """

    imu: ImuErrors
    outlier_probability: Any
    outlier_ratio: Any
    sd: Any
    fade_s: Any
    tolerance: Any
    unknown: Unknowns = eqx.field(static=True)
    aid_noise: str = eqx.field(static=True)
    aids: tuple[AbstractAid, ...] = eqx.field(static=True)
    gyro_mean: Any = 0.0
    held: Any = None


class Problem(eqx.Module):
    """Fixes up to an epoch.

    Attributes:
        rows: of the epochs, leaves (K, L), or (K, 1) where all lanes have the same.
        site: leaves (), or (L,).
        stated: of each aid its standard deviation, () or (m,), in its unit.
        last: (L,) epoch up to which fixes count.
        length: epochs that count in any lane, see :func:`jaxalign.batch.rows.over_rows`; None: all, as derivatives
            need it.
    """

    rows: Epoch
    site: Site
    stated: tuple[Float[Array, "*m"], ...]
    last: Any
    length: Any = None

    @property
    def on(self) -> Bool[Array, "K L"]:
        """Whether an epoch counts."""
        return jnp.arange(len(self.rows.dt))[:, None] <= self.last

    @property
    def used(self) -> tuple[Bool[Array, "K L"], ...]:
        """Of each aid, whether there is a fix that counts."""
        on = self.on
        return tuple(fix.valid & on for fix in self.rows.fixes)

    @property
    def counts(self) -> tuple[Any, ...]:
        """Of each aid, how many components of a fix there are, (K, L) or (K, 1); None: all of them."""
        return tuple(
            None if fix.each is None else sum(jnp.where(there, 1.0, 0.0) for there in fix.each)
            for fix in self.rows.fixes
        )

    @property
    def deviations(self) -> tuple[tuple[Any, Any], ...]:
        """Of each aid one standard deviation, and the variances of its components over its square, (m, 1)."""
        out = []
        for sd in self.stated:
            least = jnp.maximum(sd, LEAST_SD)
            if jnp.ndim(sd) == 0:
                out.append((least, 1.0))
            else:
                one = jnp.sqrt(jnp.mean(jnp.square(least)))
                out.append((one, jnp.square(least / one)[:, None]))
        return tuple(out)


class AidNoise(eqx.Module):
    """What is thought of the fixes of one aid.

    Attributes:
        weight: (K, L) of each fix.
        variance: (L,) of the noise of a fix, in the square of its unit.
        times: (L,) how many times it counts.
    """

    weight: Float[Array, "K L"]
    variance: Float[Array, " L"]
    times: Float[Array, " L"]

    @property
    def whole(self) -> Any:
        """(L,) variance with which it counts."""
        return self.variance * self.times


class State(eqx.Module):
    """Between two steps.

    Attributes:
        at: trajectory.
        q_n0n: n at its epochs.
        unknowns: (c, L) of the aids.
        noise: of each aid.
        steady: (K, L) where an aid measures a velocity in n, see :mod:`jaxalign.batch.measurement`; else None.
        early: (L,) the trajectory is still far off: the noise is judged by its median. While biases are still in the
            misfit a mean square would take them for noise, and keep them there.
        moving: (L,) whether it has not converged; if it has, it stays as it is, whatever other lanes do.
    """

    at: NominalTrajectory
    q_n0n: Quat
    unknowns: Float[Array, "c L"]
    noise: tuple[AidNoise, ...]
    steady: Vec3 | None
    early: Bool[Array, " L"]
    moving: Bool[Array, " L"]


class Readout(eqx.Module):
    """The solution at the last epoch that counts.

    Attributes:
        q_nb: (4, L).
        tilt: (3, 3, L) covariance of the attitude error in n, rad^2.
        gyro: (3, L) bias, rad/s.
        accel: (3, L) bias, m/s^2.
        velocity: (3, L) m/s, n.
        unknowns: (c, L) of the aids.
        displacement: (3, L) since the first epoch, m, n.
        covariance: (n, n, L) of all errors, signs and axes as :class:`jaxalign.NavEstimate` has them.
        log_likelihood: (L,) but for a constant.
        residual: of each aid (m, L) the noise of the last fix, in its unit.
        residual_n0: (3, L) that of the first velocity, m/s, n0.
        weight: of each aid (L,) that of the last fix.
        sd: of each aid (L,) that of its noise.
    """

    q_nb: Float[Array, "4 L"]
    tilt: Float[Array, "3 3 L"]
    gyro: Float[Array, "3 L"]
    accel: Float[Array, "3 L"]
    velocity: Float[Array, "3 L"]
    unknowns: Float[Array, "c L"]
    displacement: Float[Array, "3 L"]
    covariance: Float[Array, "n n L"]
    log_likelihood: Float[Array, " L"]
    residual: tuple[Float[Array, "m L"], ...]
    residual_n0: Float[Array, "3 L"]
    weight: tuple[Float[Array, " L"], ...]
    sd: tuple[Float[Array, " L"], ...]
