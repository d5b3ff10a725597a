"""The frozen cases: how to read one, and the constants that it was made with."""

import functools
import json
from pathlib import Path

import numpy as np
from logs import log_of

from jaxalign import Log, Site
from jaxalign.earth import normal_gravity
from jaxalign.epochs import Epochs
from jaxalign.front_end import epochs_from_arrays, epochs_from_log

ARCSEC_DEG = 1 / 3600


@functools.cache
def case(shared: Path, name: str):
    """Arrays of a case and its log (unchecked: some cases are a few samples of noise-free data)."""
    with np.load(shared / "cases" / f"{name}.npz") as z:
        arrays = {key: z[key] for key in z.files}
    return arrays, log_of(
        dtheta=arrays["dtheta"],
        dvel=arrays["dvel"],
        dt=float(arrays["dt_imu"]),
        epoch_samples=int(arrays["aid_every"]),
        aid=str(arrays["aid_frame"]),
        velocity=arrays["aid_v"],
        lat=float(arrays["lat"]),
        lon=float(arrays["lon"]),
        h=float(arrays["h"]),
        aid_sd=0.1,
        name=name,
    )


def gravity_of_the_cases(lat: float, h: float) -> float:
    """The cases were made with another normal gravity formula (2e-6 off WGS-84)."""
    s = np.sin(lat) ** 2
    return 9.7803267714 * (1 + 5.27094e-3 * s + 2.32718e-5 * s * s) - 3.086e-6 * h


def epochs(log: Log, scheme, method) -> Epochs:
    """Epochs for a method with the front end and the gravity of the case."""
    site = Site(log.lat, log.lon, log.h, gravity_of_the_cases(log.lat, log.h) - float(normal_gravity(log.lat, log.h)))
    samples = method.front_end.interval_samples
    if samples and method.standing:
        return epochs_from_arrays(
            log.dtheta,
            log.dvel,
            None,
            dt=log.dt,
            every=samples,
            site=site,
            aid="static",
            scheme=scheme,
        )
    made = epochs_from_log(log, scheme=scheme, aids=method.aids)
    import equinox as eqx

    return eqx.tree_at(lambda e: e.site, made, site)


def parameters_of(arrays, name: str) -> dict:
    return json.loads(str(arrays[f"params_{name}"]))
