"""The exact IMU of a trajectory: increments by Gauss quadrature of the analytic rate and force."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxalign.earth import Site, earth_rate, normal_gravity, radii, transport_rate
from jaxalign.simulate.trajectory import Trajectory
from jaxalign.vector import Vec3

__all__ = ["Truth", "exact_increments", "specific_force", "turn_rate"]


class Truth(eqx.Module):
    """What perfect sensors would have measured along a trajectory, and where the vehicle truly was.

    A pytree: pass it through `jit` and `vmap` as an argument, and reuse it for every seed.

    Attributes:
        dtheta: (N, 3) integrals of w_ib over the samples, rad, b.
        dvel: (N, 3) integrals of the specific force over the samples, m/s, b.
        t: (M+1,) times of the epochs, s.
        C_nb: (M+1, 3, 3) attitude at the epochs.
        q_nb: (M+1, 4) the same as quaternions.
        velocity_b: (M+1, 3) velocity over the Earth at the epochs, m/s, b.
        velocity_n: (M+1, 3) the same in n.
        rate_n: (M+1, 3) rotation of b against n at the epochs, rad/s, n.
        lat: (M+1,) rad.
        lon: (M+1,) rad.
        h: (M+1,) m.
        dt: sampling interval, s.
        epoch_samples: IMU samples per epoch.
    """

    dtheta: Float[Array, "n 3"]
    dvel: Float[Array, "n 3"]
    t: Float[Array, " m"]
    C_nb: Float[Array, "m 3 3"]
    q_nb: Float[Array, "m 4"]
    velocity_b: Float[Array, "m 3"]
    velocity_n: Float[Array, "m 3"]
    rate_n: Float[Array, "m 3"]
    lat: Float[Array, " m"]
    lon: Float[Array, " m"]
    h: Float[Array, " m"]
    dt: Float[Array, ""]
    epoch_samples: int = eqx.field(static=True)


def _gauss(order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss-Legendre on 0..1: nodes c, weights b, and A[i, j] = integral of Lagrange's l_j to c_i."""
    x, w = np.polynomial.legendre.leggauss(order)
    nodes, weights = (x + 1) / 2, w / 2
    # Integrals over 0..c_i by the same rule, scaled to 0..c_i: exact for polynomials of degree order - 1.
    inner = nodes[:, None] * nodes  # (i, m)
    lagrange = np.ones((order, order, order))  # (i, m, j): l_j at inner[i, m]
    for j in range(order):
        for k in range(order):
            if k != j:
                lagrange[:, :, j] *= (inner - nodes[k]) / (nodes[j] - nodes[k])
    return nodes, weights, nodes[:, None] * np.einsum("m,imj->ij", weights, lagrange)


_NODES, _WEIGHTS, _PARTIAL = _gauss(6)
_PICARD = 3
"""Rounds, each gaining 0.01 x (latitude travelled, rad): three leave 1e-13 rad at 300 m/s, 300 s."""


def turn_rate(trajectory: Trajectory, t: Any, lat: Any, h: Any) -> Vec3:
    """Rotation w_ib of the body (rad/s, b) at the times t (s), at a latitude (rad) and height (m).

    Body rate from the Euler rates, plus Earth and transport rate turned into b.
    """
    w_in = earth_rate(lat) + transport_rate(lat, h, trajectory.velocity_n(t))
    return trajectory.rate_nb(t) + trajectory.attitude(t).conjugate().rotate(w_in)


def specific_force(trajectory: Trajectory, t: Any, lat: Any, h: Any) -> Vec3:
    """Specific force f (m/s^2, b) at the times t (s): ``C_bn (v_n' + (2 w_ie + w_en) x v_n - g_n)``."""
    v, acceleration = trajectory.motion_n(t)
    rate = earth_rate(lat) * 2.0 + transport_rate(lat, h, v)
    gravity = normal_gravity(lat, h)
    f_n = acceleration + rate.cross(v) + Vec3(0.0, 0.0, gravity)
    return trajectory.attitude(t).conjugate().rotate(f_n)


def _position(trajectory: Trajectory, site: Site, t: Array, dt: Any) -> tuple[tuple, tuple]:
    """Latitude, longitude and height at the nodes (N, 6) and at the boundaries of the samples (N+1,).

    The velocity does not depend on the position, so the height is a plain integral; latitude and longitude,
    whose rates depend weakly on the latitude, follow by Picard iteration. All samples and nodes at once.
    """
    v = trajectory.velocity_n(t)

    def integrate(rate: Array, start: Any) -> tuple[Array, Array]:
        whole = start + jnp.concatenate([jnp.zeros(1), jnp.cumsum(rate @ _WEIGHTS * dt)])
        return whole[:-1, None] + rate @ _PARTIAL.T * dt, whole

    h, h_edges = integrate(v.z, site.h)
    lat, lat_edges = jnp.broadcast_to(site.lat, t.shape), site.lat
    for _ in range(_PICARD):
        meridian, _ = radii(lat)
        lat, lat_edges = integrate(v.y / (meridian + h), site.lat)
    _, prime_vertical = radii(lat)
    lon, lon_edges = integrate(v.x / ((prime_vertical + h) * jnp.cos(lat)), site.lon)
    return (lat, lon, h), (lat_edges, lon_edges, h_edges)


def exact_increments(trajectory: Trajectory, site: Site, dt: Any, samples: int, epoch_samples: int) -> Truth:
    """Increments of perfect sensors along a trajectory, and the state at the epochs.

    Six-point Gauss quadrature of `turn_rate` and `specific_force` inside every sample, latitude and height
    carried along (position to about 1e-13 rad). Pure, differentiable in trajectory and site, vectorised over
    all samples: wrap it in `jit` with `samples` and `epoch_samples` static.

    Args:
        trajectory: attitude and velocity; its `breaks` must be multiples of dt.
        site: where the vehicle starts.
        dt: sampling interval, s.
        samples: number N of IMU samples.
        epoch_samples: IMU samples per epoch; M = N // epoch_samples.

    Returns:
        The truth, with epochs 0..M.
    """
    dt = jnp.asarray(dt, jnp.float64)
    t = (jnp.arange(samples, dtype=jnp.float64)[:, None] + _NODES) * dt
    (lat, _, h), edges = _position(trajectory, site, t, dt)

    def integral(rate: Vec3) -> Array:
        return jnp.stack([component @ _WEIGHTS for component in (rate.x, rate.y, rate.z)], axis=-1) * dt

    dtheta = integral(turn_rate(trajectory, t, lat, h))
    dvel = integral(specific_force(trajectory, t, lat, h))
    epochs = samples // epoch_samples
    te = jnp.arange(epochs + 1, dtype=jnp.float64) * (epoch_samples * dt)
    lat_e, lon_e, h_e = (edge[: epochs * epoch_samples + 1 : epoch_samples] for edge in edges)
    attitude = trajectory.attitude(te)
    return Truth(
        dtheta=dtheta,
        dvel=dvel,
        t=te,
        C_nb=attitude.matrix.array,
        q_nb=attitude.array,
        velocity_b=trajectory.velocity_b(te).array,
        velocity_n=trajectory.velocity_n(te).array,
        rate_n=attitude.rotate(trajectory.rate_nb(te)).array,
        lat=lat_e,
        lon=lon_e,
        h=h_e,
        dt=dt,
        epoch_samples=epoch_samples,
    )


jitted_increments = jax.jit(exact_increments, static_argnames=("samples", "epoch_samples"))
"""`exact_increments`, compiled once per structure of the trajectory and number of samples."""
