"""Divides the candidates of a row into bins with equal probability under the prior.

The number of bins of a candidate is proportional to its share, at least one. A bin is represented by its expected position, so the mean
over all bins of a row is the expected position of its keypoint.
"""

from dataclasses import dataclass

import numpy as np

from .schemes import Candidates

#: Log probability of padding bins.
NEVER = -1e9


@dataclass(frozen=True)
class Bins:
    """`[N, B]`; rows with fewer bins repeat their last position."""

    #: Expected position of each bin, pixels. `[N, B, 2]`
    places: np.ndarray
    #: Log probability of each bin under the prior.
    guess: np.ndarray
    #: Number of bins of each row. `[N]`
    counts: np.ndarray
    #: Number of bins of each candidate. `[N, S]`
    of_candidate: np.ndarray
    candidates: Candidates

    def normalized(self, size: tuple[int, int]) -> np.ndarray:
        """Positions as shares of the longer side, with the image centre at one half. `[N, B, 2]` float32"""
        size = np.asarray(size, dtype=np.float64)
        return ((self.places - size / 2.0) / size.max() + 0.5).astype(np.float32)

    def holding(self, keypoints: np.ndarray) -> np.ndarray:
        """The bin that holds each keypoint, or the nearest one; -1 for a row with one bin. `[N]`"""
        c = self.candidates
        t = ((keypoints[:, None] - c.origin) * c.direction).sum(axis=-1)
        empty = c.empty()
        near, far = np.where(empty, 0.0, c.near), np.where(empty, 0.0, c.far)
        t = np.clip(t, near, far)
        distance = np.linalg.norm(c.at(t) - keypoints[:, None], axis=-1)
        chosen = np.argmin(np.where(empty, np.inf, distance), axis=1)
        row = np.arange(len(chosen))
        near, far, t = near[row, chosen], far[row, chosen], t[row, chosen]
        growth, count = c.growth[row, chosen], self.of_candidate[row, chosen]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = mass(near, t, growth) / mass(near, far, growth)
        inside = np.where(share > 0.0, share * count, 0.0).astype(np.int64)
        before = np.cumsum(self.of_candidate, axis=1)[row, chosen] - count
        bins = before + np.minimum(inside, count - 1)
        return np.where((self.counts < 2) | empty.all(axis=1), -1, bins)


def mass(near: np.ndarray, far: np.ndarray, growth: np.ndarray) -> np.ndarray:
    """Probability of an interval, up to a factor."""
    return (far - near) * (growth[..., 0] + growth[..., 1] * 0.5 * (near + far))


def cut(candidates: Candidates, count: int = 64) -> Bins:
    """About `count` bins for each row, and one bin for each line that misses the image."""
    rows, stretches = candidates.near.shape
    empty = candidates.empty()
    near = np.where(empty, 0.0, candidates.near)
    far = np.where(empty, 0.0, candidates.far)
    share = candidates.share / candidates.share.sum(axis=1, keepdims=True)
    own = np.where(far > near, np.maximum(np.floor(share * count + 0.5), 1), 1).astype(np.int64)
    counts = own.sum(axis=1)
    places = np.zeros((rows, counts.max(initial=1), 2))
    guess = np.full(places.shape[:2], NEVER)
    for stretch in range(stretches):
        before = own[:, :stretch].sum(axis=1)
        most = own[:, stretch].max(initial=1)
        k = np.arange(most)[None]  # [1, most]
        held = k < own[:, stretch, None]
        ends = [quantile(candidates, near, far, stretch, (k + i) / own[:, stretch, None]) for i in (0, 1)]
        a, b = ends
        growth = candidates.growth[:, stretch]
        t = expected(a, b, growth[:, 0, None], growth[:, 1, None])
        at = candidates.origin[:, stretch, None] + t[..., None] * candidates.direction[:, stretch, None]
        row, column = np.nonzero(held)
        places[row, before[row] + column] = at[row, column]
        guess[row, before[row] + column] = np.log(share[row, stretch] / own[row, stretch])
    last = places[np.arange(rows), counts - 1]
    padding = np.arange(places.shape[1])[None] >= counts[:, None]
    places[padding] = np.repeat(last, padding.sum(axis=1), axis=0)
    return Bins(places, guess.astype(np.float32), counts, own, candidates)


def quantile(c: Candidates, near: np.ndarray, far: np.ndarray, stretch: int, share: np.ndarray) -> np.ndarray:
    """Quantiles `[N, K]` of an interval: the density is linear, so its integral is quadratic."""
    near, far, growth = near[:, stretch, None], far[:, stretch, None], c.growth[:, stretch]
    slope = growth[:, 1, None]
    first = growth[:, 0, None] + slope * near
    share = np.clip(share, 0.0, 1.0)
    wanted = share * mass(near, far, growth[:, None])
    root = np.sqrt(np.maximum(first * first + 2.0 * slope * wanted, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = near + 2.0 * wanted / (first + root)
    t = np.where(np.isfinite(t), t, near + share * (far - near))
    return np.clip(t, near, far)


def expected(a: np.ndarray, b: np.ndarray, offset: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """The expected position between `a` and `b`."""
    middle = 0.5 * (a + b)
    whole = (b - a) * (offset + slope * middle)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(whole > 0.0, middle + slope * (b - a) ** 3 / (12.0 * whole), middle)
