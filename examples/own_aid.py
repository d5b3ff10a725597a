"""An aid of one's own: air speed along the nose, in a steady wind that the forecast gives to 1 m/s.

    python -m examples.own_aid

The class below is all that the library needs: the aid is simulated in a scenario, bounded, and taken by ``robust_map``.
"""

from __future__ import annotations

import dataclasses

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import jaxalign as ja  # noqa: E402
from jaxalign.aids import Axes, Unknown  # noqa: E402
from jaxalign.simulate import Scenario, SimulatedAid, scenario, simulate  # noqa: E402


class AirSpeed(ja.AbstractAid):
    """Speed through the air along the nose, m/s; the wind (east, north) less the forecast is unknown."""

    components = ("nose",)
    unknowns = (Unknown("wind", 2, 1.0, "m/s", always=True),)

    def predict(self, motion, unknowns):
        """Of the velocity in n (m/s) less the wind, the part along the forward axis."""
        east, north = unknowns["wind"]
        air = motion.velocity - ja.Vec3(east, north, 0.0 * east)
        return air.dot(motion.axes[1])

    def velocity(self, values):
        """A guess to start from: no wind; right and up it does not tell."""
        return Axes.BODY, (None, values[0], None)


def flight() -> Scenario:
    """A zigzag at 10 m/s with an air speed of 0.3 m/s, each run in another wind (1 m/s), and a good inertial unit.

    Air speed cannot tell a wind from a drift: the velocity stays as open as the wind. What an error of the velocity
    does to the place the estimator leaves out: 0.002 deg of roll after 250 s at 1 m/s, but 0.01 deg at 5 m/s.
    """
    unit = ja.ImuErrors(ja.GyroErrors(0.01, 0.001), ja.AccelErrors(10.0, 10.0))
    wind = SimulatedAid(AirSpeed(), sd=0.3, unknown_sd={"wind": 1.0})
    return dataclasses.replace(scenario("gps-zigzag"), aids=(wind,), imu=unit, bias="gaussian", name="flight")


def main() -> None:
    """Align one flight, and say what the best estimator could do."""
    made = flight()
    log = simulate(made, seed=1)
    method = dataclasses.replace(ja.build("robust_map", AirSpeed()), imu=made.imu)
    found = ja.align(method, log, every=50)
    least = ja.bound(made)
    print("time s  heading deg  its sd deg  least sd deg")
    for k in range(1, len(found.time)):
        row = int(np.searchsorted(np.asarray(least.time), float(found.time[k]) - 1e-6))
        bound = float(least.euler_deg[row, 2])
        print(f"{found.time[k]:6.0f}  {found.heading_deg[k]:11.2f}  {found.euler_sd_deg[k, 2]:10.2f}  {bound:12.2f}")
    true = np.rad2deg(np.arctan2(log.C_nb[-1][0, 1], log.C_nb[-1][1, 1])) % 360.0
    print(f"true heading at the end: {true:.2f} deg")


if __name__ == "__main__":
    main()
