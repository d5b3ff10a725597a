"""The 4x4 symmetric eigenproblem of Davenport's q-method, with a derivative that never divides by a closed gap.

The relative gap between the two largest eigenvalues runs from 1e-8 to 1e-3 in an alignment, so the solver must be
backward stable: fixed-sweep cyclic Jacobi on the ten components, error times gap within a few eps, vectorised over
any number of lanes (``jnp.linalg.eigh`` calls LAPACK matrix by matrix, and its gradient is NaN where eigenvalues
coincide). Newton's iteration for the eigenvalue (QUEST) loses half of the digits and is not offered.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxalign.vector import Mat3, Quat

__all__ = ["Dominant", "davenport", "dominant_eigenvector"]

# Rotations of one sweep; neighbours in the list act on disjoint rows, so they run side by side.
_ORDER = ((0, 1), (2, 3), (0, 2), (1, 3), (0, 3), (1, 2))
_SWEEPS = 5
_UPPER = tuple((i, j) for i in range(4) for j in range(i, 4))


class Dominant(NamedTuple):
    """Largest eigenvalue, its unit eigenvector (of either sign), and the gap to the second largest."""

    vector: Quat
    value: Any
    gap: Any


def _rotate(a: dict, v: list[list[Any]], p: int, q: int) -> None:
    """One Jacobi rotation in place: annihilate a[p, q] (a as its upper triangle; v[k] = eigenvector k)."""
    app, aqq, apq = a[p, p], a[q, q], a[p, q]
    half = 0.5 * (aqq - app)
    square = half * half + apq * apq
    root = jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0)
    denominator = half + jnp.where(half < 0, -root, root)
    t = jnp.where(denominator == 0, 0.0, apq / jnp.where(denominator == 0, 1.0, denominator))
    c = 1.0 / jnp.sqrt(1.0 + t * t)
    s = t * c
    a[p, p], a[q, q], a[p, q] = app - t * apq, aqq + t * apq, jnp.zeros_like(apq)
    for k in range(4):
        if k not in (p, q):
            kp, kq = (min(k, p), max(k, p)), (min(k, q), max(k, q))
            a[kp], a[kq] = c * a[kp] - s * a[kq], s * a[kp] + c * a[kq]
    v[p], v[q] = (
        [c * x - s * y for x, y in zip(v[p], v[q], strict=True)],
        [s * x + c * y for x, y in zip(v[p], v[q], strict=True)],
    )


def _solve(k: tuple[Any, ...]) -> tuple[tuple[Any, ...], list[list[Any]]]:
    """Eigenvalues and eigenvectors, unsorted, of the matrix with upper triangle ``k`` (row by row)."""
    one, zero = jnp.ones_like(k[0]), jnp.zeros_like(k[0])
    start = [[one if i == j else zero for j in range(4)] for i in range(4)]

    def sweep(_, carry):
        upper, vectors = carry
        a, v = dict(zip(_UPPER, upper, strict=True)), [list(row) for row in vectors]
        for p, q in _ORDER:
            _rotate(a, v, p, q)
        return tuple(a[ij] for ij in _UPPER), v

    upper, vectors = jax.lax.fori_loop(0, _SWEEPS, sweep, (tuple(k), start))
    a = dict(zip(_UPPER, upper, strict=True))
    return tuple(a[i, i] for i in range(4)), vectors


def _pick(values: tuple[Any, ...], vectors: list[list[Any]]) -> tuple[list[Any], Any, list[Any], Any]:
    """Largest and second largest eigenpair."""
    (l1, v1), (l2, v2) = (values[0], vectors[0]), (values[1], vectors[1])

    def choose(condition, x, y):
        return [jnp.where(condition, a, b) for a, b in zip(x, y, strict=True)]

    swap = l2 > l1
    l1, l2 = jnp.where(swap, l2, l1), jnp.where(swap, l1, l2)
    v1, v2 = choose(swap, v2, v1), choose(swap, v1, v2)
    for value, vector in zip(values[2:], vectors[2:], strict=True):
        first, second = value > l1, value > l2
        l2 = jnp.where(first, l1, jnp.where(second, value, l2))
        v2 = choose(first, v1, choose(second, vector, v2))
        l1, v1 = jnp.where(first, value, l1), choose(first, vector, v1)
    return v1, l1, v2, l2


def _dot(x: Any, y: Any) -> Any:
    return sum(a * b for a, b in zip(x, y, strict=True))


def _times(k: tuple[Any, ...], x: Any) -> list[Any]:
    a = dict(zip(_UPPER, k, strict=True))
    return [sum(a[min(i, j), max(i, j)] * x[j] for j in range(4)) for i in range(4)]


@jax.custom_jvp
def dominant_eigenvector(k: tuple[Any, ...]) -> Dominant:
    """Largest eigenpair of a symmetric 4x4 matrix.

    Args:
        k: the ten components of the upper triangle, row by row, each of any common shape.

    Returns:
        The eigenvector, its eigenvalue and the gap to the next one. The derivative of the eigenvector is the
        pseudo-inverse one, zero along directions whose gap is closed to rounding (relative 1e-12): finite at a
        repeated eigenvalue, where no derivative exists. Second derivatives hold where all four eigenvalues are apart.
    """
    v1, l1, _, l2 = _pick(*_solve(k))
    return Dominant(Quat(*v1), l1, l1 - l2)


@dominant_eigenvector.defjvp
def _dominant_jvp(primals, tangents):
    (k,), (dk,) = primals, tangents
    values, vectors = _solve(k)
    v1, l1, v2, l2 = _pick(values, vectors)
    moved = _times(dk, v1)
    # For a traceless K this is 1e-12 l1: the same line that Readout.of_gap draws between a unique attitude and none.
    size = abs(values[0]) + abs(values[1]) + abs(values[2]) + abs(values[3])
    floor = 1e-12 * jnp.maximum(abs(l1), size / 8)
    dv = [jnp.zeros_like(v1[0])] * 4
    for value, vector in zip(values, vectors, strict=True):
        gap = l1 - value
        is_open = gap > floor
        along = jnp.where(is_open, _dot(vector, moved) / jnp.where(is_open, gap, 1.0), 0.0)
        dv = [total + along * x for total, x in zip(dv, vector, strict=True)]
    dl = _dot(v1, moved)
    return Dominant(Quat(*v1), l1, l1 - l2), Dominant(Quat(*dv), dl, dl - _dot(v2, _times(dk, v2)))


def davenport(b: Mat3) -> Dominant:
    """Solve Wahba's problem: the C maximising ``tr(C^T B)`` with ``B = sum w alpha beta^T``, C beta = alpha.

    Args:
        b: the attitude profile matrix, in components.

    Returns:
        The Hamilton quaternion of C (of either sign), the eigenvalue (the sum of the aligned products) and the gap.

    Source: Davenport's K in the convention of this library; Xu 2017 (10)-(12), where z = (B32 - B23, B13 - B31,
    B21 - B12). Xu 2020 (21)-(22) finds the conjugate quaternion as the smallest eigenvector of another matrix.
    """
    b0, b1, b2 = b.r0, b.r1, b.r2
    trace = b.trace
    return dominant_eigenvector(
        (
            *(trace, b2.y - b1.z, b0.z - b2.x, b1.x - b0.y),
            *(2 * b0.x - trace, b0.y + b1.x, b0.z + b2.x),
            *(2 * b1.y - trace, b1.z + b2.y),
            2 * b2.z - trace,
        )
    )
