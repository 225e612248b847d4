"""Evidence of one frame for the lateral offset, as a sum of Gaussians.

A frame seldom leaves one answer: of every pair of lines that could be the corners one offset follows, and a picture
may show no corner at all. A mixture keeps all of it, so that a filter can let time and motion decide.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, pi, sqrt

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled, compiled_inner
from vision.types import FloatArray

N_BINS = 64
"""Components nearer to each other than a bin of this grid over (-1, 1) become one; so many are left at most."""

BOTH_BLIND = 0.05  # probability that a picture misleads both kinds of evidence
MIN_WEIGHT = 1e-4  # of a component; less is left to "cannot tell"
UNIFORM_DENSITY = 0.5  # density of an offset in (-1, 1) of which nothing is known
MAX_PEAKS = 8  # the narrow ones, which are higher, must not crowd out a wide one
MIN_PEAK = 0.01  # weight of a peak of a density; less is left to "cannot tell"
FOOT = 0.02  # a peak ends where the density has fallen to this share of it,
RISE = 1.2  # or rises so far above its lowest
MIN_STD = 0.005
_SQRT_TWO_PI = sqrt(2.0 * pi)

# columns of components
WEIGHT, OFFSET, VARIANCE, WIDTH = range(4)


@dataclass(frozen=True, slots=True, eq=False)
class OffsetMixture:
    """What one frame says about the scale-free lateral offset: Gaussians, and a share that says "cannot tell".

    The likelihood of the offset y in (-1, 1) is ``(1 - sum(weight)) / 2 + sum_j weight_j N(offset_norm_j; y,
    std_norm_j^2)``.

    Parameters
    ----------
    weight
        (k,), not negative, their sum at most 1; what is left over is the probability that the frame cannot tell.
    offset_norm, std_norm
        (k,) means and standard deviations.
    width_per_height
        (k,) corridor width over camera height above the floor; NaN where the component does not tell.
    """

    weight: FloatArray
    offset_norm: FloatArray
    std_norm: FloatArray
    width_per_height: FloatArray

    def fields(self) -> FloatArray:
        """Return weight, offset, standard deviation and width as rows (4, k), as compiled code takes them."""
        return np.array([self.weight, self.offset_norm, self.std_norm, self.width_per_height])

    @property
    def cannot_tell(self) -> float:
        """Probability that the frame cannot tell."""
        return max(1.0 - float(self.weight.sum()), 0.0)

    def likelihood(self, offset_norm: npt.ArrayLike) -> FloatArray:
        """Likelihood of offsets (...) of any shape; where the frame cannot tell it is 1/2, as over (-1, 1) any is."""
        y = np.asarray(offset_norm, dtype=float)[..., None]
        z = (y - self.offset_norm) / self.std_norm
        density = self.weight / self.std_norm * np.exp(-0.5 * z * z) / _SQRT_TWO_PI
        return np.asarray(UNIFORM_DENSITY * self.cannot_tell + density.sum(axis=-1))

    def wider(self, std_norm: float) -> OffsetMixture:
        """Return the mixture with an independent error of this standard deviation added to every component."""
        std = np.hypot(self.std_norm, std_norm)
        return OffsetMixture(self.weight, self.offset_norm, std, self.width_per_height)

    def less_sure(self, cannot_tell: float) -> OffsetMixture:
        """Return the mixture with at least this probability that the frame cannot tell."""
        told = float(self.weight.sum())
        if told <= 1.0 - cannot_tell:
            return self
        scale = (1.0 - cannot_tell) / told
        return OffsetMixture(self.weight * scale, self.offset_norm, self.std_norm, self.width_per_height)


def cannot_tell() -> OffsetMixture:
    """Return what a frame without any evidence says."""
    none = np.zeros(0)
    return OffsetMixture(none, none, none, none)


@compiled_inner
def merge_by_bins(rows: FloatArray, bins: FloatArray) -> int:
    """Merge components (n, 4) of weight, offset, variance and width, bin by bin, keeping mean and variance.

    Fills the first rows of ``bins`` (N_BINS, 4) in order of the offset and returns how many; a width of NaN counts
    for nothing, and a component has one where most of its weight does.
    """
    n_bins = len(bins)
    square, told = np.zeros(n_bins), np.zeros(n_bins)
    bins[:] = 0.0
    for k in range(len(rows)):
        weight, offset = rows[k, WEIGHT], rows[k, OFFSET]
        b = min(max(int((offset + 1.0) * 0.5 * n_bins), 0), n_bins - 1)
        bins[b, WEIGHT] += weight
        bins[b, OFFSET] += weight * offset
        square[b] += weight * (offset * offset + rows[k, VARIANCE])
        if isfinite(rows[k, WIDTH]):
            bins[b, WIDTH] += weight * rows[k, WIDTH]
            told[b] += weight
    count = 0
    for b in range(n_bins):
        weight = bins[b, WEIGHT]
        if not weight > 0.0:
            continue
        offset = bins[b, OFFSET] / weight
        width = bins[b, WIDTH] / told[b] if told[b] > 0.5 * weight else np.nan
        bins[count, WEIGHT], bins[count, OFFSET] = weight, offset
        bins[count, VARIANCE], bins[count, WIDTH] = square[b] / weight - offset * offset, width
        count += 1
    return count


@compiled
def fields_of_components(components: FloatArray, cannot_tell_odds: float, min_variance: float) -> FloatArray:
    """Return the fields (4, k) of a mixture; parameters as of `mixture_of_components`."""
    bins = np.empty((N_BINS, 4))
    n, total, count = merge_by_bins(components, bins), cannot_tell_odds, 0
    for k in range(n):
        total += bins[k, WEIGHT]
    for k in range(n):
        count += bins[k, WEIGHT] / total > MIN_WEIGHT
    fields = np.empty((4, count))
    count = 0
    for k in range(n):
        weight = bins[k, WEIGHT] / total
        if weight > MIN_WEIGHT:
            fields[0, count], fields[1, count] = weight, bins[k, OFFSET]
            fields[2, count], fields[3, count] = sqrt(max(bins[k, VARIANCE], min_variance)), bins[k, WIDTH]
            count += 1
    return fields


def mixture_of_components(
    components: FloatArray, cannot_tell_odds: float, min_variance: float
) -> OffsetMixture:
    """Make a mixture of components (n, 4) as `merge_by_bins` takes them.

    Their weights are odds, as ``cannot_tell_odds`` are those of a frame that cannot tell.
    """
    return OffsetMixture(*fields_of_components(components, cannot_tell_odds, min_variance))


@compiled_inner
def _products(
    first: FloatArray, second: FloatArray, slack: float, both_blind: float, rows: FloatArray
) -> float:
    """Multiply two likelihoods given as components (n, 4), (m, 4) into ``rows``; return what is alike everywhere.

    Rows and return value are weights: the integral over (-1, 1). ``slack`` is the variance that each has besides,
    ``both_blind`` the probability that neither tells anything though both seem to.
    """
    n, m = len(first), len(second)
    blind_first, blind_second = 1.0, 1.0
    for i in range(n):
        blind_first -= first[i, WEIGHT]
    for j in range(m):
        blind_second -= second[j, WEIGHT]
    blind_first, blind_second = max(blind_first, 0.0), max(blind_second, 0.0)
    count = 0
    for i in range(n + m):
        row = first[i] if i < n else second[i - n]
        for column in range(row.shape[0]):
            rows[count, column] = row[column]
        rows[count, WEIGHT] *= 0.5 * (blind_second if i < n else blind_first)
        count += 1
    for i in range(n):
        a = first[i, VARIANCE] + slack
        for j in range(m):
            b = second[j, VARIANCE] + slack
            apart = first[i, OFFSET] - second[j, OFFSET]
            z = 0.5 * apart * apart / (a + b)
            weight = 0.0
            if z < 30.0:
                weight = first[i, WEIGHT] * second[j, WEIGHT] * exp(-z) / sqrt(2.0 * np.pi * (a + b))
            row = rows[count]
            count += 1
            row[WEIGHT] = weight
            row[OFFSET] = (b * first[i, OFFSET] + a * second[j, OFFSET]) / (a + b)
            row[VARIANCE] = a * b / (a + b)
            row[WIDTH] = first[i, WIDTH] if isfinite(first[i, WIDTH]) else second[j, WIDTH]
    for k in range(count):
        rows[k, WEIGHT] *= 1.0 - both_blind
    return 0.5 * (both_blind + (1.0 - both_blind) * blind_first * blind_second)


@compiled_inner
def _components(fields: FloatArray) -> FloatArray:
    """Return the components (k, 4) of a mixture's fields (4, k), as `merge_by_bins` takes them."""
    components = np.empty((fields.shape[1], 4))
    for k in range(len(components)):
        components[k, WEIGHT], components[k, OFFSET] = fields[0, k], fields[1, k]
        components[k, VARIANCE], components[k, WIDTH] = fields[2, k] ** 2, fields[3, k]
    return components


