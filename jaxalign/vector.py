"""3-vectors, quaternions and 3x3 matrices held as separate components.

The recursions of the library run for thousands of runs at a time. With each component an array of its own
(one number per run), XLA fuses a whole step into one loop over the runs; with the components on a trailing
axis of length 3 or 4 it does not, and the same step takes more than twice as long. Components may have any common
shape: scalars inside a step, ``(runs,)`` under ``vmap``, ``(intervals,)`` in the preintegration.

Quaternions are Hamilton, scalar first; ``q.rotate(v)`` is ``q v q*``: with ``q = q_ab`` it maps b into a.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

__all__ = ["Mat3", "Quat", "Vec3", "mean_rotated", "root", "where"]


def where(condition: Any, a: Any, b: Any) -> Any:
    """Elementwise choice between two pytrees of the same structure."""
    return jax.tree.map(lambda u, v: jnp.where(condition, u, v), a, b)


def root(square: Any) -> Any:
    """Square root; zero, with a gradient of zero, where there is none."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def _zero() -> Array:
    return jnp.zeros((), jnp.float64)


def _one() -> Array:
    return jnp.ones((), jnp.float64)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Vec3:
    """A 3-vector; the unit is that of its components."""

    __array_ufunc__ = None

    x: Any
    y: Any
    z: Any

    @classmethod
    def zero(cls) -> Vec3:
        """The null vector (float64 scalars)."""
        return cls(_zero(), _zero(), _zero())

    @classmethod
    def of(cls, array: Float[ArrayLike, "*shape 3"]) -> Vec3:
        """Take the components from the last axis of an array."""
        a = jnp.asarray(array)
        return cls(a[..., 0], a[..., 1], a[..., 2])

    @property
    def array(self) -> Float[Array, "*shape 3"]:
        """The components on a last axis."""
        return jnp.stack(jnp.broadcast_arrays(self.x, self.y, self.z), axis=-1)

    def __add__(self, other: Vec3) -> Vec3:
        return Vec3(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: Vec3) -> Vec3:
        return Vec3(self.x - other.x, self.y - other.y, self.z - other.z)

    def __neg__(self) -> Vec3:
        return Vec3(-self.x, -self.y, -self.z)

    def __mul__(self, scale: Any) -> Vec3:
        return Vec3(self.x * scale, self.y * scale, self.z * scale)

    __rmul__ = __mul__

    def dot(self, other: Vec3) -> Any:
        """Scalar product."""
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: Vec3) -> Vec3:
        """Vector product ``self x other``."""
        return Vec3(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )

    def norm2(self) -> Any:
        """Squared length."""
        return self.dot(self)

    def norm(self) -> Any:
        """Length; its gradient at the null vector is zero, not NaN."""
        return root(self.norm2())

    def unit(self) -> Vec3:
        """Direction; the null vector stays null."""
        square = self.norm2()
        positive = square > 0
        return self * jnp.where(positive, 1.0 / jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)

    def outer(self, other: Vec3) -> Mat3:
        """The matrix ``self other^T``."""
        return Mat3(other * self.x, other * self.y, other * self.z)


# Series of the functions of a rotation angle, in the squared angle; used below _SMALL (truncation < 1e-17).
_SMALL = 1e-3


def _sinc_like(angle2: Any, exact: Any, series: tuple[float, ...]) -> Any:
    """``exact(angle)`` away from zero, a power series in ``angle**2`` near it; safe in value and gradient."""
    small = angle2 < _SMALL**2
    angle = jnp.sqrt(jnp.where(small, 1.0, angle2))
    near, power = series[-1], jnp.where(small, angle2, 0.0)
    for coefficient in series[-2::-1]:
        near = coefficient + near * power
    return jnp.where(small, near, exact(angle))


def _alternating(x: Any, first: int, terms: int = 14) -> Any:
    """``sum (-x)^k / (2 k + first)!``: cos, sin and their kin of the root of x, without root, division or branch.

    Fourteen terms are exact to rounding up to x = pi^2, four up to 5e-4.
    """
    total = 0.0 * x
    for k in range(terms - 1, -1, -1):
        total = total * x + (-1) ** k / math.factorial(2 * k + first)
    return total


