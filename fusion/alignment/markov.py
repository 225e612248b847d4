"""Least squares whose errors are correlated from sample to sample.

Each residual is white noise plus a first-order Markov process (the gyroscope's drift, the error of an attitude
filter): one process along a chain of samples, a new one in each chain. With white variances V and the process's
tridiagonal precision P, everything follows from the Cholesky factor of ``A = P + V^-1`` at a cost proportional to the
number of samples:

    S^-1 = V^-1 - V^-1 A^-1 V^-1        log |S| = log |A| + log |V| - log |P|

Both sizes of noise are found from the residuals by restricted maximum likelihood (Patterson and Thompson, "Recovery
of inter-block information when block sizes are unequal", Biometrika 58, 1971), so the covariance of the fit includes
the correlation, and no sensor accuracies need to be given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, pi

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

START_VARIANCE = (2.0 * pi) ** 2  # of a process with an arbitrary start
OUTLIER_SIGMA = 2.5  # beyond it, a sample is down-weighted
GROSS_SIGMA = 7.0  # beyond it, a sample is rejected
DROPPED = 1e-6
LOG_RANGE = 9.0  # the noise is searched within e**+-9 of the start value
N_REWEIGHTINGS = 4
SMALLEST_STEP = 1e-6  # of the white variance; a smaller process is negligible and ill-conditioned
BEYOND = 1e12  # cost of impossible values


@dataclass(frozen=True, slots=True, eq=False)
class Process:
    """A first-order Markov process along chains: ``x[k] = phi[k] x[k-1] + w[k]``, var w[k] = ``variance[k]``.

    ``phi`` is zero where a chain begins.
    """

    phi: FloatArray
    variance: FloatArray

    @classmethod
    def walk(cls, t_s: FloatArray, chain: IntArray, density: float) -> Process:
        """Random walk with an arbitrary start; ``density`` in units per square root of a second."""
        goes_on, step_s = _steps(t_s, chain)
        return cls(goes_on.astype(float), np.where(goes_on, density**2 * step_s, START_VARIANCE))

    @classmethod
    def stationary(cls, t_s: FloatArray, chain: IntArray, std: float, time_s: float) -> Process:
        """Process of a standard deviation and a correlation time.

        Parameters
        ----------
        t_s, chain
            Times (n,), ascending within a chain, and the number (n,) of the chain that each belongs to.
        std, time_s
            Stationary standard deviation, and correlation time.
        """
        goes_on, step_s = _steps(t_s, chain)
        phi = np.where(goes_on, np.exp(-step_s / time_s), 0.0)
        return cls(phi, std**2 * np.maximum(1.0 - phi**2, 1e-9))


def _steps(t_s: FloatArray, chain: IntArray) -> tuple[npt.NDArray[np.bool_], FloatArray]:
    goes_on = np.zeros(len(t_s), bool)
    goes_on[1:] = chain[1:] == chain[:-1]
    step_s = np.ones(len(t_s))
    step_s[1:] = np.maximum(np.diff(t_s), 1e-6)
    return goes_on, step_s


class Noise:
    """Covariance of the residuals: white variances (n,) and a process."""

    def __init__(self, white: FloatArray, process: Process) -> None:
        self.white = white
        phi, step = process.phi, process.variance
        self._diagonal = 1.0 / step + 1.0 / white
        self._diagonal[:-1] += phi[1:] ** 2 / step[1:]
        self._above = np.zeros(len(white))
        self._above[1:] = -phi[1:] / step[1:]
        self._factor = cholesky_banded(np.stack([self._above, self._diagonal]), check_finite=False)
        self.log_determinant = float(
            2.0 * np.log(self._factor[1]).sum() + np.log(white).sum() + np.log(step).sum()
        )

    def whiten(self, values: FloatArray) -> FloatArray:
        """Multiply (n,) or (n, k) by the inverse covariance."""
        scaled = (values.T / self.white).T
        inner = cho_solve_banded((self._factor, False), scaled, check_finite=False)
        return np.asarray(scaled - (inner.T / self.white).T)

    def process_of(self, residual: FloatArray) -> FloatArray:
        """Return the most probable process (n,), given the residuals."""
        return np.asarray(cho_solve_banded((self._factor, False), residual / self.white, check_finite=False))

    def standardised(self, residual: FloatArray) -> FloatArray:
        """Normalised leave-one-out residuals (n,): each against its prediction from all others."""
        return np.asarray(self.whiten(residual) / np.sqrt(np.maximum(self._whitener_diagonal(), 1e-300)))

    def process_trace(self) -> float:
        """Trace of the process's covariance times the inverse of the whole: the weight of a copy of it in a fit."""
        return float(np.sum(1.0 - self.white * self._whitener_diagonal()))

    def _whitener_diagonal(self) -> FloatArray:
        """Diagonal (n,) of the inverse covariance."""
        return np.asarray(1.0 / self.white - self._inverse_diagonal() / self.white**2)

    def _inverse_diagonal(self) -> FloatArray:
        """Diagonal of the inverse of A, from the pivots of eliminating forwards and backwards."""
        forward = _pivots(self._diagonal, self._above[1:])
        backward = _pivots(self._diagonal[::-1], self._above[:0:-1])[::-1]
        return np.asarray(1.0 / (forward + backward - self._diagonal))


def _pivots(diagonal: FloatArray, beside: FloatArray) -> FloatArray:
    pivots = diagonal.tolist()
    for k, b in enumerate((beside * beside).tolist(), start=1):
        pivots[k] -= b / pivots[k - 1]
    return np.array(pivots)


