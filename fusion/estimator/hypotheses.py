"""Who is wrong, where frames and prediction part? Takes what the sources say, returns probabilities; changes nothing.

Innovations of a filter whose model holds are white with mean zero (R. K. Mehra, "On the identification of variances
and adaptive Kalman filtering", IEEE Transactions on Automatic Control 15, 1970). Their signed mean, over half a
second and over three, shows that something is systematically wrong; scatter about it is noise, and no sign of that.
Who it is follows from the turn over one span as gyroscope, IMU yaw and frames measure it, by Bayes's rule:

=================  =====================  =====================  ==================
hypothesis         frames - gyroscope     frames - IMU yaw       frames themselves
=================  =====================  =====================  ==================
all well           none                   none                   follow the turn
gyroscope wrong    drifts                 none                   follow the turn
gyroscope spikes   leaps                  none                   follow the turn
corridor bends     drifts                 drifts likewise        follow the bend
another axis       jumps                  jumps                  jump
=================  =====================  =====================  ==================

An IMU yaw made from the same gyroscope repeats its errors, so that it agrees with it is weaker evidence than that it
does not. Frames that drift away by themselves look like a bend.
"""

from __future__ import annotations

from enum import StrEnum
from math import exp, isfinite, log, nan, pi, radians, remainder, sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.kernels import FloatArray
from vision.rotations import wrap_axis

SHORT_S, LONG_S = 0.25, 1.5  # time constants of means over about 0.5 and 3 s
CLIPPED_SIGMA = 4.0  # a gross error must not make a mean
SYSTEMATIC_SIGMA = 4.0  # of a mean: worth a look at the slopes, which decide
CONTESTED_SIGMA = 5.5  # of a mean: worth a word, whatever the slopes say
SPANS_S = (0.5, 1.0, 3.0)  # over which slopes are fitted: the shorter the sooner, the longer the finer
SPAN_NS = round(SPANS_S[-1] * 1e9)
MIN_POINTS = 6
MIN_LINKED = 0.75  # share of the frames; fewer, and nobody can say what they follow
DRIFT_STD_RAD_S = radians(10.0)  # of a gyroscope that is wrong, and of a corridor that bends
MAX_RATE_RAD_S = 35.0  # that a gyroscope reports: a spike may be any
WRONG_YAW = 0.1  # prior probability that steel or current pulls the IMU's yaw away
SHARED_YAW = 0.2  # prior probability that the IMU's yaw repeats a fault of the gyroscope
PRIOR_WRONG = (
    1e-3  # of each fault: looked at four times a second, and the slopes are sure to four sigmas or more
)
PERSISTS = 0.5  # prior probability that what was found goes on
MAX_MISFIT = 9.0  # of one frame
MAX_INDEPENDENT = 15  # frames; more in a span do not make their stated sigmas surer


class Hypothesis(StrEnum):
    """Who is wrong."""

    WELL = "all well"
    GYRO = "gyroscope"
    SPIKE = "gyroscope for a moment"
    BEND = "bend"
    AXIS = "axis"


class Innovations(NamedTuple):
    """Signed means of the frames' normalised innovations, with their variances had the innovations been white."""

    short: float = 0.0
    long: float = 0.0
    short_variance: float = 0.0
    long_variance: float = 0.0

    def with_innovation(self, normalised: float, interval_s: float, rho: float) -> Innovations:
        """Take in an innovation over its standard deviation; ``rho`` is the correlation with the one before."""
        z = min(max(normalised, -CLIPPED_SIGMA), CLIPPED_SIGMA)
        unit = (1.0 + rho) / (1.0 - rho)  # variance of a sum of correlated terms, each of variance one

        def mean(old: float, variance: float, time_s: float) -> tuple[float, float]:
            a = 1.0 - exp(-interval_s / time_s)
            return old + a * (z - old), (1.0 - a) ** 2 * variance + a * a * unit

        short, short_variance = mean(self.short, self.short_variance, SHORT_S)
        long, long_variance = mean(self.long, self.long_variance, LONG_S)
        return Innovations(short, long, short_variance, long_variance)

    @property
    def short_sigmas(self) -> float:
        """The mean over half a second, in its standard deviations."""
        return self.short / sqrt(self.short_variance) if self.short_variance > 0.0 else 0.0

    @property
    def long_sigmas(self) -> float:
        """The mean over three seconds, in its standard deviations."""
        return self.long / sqrt(self.long_variance) if self.long_variance > 0.0 else 0.0

    @property
    def one_sided_sigmas(self) -> float:
        """How far they are from what chance does, in standard deviations."""
        return max(abs(self.short_sigmas), abs(self.long_sigmas))

    @property
    def systematic(self) -> bool:
        """Whether they are one-sided beyond chance."""
        return self.one_sided_sigmas > SYSTEMATIC_SIGMA