def mean_rotated(rotvec: Vec3, v: Vec3, terms: int = 14) -> Vec3:
    """The mean of ``exp([r x]) v`` as r goes evenly from zero to ``rotvec`` (rad; at most half a turn).

    Eight terms are exact to rounding up to a radian.
    """
    angle2 = rotvec.norm2()
    turned = rotvec.cross(v)
    return v + turned * _alternating(angle2, 2, terms) + rotvec.cross(turned) * _alternating(angle2, 3, terms)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Quat:
    """A Hamilton quaternion, scalar first."""

    __array_ufunc__ = None

    w: Any
    x: Any
    y: Any
    z: Any

    @classmethod
    def identity(cls) -> Quat:
        """No rotation (float64 scalars)."""
        return cls(_one(), _zero(), _zero(), _zero())

    @classmethod
    def of(cls, array: Float[ArrayLike, "*shape 4"]) -> Quat:
        """Take the components from the last axis of an array."""
        a = jnp.asarray(array)
        return cls(a[..., 0], a[..., 1], a[..., 2], a[..., 3])

    @classmethod
    def exp(cls, rotvec: Vec3) -> Quat:
        """Quaternion of a rotation vector (rad)."""
        angle2 = rotvec.norm2()
        scale = _sinc_like(angle2, lambda a: jnp.sin(a / 2) / a, (1 / 2, -1 / 48, 1 / 3840))
        w = _sinc_like(angle2, lambda a: jnp.cos(a / 2), (1.0, -1 / 8, 1 / 384))
        return cls(w, rotvec.x * scale, rotvec.y * scale, rotvec.z * scale)

    @classmethod
    def turn(cls, rotvec: Vec3, slow: bool = False, terms: int = 14) -> Quat:
        """:meth:`exp` of at most one turn, several times faster: for increments.

        Args:
            rotvec: rad.
            slow: it is below 0.05 rad, as the Earth turns in ten minutes: fewer terms.
            terms: of the series; eight are exact to rounding up to a radian.
        """
        half = rotvec * 0.5
        square, terms = half.norm2(), 4 if slow else terms
        scale = _alternating(square, 1, terms)
        return cls(_alternating(square, 0, terms), half.x * scale, half.y * scale, half.z * scale)

    @property
    def array(self) -> Float[Array, "*shape 4"]:
        """The components on a last axis."""
        return jnp.stack(jnp.broadcast_arrays(self.w, self.x, self.y, self.z), axis=-1)

    @property
    def vector(self) -> Vec3:
        """The vector part."""
        return Vec3(self.x, self.y, self.z)

    def __mul__(self, other: Quat) -> Quat:
        p, q = self, other
        return Quat(
            p.w * q.w - p.x * q.x - p.y * q.y - p.z * q.z,
            p.w * q.x + p.x * q.w + p.y * q.z - p.z * q.y,
            p.w * q.y - p.x * q.z + p.y * q.w + p.z * q.x,
            p.w * q.z + p.x * q.y - p.y * q.x + p.z * q.w,
        )

    def __neg__(self) -> Quat:
        return Quat(-self.w, -self.x, -self.y, -self.z)

    def scale(self, factor: Any) -> Quat:
        """All four components times a number."""
        return Quat(self.w * factor, self.x * factor, self.y * factor, self.z * factor)

    def conjugate(self) -> Quat:
        """The inverse rotation."""
        return Quat(self.w, -self.x, -self.y, -self.z)

    def norm2(self) -> Any:
        """Squared norm."""
        return self.w * self.w + self.x * self.x + self.y * self.y + self.z * self.z

    def unit(self) -> Quat:
        """The rotation with norm one (a null quaternion becomes the identity)."""
        square = self.norm2()
        positive = square > 0
        factor = 1.0 / jnp.sqrt(jnp.where(positive, square, 1.0))
        q = self.scale(factor)
        return Quat(jnp.where(positive, q.w, 1.0), q.x, q.y, q.z)

    def renormalised(self) -> Quat:
        """One Newton step towards norm one: enough for the rounding of a product, without root or division."""
        return self.scale(1.5 - 0.5 * self.norm2())

    def positive(self) -> Quat:
        """The one of the pair q, -q with a non-negative scalar part."""
        return self.scale(jnp.where(self.w < 0, -1.0, 1.0))

    def rotate(self, v: Vec3) -> Vec3:
        """Map a vector: ``q v q*``."""
        u = self.vector
        t = u.cross(v) * 2.0
        return v + t * self.w + u.cross(t)

    def log(self) -> Vec3:
        """Rotation vector (rad), of angle at most pi."""
        q = self.positive()
        s2 = q.vector.norm2()
        small = s2 < _SMALL**2
        s = jnp.sqrt(jnp.where(small, 1.0, s2))
        w = jnp.where(small, q.w, 1.0)
        x = jnp.where(small, s2, 0.0) / w**2
        near = 2.0 / w * (1.0 - x * (1 / 3 - x * (1 / 5 - x / 7)))
        return q.vector * jnp.where(small, near, 2.0 * jnp.arctan2(s, jnp.where(small, 1.0, q.w)) / s)

    @property
    def matrix(self) -> Mat3:
        """Direction cosine matrix."""
        w, x, y, z = self.w, self.x, self.y, self.z
        return Mat3(
            Vec3(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            Vec3(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            Vec3(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )


@jax.tree_util.register_dataclass
@dataclass(frozen=True, slots=True)
class Mat3:
    """A 3x3 matrix as its three rows."""

    __array_ufunc__ = None

    r0: Vec3
    r1: Vec3
    r2: Vec3

    @classmethod
    def zero(cls) -> Mat3:
        """The null matrix (float64 scalars)."""
        return cls(Vec3.zero(), Vec3.zero(), Vec3.zero())

    @property
    def array(self) -> Float[Array, "*shape 3 3"]:
        """The matrix on two last axes."""
        return jnp.stack([self.r0.array, self.r1.array, self.r2.array], axis=-2)

    def __add__(self, other: Mat3) -> Mat3:
        return Mat3(self.r0 + other.r0, self.r1 + other.r1, self.r2 + other.r2)

    def __sub__(self, other: Mat3) -> Mat3:
        return Mat3(self.r0 - other.r0, self.r1 - other.r1, self.r2 - other.r2)

    def __mul__(self, scale: Any) -> Mat3:
        return Mat3(self.r0 * scale, self.r1 * scale, self.r2 * scale)

    __rmul__ = __mul__

    @property
    def trace(self) -> Any:
        """Sum of the diagonal."""
        return self.r0.x + self.r1.y + self.r2.z

    def map_rows(self, f: Any) -> Mat3:
        """Apply a vector function to each row."""
        return Mat3(f(self.r0), f(self.r1), f(self.r2))
