"""Likelihood of the lateral offset from one frame: a Gaussian mixture with a uniform "cannot tell" share.

One frame is often ambiguous: each pair of lines that may be the corners gives another offset, and a picture may show
no corner at all. The mixture keeps all hypotheses, so that a filter can resolve them over time and motion. With
weights w_j whose sum is at most 1, the likelihood of the offset y in (-1, 1) is

    p(y) = (1 - sum_j w_j) / 2 + sum_j w_j N(y; m_j, s_j^2).

The remaining probability, ``1 - sum_j w_j``, is called "cannot tell": the frame carries no information. Two kinds of
evidence are combined by multiplying their likelihoods, which again gives a mixture (`combine`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, pi, sqrt

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled, compiled_inner
from vision.types import FloatArray

N_BINS = 64
"""Bins over (-1, 1); components in one bin are merged, so this is also the largest number of components."""

BOTH_MISLED = 0.05  # probability that a picture misleads both kinds of evidence
MIN_WEIGHT = 1e-4  # of a component; smaller ones are added to "cannot tell"
UNIFORM_DENSITY = 0.5  # of an unknown offset in (-1, 1)
MAX_PEAKS = 8  # large enough that narrow, higher peaks do not displace a wide one
MIN_PEAK = 0.01  # share of a density in a peak; smaller ones are added to "cannot tell"
PEAK_END = 0.02  # a peak ends where the density has fallen to this share of its maximum,
VALLEY_RISE = 1.2  # or rises again by this factor over the minimum
MIN_STD = 0.005
_SQRT_TWO_PI = sqrt(2.0 * pi)

# columns of components
WEIGHT, OFFSET, VARIANCE, WIDTH = range(4)


@dataclass(frozen=True, slots=True, eq=False)
class OffsetMixture:
    """Likelihood of the scale-free lateral offset from one frame: Gaussians and a "cannot tell" share.

    The likelihood of the offset y in (-1, 1) is ``(1 - sum(weight)) / 2 + sum_j weight_j N(offset_norm_j; y,
    std_norm_j^2)``.

    Parameters
    ----------
    weight
        (k,), not negative, their sum at most 1; the remainder is the probability that the frame cannot tell.
    offset_norm, std_norm
        (k,) means and standard deviations.
    width_per_height
        (k,) corridor width over camera height above the floor; NaN where the component does not give it.
    """

    weight: FloatArray
    offset_norm: FloatArray
    std_norm: FloatArray
    width_per_height: FloatArray

    def fields(self) -> FloatArray:
        """Return weight, offset, standard deviation and width as rows (4, k), the form used in compiled code."""
        return np.array([self.weight, self.offset_norm, self.std_norm, self.width_per_height])

    @property
    def cannot_tell(self) -> float:
        """Probability that the frame cannot tell."""
        return max(1.0 - float(self.weight.sum()), 0.0)

    def likelihood(self, offset_norm: npt.ArrayLike) -> FloatArray:
        """Likelihood of offsets (...) of any shape; 1/2, the uniform density, where the frame cannot tell."""
        y = np.asarray(offset_norm, dtype=float)[..., None]
        z = (y - self.offset_norm) / self.std_norm
        density = self.weight / self.std_norm * np.exp(-0.5 * z * z) / _SQRT_TWO_PI
        return np.asarray(UNIFORM_DENSITY * self.cannot_tell + density.sum(axis=-1))

    def wider(self, std_norm: float) -> OffsetMixture:
        """Return the mixture convolved with a Gaussian error of this standard deviation."""
        std = np.hypot(self.std_norm, std_norm)
        return OffsetMixture(self.weight, self.offset_norm, std, self.width_per_height)

    def less_sure(self, cannot_tell: float) -> OffsetMixture:
        """Return the mixture scaled so that "cannot tell" has at least this probability."""
        total_weight = float(self.weight.sum())
        if total_weight <= 1.0 - cannot_tell:
            return self
        scale = (1.0 - cannot_tell) / total_weight
        return OffsetMixture(self.weight * scale, self.offset_norm, self.std_norm, self.width_per_height)


def cannot_tell() -> OffsetMixture:
    """Return the mixture of a frame without any evidence: a uniform likelihood."""
    none = np.zeros(0)
    return OffsetMixture(none, none, none, none)


@compiled_inner
def merge_by_bins(rows: FloatArray, bins: FloatArray) -> int:
    """Merge components (n, 4) of weight, offset, variance and width, bin by bin, keeping mean and variance.

    Fills the first rows of ``bins`` (N_BINS, 4) in order of the offset and returns their number. Widths of NaN are
    left out of the mean; a merged width is NaN unless most of its weight has one.
    """
    n_bins = len(bins)
    square, width_weight = np.zeros(n_bins), np.zeros(n_bins)
    bins[:] = 0.0
    for k in range(len(rows)):
        weight, offset = rows[k, WEIGHT], rows[k, OFFSET]
        b = min(max(int((offset + 1.0) * 0.5 * n_bins), 0), n_bins - 1)
        bins[b, WEIGHT] += weight
        bins[b, OFFSET] += weight * offset
        square[b] += weight * (offset * offset + rows[k, VARIANCE])
        if isfinite(rows[k, WIDTH]):
            bins[b, WIDTH] += weight * rows[k, WIDTH]
            width_weight[b] += weight
    count = 0
    for b in range(n_bins):
        weight = bins[b, WEIGHT]
        if not weight > 0.0:
            continue
        offset = bins[b, OFFSET] / weight
        width = bins[b, WIDTH] / width_weight[b] if width_weight[b] > 0.5 * weight else np.nan
        bins[count, WEIGHT], bins[count, OFFSET] = weight, offset
        bins[count, VARIANCE], bins[count, WIDTH] = square[b] / weight - offset * offset, width
        count += 1
    return count


@compiled
def fields_of_components(components: FloatArray, cannot_tell_odds: float, min_variance: float) -> FloatArray:
    """Return the fields (4, k) of a mixture; parameters as in `mixture_of_components`."""
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
    """Build a mixture from components (n, 4), see `merge_by_bins`.

    Their weights are odds relative to ``cannot_tell_odds``; they are normalised to probabilities here.
    """
    return OffsetMixture(*fields_of_components(components, cannot_tell_odds, min_variance))


@compiled_inner
def _products(
    first: FloatArray, second: FloatArray, extra_variance: float, both_misled: float, rows: FloatArray
) -> float:
    """Multiply two likelihoods given as components (n, 4), (m, 4) into ``rows``; return the uniform part.

    With uniform parts u1, u2 the product has the terms u1 u2, u2 times the first's Gaussians, u1 times the second's,
    and all products of two Gaussians, which are Gaussians again. Rows and return value are integrals over (-1, 1).
    ``extra_variance`` is added to each component in the products; ``both_misled`` is the probability that both
    likelihoods are misleading.
    """
    n, m = len(first), len(second)
    cannot_tell_first, cannot_tell_second = 1.0, 1.0
    for i in range(n):
        cannot_tell_first -= first[i, WEIGHT]
    for j in range(m):
        cannot_tell_second -= second[j, WEIGHT]
    cannot_tell_first, cannot_tell_second = max(cannot_tell_first, 0.0), max(cannot_tell_second, 0.0)
    count = 0
    for i in range(n + m):
        row = first[i] if i < n else second[i - n]
        for column in range(row.shape[0]):
            rows[count, column] = row[column]
        rows[count, WEIGHT] *= 0.5 * (cannot_tell_second if i < n else cannot_tell_first)
        count += 1
    for i in range(n):
        a = first[i, VARIANCE] + extra_variance
        for j in range(m):
            b = second[j, VARIANCE] + extra_variance
            difference = first[i, OFFSET] - second[j, OFFSET]
            z = 0.5 * difference * difference / (a + b)
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
        rows[k, WEIGHT] *= 1.0 - both_misled
    return 0.5 * (both_misled + (1.0 - both_misled) * cannot_tell_first * cannot_tell_second)


@compiled_inner
def _components(fields: FloatArray) -> FloatArray:
    """Return the components (k, 4) of a mixture's fields (4, k), see `merge_by_bins`."""
    components = np.empty((fields.shape[1], 4))
    for k in range(len(components)):
        components[k, WEIGHT], components[k, OFFSET] = fields[0, k], fields[1, k]
        components[k, VARIANCE], components[k, WIDTH] = fields[2, k] ** 2, fields[3, k]
    return components