class Sight(NamedTuple):
    """A frame's heading and its sigma beside what gyroscope (bias not taken off) and IMU yaw (or NaN) then said.

    ``linked``: no jump of the picture lies between it and the frames that the filter used. ``walk``: how its errors
    wander, rad/sqrt(s), where they last for longer than a frame. ``bias_rad_s``: the gyroscope's bias as the filter
    then had it.
    """

    t_ns: int
    heading_rad: float
    std_rad: float
    raw_theta_rad: float
    yaw_rad: float
    linked: bool
    walk: float = 0.0
    bias_rad_s: float = 0.0


class Slope(NamedTuple):
    """A difference of two headings: how fast it grows, rad/s, its sigma, its value now and that value's sigma.

    ``misfit`` is the mean of the ``n`` squared residuals over their variances: 1 where it grows steadily.
    """

    rate_rad_s: float
    rate_std: float
    now_rad: float
    now_std: float
    misfit: float = 1.0
    n: int = 0


class Evidence(NamedTuple):
    """What the sources say over one span.

    Parameters
    ----------
    gyro, yaw
        Slope of the frames' heading minus the dead-reckoned one (bias taken off), and minus the IMU's yaw; yaw is
        None where there is none.
    apart_std
        Sigma of the difference of the two rates, in which the frames' errors cancel.
    jumped
        Whether the frames themselves jumped, by more than the gyroscope turned meanwhile.
    refused
        Whether frames were refused lately: a gyroscope that leapt by less has done no harm.
    """

    gyro: Slope | None
    yaw: Slope | None
    apart_std: float
    jumped: bool
    refused: bool = True


class Verdict(NamedTuple):
    """Probabilities of the hypotheses, in the order of `Hypothesis`; they add up to one."""

    probabilities: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def likeliest(self) -> Hypothesis:
        """The most probable one."""
        return tuple(Hypothesis)[int(np.argmax(self.probabilities))]

    def of(self, hypothesis: Hypothesis) -> float:
        """Return the probability of one."""
        return self.probabilities[tuple(Hypothesis).index(hypothesis)]


class Told(NamedTuple):
    """Who was found wrong, and when last."""

    hypothesis: Hypothesis
    t_ns: int


class Diagnosis(NamedTuple):
    """What the frames have shown against the prediction, and who is wrong by that.

    Parameters
    ----------
    innovations, sights
        The evidence so far.
    refused_share
        Share of the frames of the last half second that were not used.
    judged_ns, found, verdict
        When it was asked last who is wrong, what was found, and the probabilities if that was with the last frame.
    told
        Who was found wrong last, and when.
    leap_rad
        By how much the gyroscope leapt while no frame came; 0 where it did not.
    straight_bias_rad_s
        The gyroscope's bias from before frames began to drift from gyroscope and attitude; the filter's own takes up
        the bend's rate meanwhile. NaN while there is no bend.
    """

    innovations: Innovations = Innovations()
    sights: tuple[Sight, ...] = ()
    refused_share: float = 0.0
    judged_ns: int | None = None
    found: Hypothesis = Hypothesis.WELL
    verdict: Verdict = Verdict()
    told: Told | None = None
    leap_rad: float = 0.0
    straight_bias_rad_s: float = nan

    def stepped(self) -> Diagnosis:
        """Let go of evidence that is relative to a heading that has jumped since."""
        return self._replace(innovations=Innovations(), sights=(), refused_share=0.0, found=Hypothesis.WELL)

    def started_anew(self) -> Diagnosis:
        """Keep nothing but what has been told."""
        return Diagnosis(told=self.told)


