"""Bands in which a sample must lie."""

import jax
import jax.numpy as jnp
import numpy as np
from logs import with_noise
from scipy import stats

from jaxalign.rotation import attitude_error, quat_from_dcm
from jaxalign.simulate.faults import FixedOutliers


def assert_variance(x, sd):
    """The sample variance lies in the central 99.99 % of its distribution."""
    n = x.size
    low, high = stats.chi2.ppf([5e-5, 1 - 5e-5], n) / n
    assert low < np.mean(np.square(x / sd)) < high


def assert_rate(hits, trials, probability):
    """The number of hits lies in the central 99.99 % of the binomial distribution."""
    low, high = stats.binom.ppf([5e-5, 1 - 5e-5], trials, probability)
    assert low <= hits <= high


def outlying(made, share):
    """A scenario with a share of its fixes 300 (Doppler) or 200 (GNSS) times too noisy, the first like the others."""
    factor = 300.0 if made.aids[0].aid.kind == "body" else 200.0
    return with_noise(made, faults=(FixedOutliers(share, factor, False, "random"),))


@jax.jit
def phi_deg(q, dcm):
    """Attitude errors of many runs (runs, rows, 4) against the truth of their rows (rows, 3, 3)."""
    return jnp.rad2deg(attitude_error(q, jnp.broadcast_to(quat_from_dcm(dcm), q.shape)))