@dataclass(frozen=True, slots=True, eq=False)
class LineFit:
    """A linear fit: values (k,), covariance (k, k), and residuals.

    Parameters
    ----------
    values, covariance
        Of the coefficients.
    residual
        (n,)
    noise
        As found.
    weight
        (n,) 1 for good samples, less for outliers.
    white_scale, process_size
        Factor on the white variances; the process's size.
    """

    values: FloatArray
    covariance: FloatArray
    residual: FloatArray
    noise: Noise
    weight: FloatArray
    white_scale: float
    process_size: float


MakeProcess = Callable[[float], Process]


def solve(
    design: FloatArray, target: FloatArray, noise: Noise, instrument: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Coefficients (k,) and covariance (k, k) of ``target ~ design @ values``.

    Parameters
    ----------
    design, target
        Regressors (n, k) and target (n,).
    noise
        Covariance of the residuals.
    instrument
        Instrumental variables (n, k), if the design is noisy; None: the design itself.
    """
    left = noise.whiten(design if instrument is None else instrument)
    inverse = np.linalg.pinv(left.T @ design, rcond=1e-13)
    return inverse @ (left.T @ target), 0.5 * (inverse + inverse.T)


def fit_lines(
    design: FloatArray, target: FloatArray, white: FloatArray, make: MakeProcess, size: float
) -> LineFit:
    """Fit ``target (n,) ~ design (n, k) @ values`` robustly, and estimate the noise.

    Parameters
    ----------
    design, target
        Regressors (n, k) and target (n,).
    white
        Variances (n,) as the measurement states them; the fit finds their common factor.
    make
        Process of a given size.
    size
        Start value of the size.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the samples do not determine the fit.
    """
    weight, scale = first_weights(design, target, white, make(size)), 1.0
    for _ in range(N_REWEIGHTINGS):
        scale, size = find_noise(design, target, white / weight, make, scale, size)
        noise = Noise(scale * white / weight, make(size))
        values, covariance = solve(design, target, noise)
        residual = target - design @ values
        weight = np.maximum(weights(noise, residual, weight), DROPPED)
    return LineFit(values, covariance, residual, noise, weight, scale, size)


def first_weights(design: FloatArray, target: FloatArray, white: FloatArray, process: Process) -> FloatArray:
    """Weights (n,) before the noise is known, from deviations relative to the samples' median.

    Parameters
    ----------
    design, target
        Regressors (n, k) and target (n,).
    white
        White variances (n,) as stated.
    process
        First guess of the process.
    """
    weight = np.ones(len(target))
    for _ in range(N_REWEIGHTINGS):
        noise = Noise(white / weight, process)
        values, _ = solve(design, target, noise)
        z = np.abs(noise.standardised(target - design @ values)) / np.sqrt(weight)
        z /= max(1.48 * float(np.median(z)), 1.0)
        weight = np.clip(np.where(z > GROSS_SIGMA, 0.0, OUTLIER_SIGMA / np.maximum(z, 1e-12)), DROPPED, 1.0)
    return weight


def weights(noise: Noise, residual: FloatArray, weight: FloatArray) -> FloatArray:
    """Weights (n,) by Huber's rule, 0 for gross outliers; ``weight`` already inflates the noise."""
    # relative to its inflated variance, an outlier would regain full weight
    z = np.abs(noise.standardised(residual)) / np.sqrt(weight)
    return np.where(z > GROSS_SIGMA, 0.0, np.minimum(1.0, OUTLIER_SIGMA / np.maximum(z, 1e-12)))


def find_noise(
    design: FloatArray,
    target: FloatArray,
    white: FloatArray,
    make: MakeProcess,
    scale: float,
    size: float,
) -> tuple[float, float]:
    """Find the factor on the white variances and the size of the process by restricted maximum likelihood.

    Parameters
    ----------
    design, target
        Regressors (n, k) and target (n,).
    white
        White variances (n,) as stated.
    make
        Process of a given size.
    scale, size
        Start values.
    """
    from scipy.optimize import minimize  # slow to import, needed only here

    typical = float(np.median(white))

    def cost(logs: FloatArray) -> float:
        if np.abs(logs).max() > LOG_RANGE:
            return BEYOND
        process = make(size * exp(logs[1]))
        if float(np.median(process.variance)) < SMALLEST_STEP * scale * exp(logs[0]) * typical:
            return BEYOND
        try:
            noise = Noise(scale * exp(logs[0]) * white, process)
            return negative_log_likelihood(design, target, noise)
        except (LinAlgError, np.linalg.LinAlgError):
            return BEYOND

    start = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.7]])
    found = minimize(
        cost,
        start[0],
        method="Nelder-Mead",
        options={"initial_simplex": start, "xatol": 0.03, "fatol": 0.02, "maxfev": 120},
    )
    return scale * exp(found.x[0]), size * exp(found.x[1])


def negative_log_likelihood(design: FloatArray, target: FloatArray, noise: Noise) -> float:
    """Return the negative restricted log-likelihood of the noise, up to a constant."""
    whitened = noise.whiten(np.column_stack([design, target]))
    normal, right = design.T @ whitened[:, :-1], design.T @ whitened[:, -1]
    sign, log_normal = np.linalg.slogdet(normal)
    if sign <= 0.0:
        return BEYOND
    misfit = float(target @ whitened[:, -1] - right @ np.linalg.solve(normal, right))
    return 0.5 * (noise.log_determinant + float(log_normal) + misfit)
