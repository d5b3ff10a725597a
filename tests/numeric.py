"""Numerical helpers: one check for every derivative (forward, reverse, central differences at two step sizes)."""

from collections.abc import Callable

import jax
import numpy as np

EPS = np.finfo(float).eps


def skew(a: np.ndarray) -> np.ndarray:
    """The matrices [a x] of vectors on the last axis."""
    return np.swapaxes(np.cross(a[..., None, :], np.eye(3)), -1, -2)


def assert_derivatives(
    f: Callable, points, *, third: float = 2.0, steps: tuple[float, float] = (1e-3, 1e-4), noise: float = 10.0
) -> np.ndarray:
    """Hold the derivatives of ``f`` at several points against each other; return the Jacobians, (points, ...).

    Args:
        f: array -> array, traceable.
        points: the arguments, on a first axis (one compilation serves all).
        third: bound of the third derivatives of ``f`` over its largest first derivative (or 1, if larger): central
            differences err by ``third * step**2 / 6``.
        steps: of the central differences; the tolerance shrinks with them.
        noise: rounding of ``f``, in eps of its largest value (or 1).
    """
    points = np.asarray(points, np.float64)
    count, size = len(points), points[0].size
    directions = np.eye(size).reshape(size, *points.shape[1:])
    compiled = jax.jit(lambda x: (jax.vmap(jax.jacfwd(f))(x), jax.vmap(jax.jacrev(f))(x), jax.vmap(f)(x)))

    def jacobian(rows):  # (points * size, ...) -> the layout of jacfwd
        return np.moveaxis(rows.reshape(count, size, -1), 1, -1).reshape(forward.shape)

    forward, reverse, values = (np.asarray(x) for x in compiled(points))
    assert np.all(np.isfinite(forward))
    scale, size_of_f = max(1.0, np.max(np.abs(forward))), max(1.0, np.max(np.abs(values)))
    np.testing.assert_allclose(reverse, forward, rtol=0, atol=1e-12 * scale)
    evaluate = jax.jit(jax.vmap(f))
    for step in steps:
        ahead, behind = (
            np.asarray(evaluate((points[:, None] + sign * step * directions).reshape(-1, *points.shape[1:])))
            for sign in (1, -1)
        )
        differences = jacobian((ahead - behind) / (2 * step))
        tolerance = third * scale * step**2 / 6 + noise * EPS * size_of_f / step
        np.testing.assert_allclose(forward, differences, rtol=0, atol=tolerance)
    return forward
