"""The scenarios of the published simulations by name, with the options that their studies vary."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxalign.aids import BodyVelocity, Heading, NavVelocity, NonHolonomic
from jaxalign.arguments import check_choice, nearest
from jaxalign.earth import STANDARD_GRAVITY, Site
from jaxalign.errors import UserError
from jaxalign.inertial_unit import AccelErrors, GyroErrors, ImuErrors
from jaxalign.log import Log
from jaxalign.precision import require_x64
from jaxalign.simulate import motions
from jaxalign.simulate.aid import SimulatedAid
from jaxalign.simulate.arguments import leaf, parsed
from jaxalign.simulate.faults import AbstractFault, FixedOutliers, Gap, JumpOutliers, SegmentOutliers
from jaxalign.simulate.imu import Truth
from jaxalign.simulate.measurement import Scenario, log_of, truth
from jaxalign.simulate.sensors import BiasKind, SineForce
from jaxalign.simulate.trajectory import Trajectory

__all__ = ["scenario", "scenario_options", "scenarios", "simulate"]

Gaps = Sequence[tuple[float, float]]


def _site_deg(lat: float, lon: float, h: float = 0.0) -> Site:
    return Site(np.deg2rad(lat), np.deg2rad(lon), h)


def _gaps(gaps: Any) -> tuple[AbstractFault, ...]:
    try:
        pairs = [(float(start), float(stop)) for start, stop in gaps]
    except (TypeError, ValueError) as error:
        raise UserError(f"gaps: expected pairs of times such as ((30, 40), (90, 100)), got {gaps!r}") from error
    return tuple(Gap(start, stop) for start, stop in pairs)


def _dvl_faults(outliers: str, factor: float, single_axis: bool, first: Any, gaps: Gaps) -> tuple[AbstractFault, ...]:
    check_choice("outliers", outliers, ("none", "fixed", "segment"))
    check_choice("single_axis", single_axis, (False, True))
    found: dict[str, tuple[AbstractFault, ...]] = {
        "none": (),
        "fixed": (FixedOutliers(0.02, factor, single_axis, first),),
        "segment": (SegmentOutliers(single_axis=single_axis, first=first),),
    }
    return found[outliers] + _gaps(gaps)


def _dvl_xu2020(trajectory: Trajectory, name: str, bias: BiasKind, duration: float, faults: Any) -> Scenario:
    """The sensors of Xu et al. (2020), section IV-A."""
    return Scenario(
        trajectory,
        _site_deg(32.057313, 118.786365),
        imu=ImuErrors(GyroErrors(0.02, walk_deg_sqrt_h=0.005), AccelErrors(50.0, density_ug_sqrt_hz=50.0)),
        bias=bias,
        aids=(SimulatedAid(BodyVelocity(), 0.1, faults),),
        duration=duration,
        imu_rate=200.0,
        epoch_samples=200,
        name=name,
    )


def _dvl_sturn(
    outliers: str = "none",
    single_axis: bool = False,
    first: str = "never",
    gaps: Gaps = (),
    bias: BiasKind = "sign",
    duration: float = 300.0,
) -> Scenario:
    """DVL (1 Hz, 0.1 m/s), S-turns at 5 m/s, IMU 200 Hz of 0.02 deg/h and 50 ug.

    Xu et al. (2020), section IV-A: 0.005 deg/sqrt(h), 50 ug/sqrt(Hz); fixed outliers 2 %, 300 times (41);
    segment outliers as in Shen et al. (2025), Table 3. The paper shows its trajectory as a figure only.
    """
    faults = _dvl_faults(outliers, 300.0, single_axis, first, gaps)
    return _dvl_xu2020(motions.s_turn(), "dvl-sturn", bias, duration, faults)


def _dvl_sway(
    outliers: str = "none",
    single_axis: bool = False,
    first: str = "never",
    gaps: Gaps = (),
    bias: BiasKind = "sign",
    duration: float = 300.0,
) -> Scenario:
    """DVL (1 Hz, 0.1 m/s) in a seaway: 10 deg coning at 0.15 Hz, 2 m/s; the sensors of dvl-sturn.

    Not from a paper: shows what integrating a whole DVL interval without coning and sculling terms costs.
    """
    faults = _dvl_faults(outliers, 300.0, single_axis, first, gaps)
    return _dvl_xu2020(motions.sway_underway(), "dvl-sway", bias, duration, faults)


def _dvl_accturn(
    outliers: str = "none",
    single_axis: bool = False,
    first: str = "never",
    gaps: Gaps = (),
    bias: BiasKind = "sign",
    duration: float = 300.0,
) -> Scenario:
    """DVL (5 Hz, 0.05 m/s), changes of speed, turns and a dive, IMU 100 Hz of 0.01 deg/h and 100 ug.

    Shen et al. (2025), Table 1: 0.001 deg/sqrt(h), 10 ug/sqrt(Hz); fixed outliers 2 %, 200 times; segment
    outliers of Table 3. The paper shows its trajectory as figures only; the site is that of Xu et al. (2020).
    """
    return Scenario(
        motions.accelerate_and_turn(),
        _site_deg(32.057313, 118.786365),
        imu=ImuErrors(GyroErrors(0.01, walk_deg_sqrt_h=0.001), AccelErrors(100.0, density_ug_sqrt_hz=10.0)),
        bias=bias,
        aids=(SimulatedAid(BodyVelocity(), 0.05, _dvl_faults(outliers, 200.0, single_axis, first, gaps)),),
        duration=duration,
        imu_rate=100.0,
        epoch_samples=20,
        name="dvl-accturn",
    )


def _gps_zigzag(
    sway: bool = False,
    outliers: str = "none",
    first: str = "never",
    gaps: Gaps = (),
    bias: BiasKind = "sign",
    duration: float = 250.0,
) -> Scenario:
    """GNSS velocity (1 Hz, 1 m/s), a car's zigzag at 10 m/s, IMU 100 Hz of 0.01 deg/h and 10 ug.

    Huang et al., Tables II and III: 0.01 deg/sqrt(h), 100 ug/sqrt(Hz). `sway` lets the attitude swing about
    the course. Outliers "jump" (not in the paper): 2 % of the fixes off by 20-50 m/s in a random direction.
    """
    check_choice("outliers", outliers, ("none", "jump"))
    check_choice("sway", sway, (False, True))
    jumps = (JumpOutliers(first=first),) if outliers == "jump" else ()  # pyright: ignore[reportArgumentType]
    return Scenario(
        motions.zigzag(sway),
        _site_deg(32.0, 118.0),
        imu=ImuErrors(GyroErrors(0.01, walk_deg_sqrt_h=0.01), AccelErrors(10.0, density_ug_sqrt_hz=100.0)),
        bias=bias,
        aids=(SimulatedAid(NavVelocity(), 1.0, jumps + _gaps(gaps)),),
        duration=duration,
        imu_rate=100.0,
        epoch_samples=100,
        name="gps-zigzag",
    )


def _car(
    heading_sd_deg: float = 0.0, gaps: Gaps = (), bias: BiasKind = "gaussian", duration: float = 300.0
) -> Scenario:
    """Odometer (10 Hz, 0.05 m/s), wheels that do not slip, a car in town, IMU 100 Hz of 0.01 deg/h and 50 ug.

    Not from a paper: slip of 0.05 m/s, 0.002 deg/sqrt(h), 20 ug/sqrt(Hz). No GNSS. `heading_sd_deg` above zero adds a
    heading at 1 Hz with that noise and an offset that each run draws with 3 deg.
    """
    forward = BodyVelocity(components=("forward",), name="odometer")
    aids = [SimulatedAid(forward, 0.05, _gaps(gaps)), SimulatedAid(NonHolonomic(), 0.05)]
    noise = leaf(heading_sd_deg, "heading_sd_deg", low=0.0)
    if float(noise) > 0:
        offset = {"offset": np.deg2rad(3.0)}
        aids.append(SimulatedAid(Heading(), jnp.deg2rad(noise), unknown_sd=offset, stride=10))
    return Scenario(
        motions.road(),
        _site_deg(48.1, 11.6, 500.0),
        imu=ImuErrors(GyroErrors(0.01, walk_deg_sqrt_h=0.002), AccelErrors(50.0, density_ug_sqrt_hz=20.0)),
        bias=bias,
        aids=tuple(aids),
        duration=duration,
        imu_rate=100.0,
        epoch_samples=10,
        name="car",
    )


def _sway(mean_yaw_deg: float = 0.0, bias: BiasKind = "fixed", duration: float = 600.0) -> Scenario:
    """No aid: a moored ship swaying by 10 deg, IMU 100 Hz of 0.05 deg/h and 500 ug, epochs of 0.1 s.

    Xu et al. (2017), Tables 1 and 2; the "random" errors of Table 2 are taken as standard deviations per
    sample, the constant ones as equal on the three axes, as printed. The latitude, lost in the text of the
    paper, is 32.0573 deg.
    """
    return Scenario(
        motions.swaying_base(leaf(mean_yaw_deg, "mean_yaw_deg")),
        _site_deg(32.0573, 118.7864),
        imu=ImuErrors(GyroErrors(0.05, noise_deg_h=0.05), AccelErrors(500.0, noise_ug=500.0)),
        bias=bias,
        duration=duration,
        imu_rate=100.0,
        epoch_samples=10,
        name="sway",
    )


_CONDITIONS: dict[int, tuple[float, float, float, float, bool]] = {
    # gyro bias and noise (deg/h), accelerometer bias and noise (ug), disturbed
    1: (0.1, 0.05, 50.0, 50.0, False),
    2: (0.1, 0.05, 50.0, 50.0, True),
    3: (0.02, 0.01, 10.0, 20.0, False),
    4: (0.02, 0.01, 10.0, 20.0, True),
}


def _disturbed(
    condition: int = 2,
    amplitude_mg: float | None = None,
    noise_per: str = "sample",
    bias: BiasKind = "sign",
    duration: float = 300.0,
) -> Scenario:
    """No aid: a vehicle at rest whose accelerometers are shaken at 1-50 Hz, IMU 200 Hz, epochs of 0.1 s.

    The Vondrak paper, section 6, Table 2: conditions 1 and 2 (0.1 deg/h, 50 ug), 3 and 4 (0.02 deg/h, 10 ug);
    2 and 4 with the sum of sines (28), whose amplitude "Bias" is the accelerometer bias unless `amplitude_mg`
    is given. `noise_per`: the numbers of Table 2 per "sample" (as printed) or as a "density" (per sqrt(Hz),
    as in Tables 3 and 4). Attitude (pitch 1, roll -0.5, yaw 30 deg) and height (400 m) are not stated there.
    """
    check_choice("condition", condition, _CONDITIONS)
    check_choice("noise_per", noise_per, ("sample", "density"))
    gyro_bias, gyro_noise, accel_bias, accel_noise, shaken = _CONDITIONS[condition]
    if amplitude_mg is not None and not shaken:
        raise UserError(f"amplitude_mg: condition {condition} is undisturbed; use condition 2 or 4")
    if noise_per == "sample":
        gyro = GyroErrors(gyro_bias, noise_deg_h=gyro_noise)
        accel = AccelErrors(accel_bias, noise_ug=accel_noise)
    else:
        gyro = GyroErrors(gyro_bias, walk_deg_sqrt_h=gyro_noise / 60.0)
        accel = AccelErrors(accel_bias, density_ug_sqrt_hz=accel_noise)
    force = None
    if shaken:
        literal = SineForce(accel_bias * STANDARD_GRAVITY * 1e-6)
        force = literal if amplitude_mg is None else SineForce.of_mg(amplitude_mg)
    return Scenario(
        motions.static_base(1.0, -0.5, 30.0),
        _site_deg(37.6, 108.6, 400.0),
        imu=ImuErrors(gyro, accel),
        bias=bias,
        force=force,
        duration=duration,
        imu_rate=200.0,
        epoch_samples=20,
        name=f"disturbed-{condition}",
    )


_SCENARIOS: dict[str, Callable[..., Scenario]] = {
    "dvl-sturn": _dvl_sturn,
    "dvl-accturn": _dvl_accturn,
    "dvl-sway": _dvl_sway,
    "gps-zigzag": _gps_zigzag,
    "car": _car,
    "sway": _sway,
    "disturbed": _disturbed,
}


def scenarios() -> dict[str, str]:
    """Names of the scenarios, with one line on each."""
    return {name: (inspect.getdoc(build) or "").splitlines()[0] for name, build in _SCENARIOS.items()}


def _builder(name: Any) -> Callable[..., Scenario]:
    if not isinstance(name, str) or name not in _SCENARIOS:
        raise UserError(f"unknown scenario {name!r}; {nearest(str(name), _SCENARIOS)}")
    return _SCENARIOS[name]


def scenario_options(name: str) -> dict[str, Any]:
    """Options of a named scenario and their defaults.

    Raises:
        UserError: for an unknown name.
    """
    return {key: p.default for key, p in inspect.signature(_builder(name)).parameters.items()}


def scenario(name: str, /, **options: Any) -> Scenario:
    """A scenario by its name.

    - ``dvl-sturn``, ``dvl-accturn``, ``dvl-sway``: `outliers` "none" | "fixed" | "segment"; `single_axis`
      outliers; whether epoch 0 may be one (`first` "never" | "random" | "always"); `gaps`, pairs of times (s)
      without aid.
    - ``car``: `heading_sd_deg`; `gaps` of the odometer.
    - ``gps-zigzag``: `sway` of the attitude; `outliers` "none" | "jump"; `first`; `gaps`.
    - ``sway``: `mean_yaw_deg`.
    - ``disturbed``: `condition` 1-4; `amplitude_mg`; `noise_per` "sample" | "density".
    - all: `bias` "sign" | "gaussian" | "fixed" (see `draw_bias`); `duration` (s).

    Args:
        name: one of `scenarios()`.
        **options: as above; `scenario_options(name)` gives the defaults. Strings are parsed where a number, a
            truth value or a list is expected ("2", "true", "[[30, 40]]").

    Raises:
        UserError: for an unknown name, option or value, naming the nearest known ones.
    """
    require_x64()
    build = _builder(name)
    known = scenario_options(name)
    for key in options:
        if key not in known:
            raise UserError(f"scenario {name!r} has no option {key!r}; {nearest(key, known)}")
    options = {key: parsed(value, known[key]) for key, value in options.items()}
    if "duration" in options:
        seconds = leaf(options["duration"], "duration", low=0.0)
        if seconds.ndim:
            raise UserError(f"duration: must be one number, got {options['duration']!r}")
        options["duration"] = float(seconds)
    return build(**options)


def simulate(name: str | Scenario, seed: int, noise: bool = True, truth_of: Truth | None = None, **options: Any) -> Log:
    """A simulated log with its true attitude.

    Args:
        name: the name of a scenario, or a `Scenario`.
        seed: of the run; the same seed gives the same log.
        noise: False for perfect sensors (gaps, jumps and the disturbance of the base stay).
        truth_of: the truth of this scenario, if it is at hand (see `truth`): saves computing it again.
        **options: of the named scenario, see `scenario`.

    Raises:
        UserError: for an unknown name or option, a seed that is not a whole number, or a foreign truth.
    """
    if isinstance(name, Scenario):
        if options:
            raise UserError(f"options {', '.join(options)} go with a scenario's name, not with a Scenario")
        chosen = name
    else:
        chosen = scenario(name, **options)
    return log_of(chosen, truth(chosen) if truth_of is None else truth_of, seed, noise)