def with_sight(sights: tuple[Sight, ...], new: Sight, spacing_ns: int) -> tuple[Sight, ...]:
    """Append a frame unless it follows the last too closely; let go of what is older than the span."""
    if sights and new.t_ns - sights[-1].t_ns < spacing_ns:
        return sights
    first = next((i for i, s in enumerate(sights) if new.t_ns - s.t_ns <= SPAN_NS), len(sights))
    return (*sights[first:], new)


def unseen_leap(sights: tuple[Sight, ...], new: Sight, bias_rad_s: float) -> float:
    """Return by how much the gyroscope leapt since the last frame, rad; 0 where it did not, or nothing shows it.

    A frame cannot tell one end of the corridor from the other. An IMU yaw may jump where the gyroscope does not
    (steel, a reset), but not stand still while the vehicle turns: of the two, the one that turned less is right.
    """
    if not sights or new.t_ns - sights[-1].t_ns < SPANS_S[0] * 1e9:
        return 0.0
    last = sights[-1]
    gyro = new.raw_theta_rad - last.raw_theta_rad - bias_rad_s * (new.t_ns - last.t_ns) * 1e-9
    apart = new.yaw_rad - last.yaw_rad
    if not isfinite(apart):
        return 0.0
    yaw = remainder(apart, 2.0 * pi)
    leap = remainder(gyro - yaw, 2.0 * pi)
    return leap if abs(leap) > 0.5 * pi and abs(gyro) > abs(yaw) + 0.5 * pi else 0.0


def slope_of(t_s: FloatArray, difference_rad: FloatArray, std_rad: FloatArray, walk: float) -> Slope | None:
    """Fit a line to differences, less those that lie off it by more than three sigmas; None: too few.

    Parameters
    ----------
    t_s
        Times before now (n,), the last 0.
    difference_rad, std_rad
        Differences and the frames' sigmas (n,).
    walk
        How the difference may wander, rad/sqrt(s).
    """
    keep = np.ones(len(t_s), bool)
    a = b = 0.0
    rate_variance = now_variance = nan
    for _ in range(3):
        if keep.sum() < MIN_POINTS:
            return None
        w = keep / std_rad**2
        s0, s1, s2 = w.sum(), (w * t_s).sum(), (w * t_s * t_s).sum()
        d0, d1 = (w * difference_rad).sum(), (w * t_s * difference_rad).sum()
        det = s0 * s2 - s1 * s1
        if not det > 0.0:
            return None
        a, b = float((s2 * d0 - s1 * d1) / det), float((s0 * d1 - s1 * d0) / det)
        rate_variance, now_variance = float(s0 / det), float(s2 / det)
        off = np.abs(difference_rad - a - b * t_s)
        scatter = max(float(np.median(off)) / 0.67, 1e-9)
        keep = off <= 3.0 * np.maximum(std_rad, scatter)
    span_s = float(-t_s[0])
    # A random walk's mean slope over a span T, fitted by a line, has variance 1.2 walk^2 / T.
    misfit = float(np.minimum((off / std_rad) ** 2, MAX_MISFIT).mean())
    # Where the differences are not on a line, nothing constant is wrong.
    rate_variance *= max(1.0, float(np.mean((off / np.maximum(std_rad, 1e-9)) ** 2 * keep)))
    return Slope(b, sqrt(rate_variance + 1.2 * walk * walk / span_s), a, sqrt(now_variance), misfit, len(t_s))


