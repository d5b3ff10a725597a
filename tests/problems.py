"""Short problems for the contract suite: 60 epochs spread over the whole of a scenario, so that compiling is the
cost."""

import functools

import numpy as np

from jaxalign import Epochs, Site, epochs_from_arrays
from jaxalign.methods import RECIPES, build
from jaxalign.simulate import scenario, simulate

# (recipe, aid): every recipe with every aid that it takes. A new recipe is a new row here by itself.
ROWS = [(name, aid) for name, recipe in RECIPES.items() for aid in recipe.aids]
SCENARIOS = {"body": "dvl-sturn", "nav": "gps-zigzag", "static": "sway"}
EPOCHS = 60


def log_of(aid: str, seed: int = 1, noise: bool = True):
    return _log_of(aid, seed, noise)


@functools.cache
def _log_of(aid: str, seed: int, noise: bool):
    options = {"duration": 300.0} if aid == "static" else {}
    return simulate(scenario(SCENARIOS[aid], **options), seed, noise=noise)


def epochs_of(aid: str, seed: int = 1, noise: bool = True, velocity=None, lat=None) -> Epochs:
    """The scenario's log at 60 epochs; the velocities or the latitude may be replaced (also by tracers)."""
    log = log_of(aid, seed, noise)
    every = len(log.dtheta) // EPOCHS // log.aid_every * log.aid_every
    used = every * EPOCHS
    if velocity is None and aid != "static":
        velocity = velocities(aid, seed, noise)
    return epochs_from_arrays(
        log.dtheta[:used],
        log.dvel[:used],
        velocity,
        dt=log.dt,
        every=every,
        site=Site(log.lat if lat is None else lat, log.lon, log.h),
        aid=aid,
        aid_sd=log.aid_sd or 1e-3,
    )


def velocities(aid: str, seed: int = 1, noise: bool = True) -> np.ndarray:
    log = log_of(aid, seed, noise)
    every = len(log.dtheta) // EPOCHS // log.aid_every
    return log.velocity[::every][: EPOCHS + 1]


@functools.cache
def method_of(name: str, aid: str):
    return build(name, aid)


def sparse(name: str) -> int:
    """Epochs between rows where one row will do: each row of the batch estimator goes over all epochs."""
    return EPOCHS // 3 if name == "robust_map" else 1


def solver(every: int = 1):
    """What align() runs: compiled once per structure, for all tests of a process."""
    return lambda method, epochs: method.solve(epochs, every)