@compiled_inner
def peaks_of_density(density: FloatArray, centres: FloatArray, rows: FloatArray) -> int:
    """Split a sampled density into peaks, highest first, each up to where it rises again or ends.

    Fills rows (k, 5) with weight, mean, standard deviation, first bin and one past the last bin, and returns their
    number. ``density``, at offsets ``centres``, is overwritten.
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
        while first > 0 and PEAK_END * top < density[first - 1] <= VALLEY_RISE * low:
            first -= 1
            low = min(low, density[first])
        low = top
        while last + 1 < bins and PEAK_END * top < density[last + 1] <= VALLEY_RISE * low:
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


AGREEMENT_STD = 0.005
"""Standard deviation by which two kinds of evidence of the same corner may differ."""


@compiled
def fields_of_product(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the fields (4, k) of the product of two mixtures with fields (4, n), (4, m), see `combine`."""
    a, b = _components(first), _components(second)
    rows = np.empty((len(a) + len(b) + len(a) * len(b), 4))
    cannot_tell_odds = _products(a, b, AGREEMENT_STD**2, BOTH_MISLED, rows)
    return fields_of_components(rows, cannot_tell_odds, 0.0)


def combine(first: OffsetMixture, second: OffsetMixture) -> OffsetMixture:
    """Multiply the likelihoods by two independent kinds of evidence.

    Where both are sharp at one offset, so is the product. Where they are sharp at different offsets, each peak is
    weighted by the other's "cannot tell" share, and the probability that both are misleading gains weight.
    """
    return OffsetMixture(*fields_of_product(first.fields(), second.fields()))


__all__ = [
    "OffsetMixture",
    "cannot_tell",
    "combine",
    "merge_by_bins",
    "mixture_of_components",
    "peaks_of_density",
]
