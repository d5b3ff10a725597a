"""Short problems for the contract suite: 60 epochs spread over the whole of a scenario, so that compiling is the
cost."""

import functools

import numpy as np

from jaxalign import Epochs, Site, epochs_from_arrays
from jaxalign.methods import RECIPES, build
from jaxalign.recipes import Contract
from jaxalign.simulate import scenario, simulate

# (recipe, aid): every recipe with every aid that it takes, but those that do not work. A new recipe is a new row here
# by itself, and is held to what its contract says (jaxalign/recipes.py).
ROWS = [(name, aid.kind) for name, recipe in RECIPES.items() for aid in recipe.aids if recipe.contract]
OWN = [(name, aid) for name, aid in ROWS if not RECIPES[name].published]
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
    every = len(log.dtheta) // EPOCHS // log.epoch_samples * log.epoch_samples
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
        aid_sd=log.aids[0].sd if log.aids else 1e-3,
    )


def velocities(aid: str, seed: int = 1, noise: bool = True) -> np.ndarray:
    log = log_of(aid, seed, noise)
    every = len(log.dtheta) // EPOCHS // log.epoch_samples
    return log.aids[0].value[::every][: EPOCHS + 1]


@functools.cache
def method_of(name: str, aid: str):
    return build(name, aid)


def contract_of(name: str) -> Contract:
    return RECIPES[name].contract


def sparse(name: str) -> int:
    """Epochs between rows where one row will do, of a method whose rows go over all epochs each."""
    return EPOCHS // 3 if build(name).rows_are_costly else 1


def solver(every: int = 1):
    """What align() runs: compiled once per structure, for all tests of a process."""
    return lambda method, epochs: method.solve(epochs, every)