def slopes(
    sights: tuple[Sight, ...], span_s: float, psi_rad: float, bias_rad_s: float, walks: tuple[float, float]
) -> tuple[Slope | None, Slope | None]:
    """Slopes of frames minus gyroscope and frames minus IMU yaw over the last ``span_s``.

    Parameters
    ----------
    sights
        Frames, the newest of which is at the filter's time.
    psi_rad, bias_rad_s
        The filter's heading and bias now: differences are to its heading, carried back by the gyroscope.
    walks
        How gyroscope and IMU yaw wander, rad/sqrt(s).
    """
    if len(sights) < MIN_POINTS:
        return None, None
    last = sights[-1]
    within = [s for s in sights if last.t_ns - s.t_ns <= span_s * 1e9]
    seen = [s for s in within if s.linked]
    if len(seen) < max(MIN_POINTS, MIN_LINKED * len(within)):
        return None, None
    t = np.array([(s.t_ns - last.t_ns) * 1e-9 for s in seen])
    std = np.array([s.std_rad for s in seen])
    raw = np.array([s.raw_theta_rad for s in seen])
    heading = np.array([s.heading_rad for s in seen])
    if t[0] == 0.0:
        return None, None
    expected = psi_rad + (raw - last.raw_theta_rad) - bias_rad_s * t
    gyro = slope_of(t, _unwrapped(heading - expected), std, walks[0])
    yaw = np.array([s.yaw_rad for s in seen])
    if gyro is None or not np.isfinite(yaw).all():
        return gyro, None
    return gyro, slope_of(t, _unwrapped(heading - yaw), std, walks[1])


def _unwrapped(difference: FloatArray) -> FloatArray:
    """Differences of axes, the last within a quarter turn, the others within one of the last."""
    last = wrap_axis(float(difference[-1]))
    return last + (difference - last + 0.5 * pi) % pi - 0.5 * pi


def _log_normal(x: float, variance: float) -> float:
    return -0.5 * (x * x / variance + log(2.0 * pi * variance))


def _mixture(first: float, second: float, share: float) -> float:
    """Log likelihood where the second holds with a probability."""
    top = max(first, second)
    return top + log((1.0 - share) * exp(max(first - top, -700.0)) + share * exp(max(second - top, -700.0)))


def judge(evidence: Evidence, before: Hypothesis = Hypothesis.WELL) -> Verdict:
    """Weigh the hypotheses by Bayes's rule; what was found the last time is likely to go on.

    The spans of successive looks overlap, so the whole distribution is not carried on: one frame would count often.
    """
    if evidence.jumped:
        return Verdict((0.0, 0.0, 0.0, 0.0, 1.0))
    if evidence.gyro is None:
        return Verdict()
    drift, yaw = evidence.gyro.rate_rad_s, evidence.yaw
    noise, wide = evidence.gyro.rate_std**2, evidence.gyro.rate_std**2 + DRIFT_STD_RAD_S**2
    n = min(evidence.gyro.n, MAX_INDEPENDENT)
    steady = -0.5 * n * max(evidence.gyro.misfit - 1.0, 0.0)  # what leaps lies on no line
    well, drifts = _log_normal(drift, noise), _log_normal(drift, wide)
    agrees = repeats = gyro = 0.0  # log likelihoods of the yaw's slope
    if yaw is not None:
        astray = _log_normal(yaw.rate_rad_s, yaw.rate_std**2 + DRIFT_STD_RAD_S**2)
        agrees = _mixture(_log_normal(yaw.rate_rad_s, yaw.rate_std**2), astray, WRONG_YAW)
        # Both differences have the frames' errors in common: yaw minus gyroscope has only their own.
        repeats = _log_normal(yaw.rate_rad_s - drift, evidence.apart_std**2)
        gyro = _mixture(agrees, repeats, SHARED_YAW)
    priors = dict.fromkeys((Hypothesis.GYRO, Hypothesis.SPIKE, Hypothesis.BEND), PRIOR_WRONG)
    if before in priors:
        priors[before] = PERSISTS
    logs = (
        log(1.0 - sum(priors.values())) + well + agrees + steady,
        log(priors[Hypothesis.GYRO]) + drifts + gyro + steady,
        log(priors[Hypothesis.SPIKE]) - log(2.0 * MAX_RATE_RAD_S) + gyro if evidence.refused else -1e9,
        log(priors[Hypothesis.BEND]) + drifts + repeats + steady if yaw is not None else -1e9,
        -1e9,
    )
    highest = max(logs)
    weights = [exp(max(value - highest, -700.0)) for value in logs]
    total = sum(weights)
    return Verdict(tuple(w / total for w in weights))
