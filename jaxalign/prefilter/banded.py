"""The solver of Vondrak's smoothing: (P + kappa D'D) s = P y for any spacing and any weights, O(N).

D holds third derivatives (of the cubic through four neighbours, squared and integrated over the middle interval), and
kappa = (N - 3) / (theta (t[N-2] - t[1])). The normal matrix is ill-conditioned (4e12 at 0.5 Hz and 200 Hz, where
Cholesky is wrong by 100 ug), so its square root is factored: a banded Givens QR of [sqrt(P); sqrt(kappa) D] in one
scan. In float32 Cholesky is useless below a cut-off of 0.05 / dt, and QR errs by 1e-4 of the data at 0.02 / dt, 2 % at
0.0025 / dt: one would decimate the record first, or run a Kalman smoother in time scaled to the cut-off. float64 only.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

__all__ = ["Factor", "factor", "smooth", "solve"]

_UNROLL = 4  # compiles twice as fast as 8, and runs no slower


class Factor(eqx.Module):
    """A factored problem: good for any number of columns of data.

    Attributes:
        root: (N,) square roots of the weights.
        quadratics: three polynomials of at most second degree, (N,) each, orthonormal under the weights.
        r: four diagonals of R, (N,) each, the main one first.
        c: cosines of the rotations, four of (N-3,).
        s: sines.
    """

    root: Float[Array, " n"]
    quadratics: tuple[Float[Array, " n"], ...]
    r: tuple[Float[Array, " n"], ...]
    c: tuple[Float[Array, " m"], ...]
    s: tuple[Float[Array, " m"], ...]


def _rows(t: Array, theta: Any) -> tuple[Array, ...]:
    """The four diagonals of sqrt(kappa) D, (N-3,) each.

    From the spacings in units of their mean, so that no difference of large times is taken.
    """
    n = t.shape[0]
    h = jnp.diff(t)
    tau = jnp.mean(h)
    h = h / tau
    a, b, c = h[:-2], h[1:-1], h[2:]
    scale = 6.0 * jnp.sqrt(b) * jnp.sqrt((n - 3) / (theta * (t[n - 2] - t[1]) * tau**5))
    return (
        -scale / (a * (a + b) * (a + b + c)),
        scale / (a * b * (b + c)),
        -scale / ((a + b) * b * c),
        scale / ((a + b + c) * (b + c) * c),
    )


def _quadratics(t: Array, root: Array) -> tuple[Array, ...]:
    """They pass unchanged: taken out of the data first, they cost no digits."""
    x = 2.0 * (t - t[0]) / (t[-1] - t[0]) - 1.0
    weight, found = root * root, []
    for f in (jnp.ones_like(x), x, x * x):
        for _ in range(2):  # Gram-Schmidt, twice is enough
            for g in found:
                f = f - jnp.sum(weight * f * g) * g
        size = jnp.sum(weight * f * f)
        found.append(jnp.where(size > 0, f / jnp.sqrt(jnp.where(size > 0, size, 1.0)), 0.0))
    return tuple(found)


def _rotation(a: Any, b: Any) -> tuple[Any, Any, Any]:
    """C, s and the length of (a, b), with c a + s b = length."""
    square = a * a + b * b
    some = square > 0
    length = jnp.sqrt(jnp.where(some, square, 1.0))
    return jnp.where(some, a / length, 1.0), jnp.where(some, b / length, 0.0), jnp.where(some, length, 0.0)


def factor(t: Float[ArrayLike, " n"], p: Float[ArrayLike, " n"], theta: Any) -> Factor:
    """Factor the problem: depends on times (s, increasing), weights (>= 0, three above) and theta (s^-6) only."""
    t, p = jnp.asarray(t), jnp.asarray(p)
    rows = _rows(t, theta)
    root = jnp.sqrt(jnp.where(p > 0, p, 1.0)) * (p > 0)

    def step(window, row):
        """Rotate one row of D into the triangle of four columns; its first row is then final."""
        (w00, w01, w02), (w11, w12), (w22,) = window
        d0, d1, d2, d3, new = row
        c0, s0, r00 = _rotation(w00, d0)
        r01, d1 = c0 * w01 + s0 * d1, c0 * d1 - s0 * w01
        r02, d2 = c0 * w02 + s0 * d2, c0 * d2 - s0 * w02
        r03, d3 = s0 * d3, c0 * d3
        c1, s1, x11 = _rotation(w11, d1)
        x12, d2 = c1 * w12 + s1 * d2, c1 * d2 - s1 * w12
        x13, d3 = s1 * d3, c1 * d3
        c2, s2, x22 = _rotation(w22, d2)
        x23, d3 = s2 * d3, c2 * d3
        c3, s3, x33 = _rotation(new, d3)
        out = (r00, r01, r02, r03), (c0, c1, c2, c3), (s0, s1, s2, s3)
        return ((x11, x12, x13), (x22, x23), (x33,)), out

    zero = jnp.zeros_like(root[0])
    start = ((root[0], zero, zero), (root[1], zero), (root[2],))
    last, (r, c, s) = jax.lax.scan(step, start, (*rows, root[3:]), unroll=_UNROLL)
    (w00, w01, w02), (w11, w12), (w22,) = last
    ends = ((w00, w11, w22), (w01, w12, zero), (w02, zero, zero), (zero, zero, zero))
    main, *others = (jnp.concatenate([x, jnp.stack(e)]) for x, e in zip(r, ends, strict=True))
    main = jnp.where(main == 0, 1.0, main)  # fewer than three weights: finite, but no smoothing
    return Factor(root, _quadratics(t, root), (main, *others), c, s)


def _back(f: Factor, z: Array) -> Array:
    """R x = z."""

    def step(carry, row):
        x1, x2, x3 = carry
        z, r0, r1, r2, r3 = row
        x = (z - r1 * x1 - r2 * x2 - r3 * x3) / r0
        return (x, x1, x2), x

    zero = jnp.zeros_like(z[0])
    return jax.lax.scan(step, (zero, zero, zero), (z, *f.r), reverse=True, unroll=_UNROLL)[1]


def _forward(f: Factor, b: Array) -> Array:
    """R^T z = b."""
    r0, r1, r2, r3 = f.r
    shifted = (jnp.concatenate([jnp.zeros(k), r[: r.shape[0] - k]]) for k, r in ((1, r1), (2, r2), (3, r3)))

    def step(carry, row):
        z1, z2, z3 = carry
        b, r0, r1, r2, r3 = row
        z = (b - r1 * z1 - r2 * z2 - r3 * z3) / r0
        return (z, z1, z2), z

    zero = jnp.zeros_like(b[0])
    return jax.lax.scan(step, (zero, zero, zero), (b, r0, *shifted), unroll=_UNROLL)[1]


def solve(f: Factor, y: Float[Array, " n"]) -> Float[Array, " n"]:
    """Smooth one column of data with a factored problem; vmap it over columns."""
    y = jnp.where(f.root > 0, y, 0.0)
    passing = sum(jnp.sum(f.root**2 * y * g) * g for g in f.quadratics)
    rhs = f.root * (y - passing)

    def step(window, row):
        z0, z1, z2 = window
        z3, (c0, c1, c2, c3), (s0, s1, s2, s3) = row
        out, d = c0 * z0 + 0.0, -s0 * z0
        z1, d = c1 * z1 + s1 * d, c1 * d - s1 * z1
        z2, d = c2 * z2 + s2 * d, c2 * d - s2 * z2
        z3 = c3 * z3 + s3 * d
        return (z1, z2, z3), out

    last, z = jax.lax.scan(step, (rhs[0], rhs[1], rhs[2]), (rhs[3:], f.c, f.s), unroll=_UNROLL)
    return passing + _back(f, jnp.concatenate([z, jnp.stack(last)]))


@jax.custom_jvp
def smooth(
    t: Float[Array, " n"], y: Float[Array, " n"], p: Float[Array, " n"], theta: Float[Array, ""]
) -> Float[Array, " n"]:
    """Smoothed values of one column; differentiable in y, p and theta (not in t) by one more solve.

    Args:
        t: times, s, increasing.
        y: data; any finite number where p is zero.
        p: weights (1 for a sample, 0 for a missing one); at least three above zero.
        theta: smoothing factor, s^-6.
    """
    return solve(factor(t, p, theta), y)


@smooth.defjvp
def _smooth_jvp(primals, tangents):
    t, y, p, theta = primals
    _, dy, dp, dtheta = tangents
    f = factor(t, p, theta)
    s = solve(f, y)
    # (P + kappa D'D) s = P y, kappa ~ 1/theta: differentiate both sides, with kappa D'D s = p (y - s).
    rhs = p * dy + dp * (y - s) + p * (y - s) * (dtheta / theta)

    def apply(x):
        rows = _rows(t, theta)
        third = sum(d * x[i : x.shape[0] - 3 + i] for i, d in enumerate(rows))
        back = sum(jnp.pad(d * third, (i, 3 - i)) for i, d in enumerate(rows))
        return p * x + back

    def inverse(_, b):
        return _back(f, _forward(f, b))

    ds = jax.lax.custom_linear_solve(apply, rhs, inverse, transpose_solve=inverse, symmetric=True)
    return s, ds