@compiled_inner
def peaks_of_density(density: FloatArray, centres: FloatArray, rows: FloatArray) -> int:
    """Take peak after peak out of a density, each down to where it rises again or ends.

    Fills rows (k, 5) with weight, mean, standard deviation, first bin and the one after the last, and returns how
    many; ``density``, at offsets ``centres``, is used up.
    """
    total, bins = density.sum(), len(density)
    count = 0
    while count < len(rows):
        peak = int(np.argmax(density))
        top = density[peak]
        if not top > 0.0:
            break
        first = last = peak
        low = top
        while first > 0 and FOOT * top < density[first - 1] <= RISE * low:
            first -= 1
            low = min(low, density[first])
        low = top
        while last + 1 < bins and FOOT * top < density[last + 1] <= RISE * low:
            last += 1
            low = min(low, density[last])
        weight = mean = square = 0.0
        for k in range(first, last + 1):
            weight += density[k]
            mean += density[k] * centres[k]
            square += density[k] * centres[k] ** 2
            density[k] = 0.0
        if weight < MIN_PEAK * total:
            break
        mean /= weight
        rows[count, 0], rows[count, 1] = weight, mean
        rows[count, 2] = sqrt(max(square / weight - mean * mean, MIN_STD**2))
        rows[count, 3], rows[count, 4] = first, last + 1
        count += 1
    return count


SLACK = 0.005
"""Standard deviation by which two kinds of evidence may differ that see the same corner."""


@compiled
def fields_of_both(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the fields (4, k) of the mixture that two mixtures' fields (4, n), (4, m) make, see `combine`."""
    a, b = _components(first), _components(second)
    rows = np.empty((len(a) + len(b) + len(a) * len(b), 4))
    blind = _products(a, b, SLACK**2, BOTH_BLIND, rows)
    return fields_of_components(rows, blind, 0.0)


def combine(first: OffsetMixture, second: OffsetMixture) -> OffsetMixture:
    """Return what two independent kinds of evidence say together: the product of their likelihoods.

    Where both are sure of one place, so is the product. Where they are sure of different places, each place is held
    up only by the other's "cannot tell", and the probability that both are wrong counts for more: the answer is wide.
    """
    return OffsetMixture(*fields_of_both(first.fields(), second.fields()))


__all__ = [
    "OffsetMixture",
    "cannot_tell",
    "combine",
    "merge_by_bins",
    "mixture_of_components",
    "peaks_of_density",
]
