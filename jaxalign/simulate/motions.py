"""The trajectories of the published simulations, and the vehicle at rest.

Angles are given in degrees here because the papers do; everything returned holds rad. Where a paper shows
only a figure or leaves a number open, the docstring says what was chosen.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from jaxalign.simulate.signals import AbstractSignal, Constant, Ramps, Sines, Steps
from jaxalign.simulate.trajectory import CourseVelocity, Trajectory, VelocityInBody

__all__ = ["accelerate_and_turn", "road", "s_turn", "static_base", "sway_underway", "swaying_base", "zigzag"]


def _sines_deg(*terms: tuple[float, float, float], mean: Any = 0.0) -> Sines:
    """Sines of (amplitude deg, period s, phase rad)."""
    amplitude, period, phase = zip(*terms, strict=True)
    return Sines(
        jnp.deg2rad(jnp.asarray(amplitude)),
        1.0 / jnp.asarray(period),
        jnp.asarray(phase),
        jnp.deg2rad(jnp.asarray(mean)),
    )


def s_turn(speed: Any = 5.0) -> Trajectory:
    """S-turns at constant speed, with slow pitch and roll and small waves.

    Velocity (0, speed, 0) in b; in degrees, yaw -45 + 45 sin(2 pi t/100), pitch
    1 sin(2 pi t/50) + 0.5 sin(2 pi t/7 + 0.4), roll 3 sin(2 pi t/100 + 0.3) + 0.7 sin(2 pi t/8 + 1).
    Stands for the simulation of Xu et al. (2020), which does not give its trajectory.

    Args:
        speed: forward, m/s.
    """
    return Trajectory(
        pitch=_sines_deg((1.0, 50.0, 0.0), (0.5, 7.0, 0.4)),
        roll=_sines_deg((3.0, 100.0, 0.3), (0.7, 8.0, 1.0)),
        yaw=_sines_deg((45.0, 100.0, 0.0), mean=-45.0),
        velocity=VelocityInBody(Constant(0.0), Constant(speed), Constant(0.0)),
    )


def accelerate_and_turn() -> Trajectory:
    """Changes of speed, three turns, a dive and banks, on top of small waves.

    Forward speed 2 -> 5 -> 3 -> 4.5 m/s at 40, 150 and 240 s; turns of -90, +120 and -60 deg at 90, 190 and
    265 s; a dive of 3 deg from 100 to 140 s; banks of 3 deg in the first two turns; waves of 1 deg
    (7 s, pitch) and 1.5 deg (9 s, roll). Every change is a tanh. Stands for the simulation of Shen et al.
    (2025), whose trajectory (accelerations, turns, steady motion) is given only as a figure.
    """
    deg = jnp.deg2rad
    dive = Steps(deg(jnp.array([-3.0, 3.0])), [100.0, 140.0], 4.0)
    bank = Steps(deg(jnp.array([3.0, -3.0, -3.0, 3.0])), [82.0, 98.0, 180.0, 200.0], 4.0)
    turns = Steps(deg(jnp.array([-90.0, 120.0, -60.0])), [90.0, 190.0, 265.0], [8.0, 10.0, 6.0], deg(40.0))
    return Trajectory(
        pitch=_sines_deg((1.0, 7.0, 0.0)) + dive,
        roll=_sines_deg((1.5, 9.0, 0.7)) + bank,
        yaw=turns,
        velocity=VelocityInBody(Constant(0.0), Steps([3.0, -2.0, 1.5], [40.0, 150.0, 240.0], 6.0, 2.0), Constant(0.0)),
    )


def zigzag(sway: bool = False) -> Trajectory:
    """A car's zigzag on the level: start, right turn, straight on, left turn.

    0.5 m/s^2 from rest to 10 m/s in 0-20 s, a right turn of 4 deg/s in 40-60 s, a left turn of 4 deg/s in
    160-180 s; pitch and roll 3 deg, yaw 10 deg at the start; the velocity points along the course.
    Huang et al., Table II, read without time gaps and with 4 deg/s for the printed 4 rad/s.

    Args:
        sway: add pitch 2 deg (7 s), roll 5 deg (9 s) and yaw 1.5 deg (11 s); the course does not sway.
    """
    deg = jnp.deg2rad
    course = Ramps(deg(jnp.array([-4.0, 4.0])), [40.0, 160.0], [60.0, 180.0], deg(10.0))
    pitch: AbstractSignal = Constant(deg(3.0))
    roll: AbstractSignal = Constant(deg(3.0))
    yaw: AbstractSignal = course
    if sway:
        pitch = _sines_deg((2.0, 7.0, 0.0), mean=3.0)
        roll = _sines_deg((5.0, 9.0, 0.0), mean=3.0)
        yaw = course + _sines_deg((1.5, 11.0, 0.0))
    return Trajectory(pitch, roll, yaw, CourseVelocity(Ramps(0.5, 0.0, 20.0), course))


def road() -> Trajectory:
    """A car in town: it stands for 10 s, drives up to 14 m/s, turns at corners and stops twice for 20 s.

    Hills of 2 deg, a body that leans by 1 deg in turns; the velocity is along the forward axis: the wheels do not slip.
    """
    deg = jnp.deg2rad
    turns = Steps(deg(jnp.array([-90.0, 80.0, -120.0, 60.0])), [45.0, 85.0, 170.0, 235.0], 3.0, deg(25.0))
    speed = Ramps(
        jnp.array([1.4, -1.4, 1.4, -1.75, 1.5, -0.8]),
        [10.0, 60.0, 90.0, 130.0, 160.0, 215.0],
        [20.0, 70.0, 100.0, 138.0, 168.0, 222.5],
    )
    return Trajectory(
        pitch=_sines_deg((2.0, 60.0, 0.0), (0.3, 4.0, 0.5)),
        roll=Steps(deg(jnp.array([1.0, -1.0, -1.0, 1.0, 1.0, -1.0])), [43.0, 47.0, 83.0, 87.0, 168.0, 172.0], 2.0),
        yaw=turns,
        velocity=VelocityInBody(Constant(0.0), speed, Constant(0.0)),
    )


def swaying_base(mean_yaw_deg: Any = 0.0) -> Trajectory:
    """A moored ship that only rotates: pitch 10 deg 0.2 Hz, roll 12 deg 0.125 Hz, yaw 6 deg 0.15 Hz.

    Xu et al. (2017), Table 1 (phases and centres zero).

    Args:
        mean_yaw_deg: centre of the yaw sway; 0 in the paper, which hides errors that show at other headings.
    """
    return Trajectory(
        pitch=_sines_deg((10.0, 1 / 0.2, 0.0)),
        roll=_sines_deg((12.0, 1 / 0.125, 0.0)),
        yaw=_sines_deg((6.0, 1 / 0.15, 0.0), mean=mean_yaw_deg),
    )


def sway_underway(speed: Any = 2.0) -> Trajectory:
    """Under way in a seaway that makes coarse integration fail.

    Pitch and roll 10 deg at 0.15 Hz in quadrature (a true coning motion), yaw 5 deg at 0.1 Hz, forward
    `speed` plus wave velocities of 0.3 m/s (right), 0.2 m/s (forward) and 0.5 m/s (up) at 0.15 Hz.

    Args:
        speed: mean, forward, m/s.
    """
    wave = 0.15
    return Trajectory(
        pitch=_sines_deg((10.0, 1 / wave, 0.0)),
        roll=_sines_deg((10.0, 1 / wave, jnp.pi / 2)),
        yaw=_sines_deg((5.0, 10.0, 0.0)),
        velocity=VelocityInBody(Sines(0.3, wave, 0.5), Sines(0.2, wave, 1.2, speed), Sines(0.5, wave, jnp.pi / 2)),
    )


def static_base(pitch_deg: Any = 0.0, roll_deg: Any = 0.0, yaw_deg: Any = 0.0) -> Trajectory:
    """A vehicle at rest.

    Args:
        pitch_deg: deg.
        roll_deg: deg.
        yaw_deg: deg, counter-clockwise from north.
    """
    deg = jnp.deg2rad
    return Trajectory(Constant(deg(pitch_deg)), Constant(deg(roll_deg)), Constant(deg(yaw_deg)))
