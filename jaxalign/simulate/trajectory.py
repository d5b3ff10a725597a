"""A trajectory: attitude and velocity as analytic functions of time, from which everything else follows."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxalign.aids import Axes
from jaxalign.simulate.signals import AbstractSignal, Constant
from jaxalign.vector import Quat, Vec3

__all__ = ["AbstractVelocity", "CourseVelocity", "Trajectory", "VelocityInBody", "VelocityInNav"]


class AbstractVelocity(eqx.Module):
    """Velocity over the Earth as a function of time, in b or in n (`axes`)."""

    axes: ClassVar[Axes]

    @abstractmethod
    def __call__(self, t: Any) -> Vec3:
        """Velocity (m/s) at the times t (s), in `axes`."""

    @property
    def signals(self) -> tuple[AbstractSignal, ...]:
        """The signals it is made of (for their break points)."""
        return tuple(
            s
            for s in jax.tree.leaves(self, is_leaf=lambda x: isinstance(x, AbstractSignal))
            if isinstance(s, AbstractSignal)
        )


class VelocityInBody(AbstractVelocity):
    """Velocity given in b (m/s): the natural way for a vehicle that a DVL or an odometer aids."""

    axes = Axes.BODY
    right: AbstractSignal
    forward: AbstractSignal
    up: AbstractSignal

    def __call__(self, t: Any) -> Vec3:
        """Velocity (m/s, b) at the times t (s)."""
        return Vec3(self.right(t), self.forward(t), self.up(t))


class VelocityInNav(AbstractVelocity):
    """Velocity given in n (m/s)."""

    axes = Axes.NAV
    east: AbstractSignal
    north: AbstractSignal
    up: AbstractSignal

    def __call__(self, t: Any) -> Vec3:
        """Velocity (m/s, n) at the times t (s)."""
        return Vec3(self.east(t), self.north(t), self.up(t))


class CourseVelocity(AbstractVelocity):
    """Level velocity in n of a speed (m/s) along a course (rad, from north, counter-clockwise like yaw)."""

    axes = Axes.NAV
    speed: AbstractSignal
    course: AbstractSignal

    def __call__(self, t: Any) -> Vec3:
        """Velocity (m/s, n) at the times t (s)."""
        speed, course = self.speed(t), self.course(t)
        return Vec3(-speed * jnp.sin(course), speed * jnp.cos(course), jnp.zeros_like(speed))


class Trajectory(eqx.Module):
    """Attitude C_nb = Rz(yaw) Rx(pitch) Ry(roll) and velocity as functions of time.

    All methods are pure, elementwise in the time and differentiable in it and in the leaves.

    Attributes:
        pitch: rad.
        roll: rad.
        yaw: rad, counter-clockwise from north.
        velocity: m/s in b or in n; a vehicle at rest by default.
    """

    pitch: AbstractSignal
    roll: AbstractSignal
    yaw: AbstractSignal
    velocity: AbstractVelocity = eqx.field(
        default_factory=lambda: VelocityInNav(Constant(0.0), Constant(0.0), Constant(0.0))
    )

    @property
    def breaks(self) -> tuple[Any, ...]:
        """Times (s) at which a slope jumps: they must fall on boundaries between IMU samples."""
        signals = (self.pitch, self.roll, self.yaw, *self.velocity.signals)
        return tuple(sorted({b for s in signals for b in s.breaks}))

    def euler(self, t: Any) -> Vec3:
        """(pitch, roll, yaw) in rad at the times t (s)."""
        return Vec3(self.pitch(t), self.roll(t), self.yaw(t))

    def attitude(self, t: Any) -> Quat:
        """q_nb at the times t (s)."""
        half = self.euler(t) * 0.5
        zero = jnp.zeros_like(half.x)
        return (
            Quat(jnp.cos(half.z), zero, zero, jnp.sin(half.z))
            * Quat(jnp.cos(half.x), jnp.sin(half.x), zero, zero)
            * Quat(jnp.cos(half.y), zero, jnp.sin(half.y), zero)
        )

    def velocity_n(self, t: Any) -> Vec3:
        """Velocity over the Earth in n (m/s) at the times t (s)."""
        v = self.velocity(t)
        return v if self.velocity.axes is Axes.NAV else self.attitude(t).rotate(v)

    def velocity_b(self, t: Any) -> Vec3:
        """Velocity over the Earth in b (m/s) at the times t (s)."""
        v = self.velocity(t)
        return v if self.velocity.axes is Axes.BODY else self.attitude(t).conjugate().rotate(v)

    def rate_nb(self, t: Any) -> Vec3:
        """Rotation w_nb of b against n (rad/s, in b) at the times t (s), from the Euler rates."""
        e, rate = _differentiate(self.euler, t)
        sp, cp, sr, cr = jnp.sin(e.x), jnp.cos(e.x), jnp.sin(e.y), jnp.cos(e.y)
        return Vec3(
            rate.x * cr - rate.z * cp * sr,
            rate.y + rate.z * sp,
            rate.x * sr + rate.z * cp * cr,
        )

    def motion_n(self, t: Any) -> tuple[Vec3, Vec3]:
        """Velocity in n (m/s) and its derivative (m/s^2) at the times t (s)."""
        return _differentiate(self.velocity_n, t)


def _differentiate(f: Any, t: Any) -> tuple[Vec3, Vec3]:
    """Value and time derivative of an elementwise function of time."""
    return jax.jvp(f, (t,), (jnp.ones_like(t),))
