"""From the tallies of the blocks to statistics over time, each with its Monte Carlo standard error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxalign.study.block_sums import BlockSums, bin_edges
from jaxalign.tables import Estimate

__all__ = ["AXES", "PERCENTILES", "MethodStatistics", "statistics_of"]

AXES = ("pitch", "roll", "yaw")
PERCENTILES = (50.0, 95.0, 99.0)


@dataclass(frozen=True)
class MethodStatistics:
    """One method over K read-outs and three angles (pitch, roll, yaw); errors are estimate minus truth, in degrees.

    Attributes:
        time_s: (K,).
        runs: how many.
        mean: (K, 3).
        rmse: (K, 3).
        percentiles: (P, K, 3) of the absolute error, P as in `PERCENTILES`; from bins 1.8 % wide. Their error is NaN
            where the runs are too few to tell.
        within: (K, 3) fraction of all runs whose absolute error is within the tolerance.
        undefined: (K,) fraction of the runs without an attitude (counted in no error).
        failed: (K,) fraction of the runs with a number that is not finite.
        end: (runs, 3) error of each run at the last read-out; NaN: none.
        window: (runs, 3) root mean square error of each run over the window; NaN: none.
        converged_s: (runs, 3) time from which on the run stays within the tolerance; infinite: never.
    """

    time_s: np.ndarray
    runs: int
    mean: Estimate
    rmse: Estimate
    percentiles: Estimate
    within: Estimate
    undefined: np.ndarray
    failed: np.ndarray
    end: np.ndarray
    window: np.ndarray
    converged_s: np.ndarray

    @property
    def accuracy(self) -> Estimate:
        """(3,) root mean square error over the window and the runs."""
        square = self.window**2
        good = np.isfinite(square)
        n = np.maximum(good.sum(axis=0), 1)
        mean = np.where(good, square, 0.0).sum(axis=0) / n
        spread = np.where(good, (square - mean) ** 2, 0.0).sum(axis=0) / np.maximum(n - 1, 1)
        return _root(np.where(good.any(axis=0), mean, np.nan), np.sqrt(spread / n))

    @property
    def convergence(self) -> Estimate:
        """(3,) median time of convergence of all runs, s; infinite where fewer than half of them converge.

        The error is at least half a read-out interval; infinite where it may well be that fewer than half converge.
        """
        ordered = np.sort(self.converged_s, axis=0)
        low, mid, high = (
            ordered[min(max(int(np.ceil(q * self.runs)) - 1, 0), self.runs - 1)]
            for q in (0.5 - 0.5 / np.sqrt(self.runs), 0.5, 0.5 + 0.5 / np.sqrt(self.runs))
        )
        step = np.diff(self.time_s, prepend=0.0).max()  # times fall on read-outs
        with np.errstate(invalid="ignore"):
            error = np.where(np.isfinite(high), np.maximum((high - low) / 2, step / 2), np.inf)
        return Estimate(mid, np.where(np.isfinite(mid), error, np.nan))

    @property
    def share_converged(self) -> Estimate:
        """(3,) fraction of the runs that end within the tolerance."""
        return _share(np.isfinite(self.converged_s).sum(axis=0), self.runs)

    def ratio(self, other: MethodStatistics) -> Estimate:
        """(3,) `accuracy` over that of another method on the same runs, its error from the paired runs."""
        one, two = self.window**2, other.window**2
        good = np.isfinite(one) & np.isfinite(two)
        n = np.maximum(good.sum(axis=0), 2)
        a, b = (np.where(good, x, 0.0).sum(axis=0) / n for x in (one, two))
        with np.errstate(invalid="ignore", divide="ignore"):
            relative = np.where(good, one / a - two / b, 0.0)
            ratio = np.sqrt(a / b)
        spread = np.sqrt((relative**2).sum(axis=0) / (n - 1) / n)
        return Estimate(ratio, ratio * spread / 2)


def statistics_of(time_s: np.ndarray, runs: int, blocks: BlockSums) -> MethodStatistics:
    """Statistics of all blocks (first axis of the leaves; `bins` already summed) of a method."""
    total, square, fourth = (np.add.reduce(x, axis=0) for x in (blocks.total, blocks.square, blocks.fourth))
    known, failed, within = (np.add.reduce(x, axis=0) for x in (blocks.known, blocks.failed, blocks.within))
    n = known[:, None].astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, mean_square = total / n, square / n
        variance = np.maximum(mean_square - mean**2, 0.0) * n / (n - 1)
        spread = np.maximum(fourth / n - mean_square**2, 0.0) / (n - 1)
        end, window, converged = (
            np.concatenate(x, axis=0)[:runs] for x in (blocks.end, blocks.window, blocks.converged)
        )
        return MethodStatistics(
            time_s=time_s,
            runs=runs,
            mean=Estimate(mean, np.sqrt(variance / n)),
            rmse=_root(mean_square, np.sqrt(spread)),
            percentiles=_percentiles(np.asarray(blocks.bins), known),
            within=_share(within, runs),
            undefined=1.0 - known / runs,
            failed=failed / runs,
            end=end,
            window=np.sqrt(window),
            converged_s=converged,
        )


def _root(square: np.ndarray, error: np.ndarray) -> Estimate:
    """Root of an estimate."""
    root = np.sqrt(square)
    return Estimate(root, np.where(root > 0, error / (2 * np.where(root > 0, root, 1.0)), 0.0))


def _share(count: np.ndarray, runs: int) -> Estimate:
    """A share; its error is that of the posterior of a uniform prior: not zero where all or none are counted."""
    likely = (count + 1) / (runs + 2)
    return Estimate(count / runs, np.sqrt(likely * (1 - likely) / (runs + 3)))


def _percentiles(bins: np.ndarray, known: np.ndarray) -> Estimate:
    """Percentiles of the absolute errors, interpolated within their bins, and their errors by the order statistics."""
    edges, size = bin_edges(), bins.shape[-1]
    count = known[:, None].astype(float)
    middle = np.array(PERCENTILES)[:, None, None] / 100.0
    half = np.sqrt(middle * (1 - middle) / np.maximum(count, 1))
    rank = np.stack([middle + 0 * half, np.minimum(middle + half, 1.0), np.maximum(middle - half, 0.0)]) * count
    # All rows are searched at once: of the bins those that hold some, counted on in whole numbers (nothing rounds).
    counts = bins.ravel()
    held = np.append(np.flatnonzero(counts), counts.size - 1)
    line = np.concatenate([[0], np.cumsum(counts[held], dtype=np.int64)])
    row = np.arange(counts.size // size).reshape(bins.shape[:-1])
    before = line[np.searchsorted(held, size * row)]
    wanted = before + np.ceil(rank).astype(np.int64)
    at_least = np.minimum(np.searchsorted(line[1:], wanted), len(held) - 1)
    place = np.where(wanted > before, np.clip(held[at_least] - size * row, 0, size - 1), 0)
    inside = counts[place + size * row]
    below = np.where(wanted > before, line[at_least] - before, 0)
    part = np.clip((rank - below) / np.maximum(inside, 1), 0.0, 1.0)
    at, high, low = np.where(count > 0, edges[place] + part * (edges[place + 1] - edges[place]), np.nan)
    return Estimate(at, np.where(middle + half <= 1.0, (high - low) / 2, np.nan))  # NaN: too few runs to tell
