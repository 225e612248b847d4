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

Three sources, two differences: each hypothesis says which source drifts, and with it how the two rates vary and
correlate. The frames' own errors are in both. An IMU yaw made from the same gyroscope repeats its errors, so that it
agrees with it is weaker evidence than that it does not. Frames that drift away by themselves look like a bend.

What is less likely than not is not followed, but told all the same: a word costs less than a wrong turn.
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
DOUBTED_SHARE = 0.1  # probability that something is wrong, from which on it is told
SPANS_S = (0.5, 1.0, 1.7, 3.0)  # over which slopes are fitted: the shorter the sooner, the longer the finer
SPAN_NS = round(SPANS_S[-1] * 1e9)
MIN_POINTS = 6
MIN_LINKED = 0.75  # share of the frames; fewer, and nobody can say what they follow
DRIFT_STD_RAD_S = radians(10.0)  # of a gyroscope that is wrong, and of a corridor that bends
MAX_RATE_RAD_S = 35.0  # that a gyroscope reports: a spike may be any
START_YAW_ASTRAY, MIN_YAW_ASTRAY = 0.1, 0.01  # probability that steel or current pulls the IMU's yaw away
YAW_ASTRAY_MEMORY = 1 / 40  # of a look: ten seconds
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
    wander, rad/sqrt(s), where they last for longer than a frame. ``bias_rad_s``: the gyroscope's bias as it was then
    known, and its variance.
    """

    t_ns: int
    heading_rad: float
    std_rad: float
    raw_theta_rad: float
    yaw_rad: float
    linked: bool
    walk: float = 0.0
    bias_rad_s: float = 0.0
    bias_variance: float = 0.0


class Slope(NamedTuple):
    """A difference of two headings: how fast it grows, rad/s, its sigma, its value now and that value's sigma.

    The sigmas are those by the frames' errors alone.
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
    gyro_variance, yaw_variance
        Of the two rates by the errors of gyroscope and IMU yaw, (rad/s)^2.
    bias_rad_s
        The bias that was taken off.
    jumped
        Whether the frames themselves jumped, by more than the gyroscope turned meanwhile.
    refused
        Whether frames were refused lately: a gyroscope that leapt by less has done no harm.
    yaw_astray
        Prior probability that the IMU's yaw is pulled away.
    """

    gyro: Slope | None = None
    yaw: Slope | None = None
    gyro_variance: float = 0.0
    yaw_variance: float = 0.0
    bias_rad_s: float = 0.0
    jumped: bool = False
    refused: bool = True
    yaw_astray: float = START_YAW_ASTRAY


class Verdict(NamedTuple):
    """Probabilities of the hypotheses, in the order of `Hypothesis`; they add up to one.

    ``yaw_astray`` is the probability that the IMU's yaw is pulled away, whatever else.
    """

    probabilities: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 0.0)
    yaw_astray: float = 0.0

    @property
    def likeliest(self) -> Hypothesis:
        """The most probable one."""
        return tuple(Hypothesis)[int(np.argmax(self.probabilities))]

    @property
    def doubt(self) -> Hypothesis:
        """What is most probably wrong, where that is to be told; else `Hypothesis.WELL`."""
        if self.of(Hypothesis.WELL) > 1.0 - DOUBTED_SHARE:
            return Hypothesis.WELL
        return tuple(Hypothesis)[1 + int(np.argmax(self.probabilities[1:]))]

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
    yaw_astray
        Share of the time in which the IMU's yaw was pulled away.
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
    yaw_astray: float = START_YAW_ASTRAY

    def stepped(self) -> Diagnosis:
        """Let go of evidence that is relative to a heading that has jumped since."""
        return self._replace(innovations=Innovations(), sights=(), refused_share=0.0, found=Hypothesis.WELL)

    def started_anew(self) -> Diagnosis:
        """Keep nothing but what has been told."""
        return Diagnosis(told=self.told, yaw_astray=self.yaw_astray)

    def with_verdict(self, t_ns: int, verdict: Verdict, look_due: bool) -> Diagnosis:
        """Take in who is wrong; ``look_due`` where the question was not asked for its answer."""
        share = self.yaw_astray
        if look_due:
            share = max(share + YAW_ASTRAY_MEMORY * (verdict.yaw_astray - share), MIN_YAW_ASTRAY)
        told, doubt = self.told, verdict.doubt
        if doubt is not Hypothesis.WELL or self.innovations.one_sided_sigmas > CONTESTED_SIGMA:
            told = Told(doubt, t_ns)
        found = verdict.likeliest
        return self._replace(judged_ns=t_ns, found=found, verdict=verdict, told=told, yaw_astray=share)


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
        How the frames' errors wander, rad/sqrt(s).
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
    misfit = float(np.minimum((off / std_rad) ** 2, MAX_MISFIT).mean())
    # Where the differences are not on a line, nothing constant is wrong.
    rate_variance *= max(1.0, float(np.mean((off / np.maximum(std_rad, 1e-9)) ** 2 * keep)))
    rate_std = sqrt(rate_variance + walked_rate_variance(walk, float(-t_s[0])))
    return Slope(b, rate_std, a, sqrt(now_variance), misfit, len(t_s))


def walked_rate_variance(walk: float, span_s: float) -> float:
    """Variance, (rad/s)^2, of the slope of a line that is fitted to a random walk of this density over a span."""
    return 1.2 * walk * walk / span_s


class InertialNoise(NamedTuple):
    """How gyroscope and IMU yaw wander, rad/sqrt(s), the yaw's white noise, rad, and the gyroscope's scale error."""

    gyro_walk: float
    yaw_walk: float
    yaw_std: float
    gyro_scale_std: float = 0.0


def evidence_over(span_s: float, sights: tuple[Sight, ...], psi_rad: float, noise: InertialNoise) -> Evidence:
    """Slopes of frames minus gyroscope and frames minus IMU yaw over the last ``span_s``, with their variances.

    The bias is that from the start of the span: the filter's own has since taken up some of what is looked for.

    Parameters
    ----------
    span_s
        Length of the span.
    sights
        Frames, the newest of which is at the filter's time.
    psi_rad
        The filter's heading now: differences are to it, carried back by the gyroscope.
    noise
        Of the inertial sensors.
    """
    if len(sights) < MIN_POINTS:
        return Evidence()
    last = sights[-1]
    within = [s for s in sights if last.t_ns - s.t_ns <= span_s * 1e9]
    seen = [s for s in within if s.linked]
    if len(seen) < max(MIN_POINTS, MIN_LINKED * len(within)):
        return Evidence()
    t = np.array([(s.t_ns - last.t_ns) * 1e-9 for s in seen])
    std = np.array([s.std_rad for s in seen])
    raw = np.array([s.raw_theta_rad for s in seen]) - last.raw_theta_rad
    heading = np.array([s.heading_rad for s in seen])
    seen_s, first = float(-t[0]), seen[0]
    if seen_s == 0.0:
        return Evidence()
    expected = psi_rad + raw - first.bias_rad_s * t
    gyro = slope_of(t, _unwrapped(heading - expected), std, last.walk)
    by_scale = noise.gyro_scale_std * float(raw[0]) / seen_s
    gyro_variance = walked_rate_variance(noise.gyro_walk, seen_s) + first.bias_variance + by_scale**2
    yaws = np.array([s.yaw_rad for s in seen])
    if gyro is None or not np.isfinite(yaws).all():
        return Evidence(gyro, None, gyro_variance, bias_rad_s=first.bias_rad_s)
    yaw = slope_of(t, _unwrapped(heading - yaws), std, last.walk)
    # The slope of a line that is fitted to n white errors over a span T has variance 12 sigma^2 / (n T^2).
    yaw_variance = walked_rate_variance(noise.yaw_walk, seen_s) + 12.0 * noise.yaw_std**2 / (
        len(seen) * seen_s**2
    )
    if yaw is not None:  # a yaw that leaps drifts at no constant rate
        yaw_variance += max(yaw.rate_std**2 - gyro.rate_std**2, 0.0)
    return Evidence(gyro, yaw, gyro_variance, yaw_variance, first.bias_rad_s)


def _unwrapped(difference: FloatArray) -> FloatArray:
    """Differences of axes, the last within a quarter turn, the others within one of the last."""
    last = wrap_axis(float(difference[-1]))
    return last + (difference - last + 0.5 * pi) % pi - 0.5 * pi


def _log_density(evidence: Evidence, frames: float = 0.0, gyro: float = 0.0, yaw: float = 0.0) -> float:
    """Log density of the two rates where the sources drift with these variances, (rad/s)^2, beside their noise.

    A fault of the frames, and their noise, is in both rates.
    """
    if evidence.gyro is None:
        return 0.0
    g, common = evidence.gyro.rate_rad_s, evidence.gyro.rate_std**2 + frames
    var_g = common + evidence.gyro_variance + gyro
    if evidence.yaw is None:
        return -0.5 * (g * g / var_g + log(2.0 * pi * var_g))
    y, var_y = evidence.yaw.rate_rad_s, common + evidence.yaw_variance + yaw
    det = var_g * var_y - common * common
    return -0.5 * ((g * g * var_y - 2.0 * g * y * common + y * y * var_g) / det + log(4.0 * pi * pi * det))


def _log_density_of_leap(evidence: Evidence, yaw: float | None) -> float:
    """Return the same where the gyroscope's rate may be any; ``yaw`` None: the IMU's yaw repeats it."""
    leap = -log(2.0 * MAX_RATE_RAD_S)
    if evidence.gyro is None or evidence.yaw is None:
        return leap
    y, variance = evidence.yaw.rate_rad_s, evidence.yaw.rate_std**2 + evidence.yaw_variance + (yaw or 0.0)
    if yaw is None:
        y -= evidence.gyro.rate_rad_s
        variance = evidence.gyro_variance + evidence.yaw_variance
    return leap - 0.5 * (y * y / variance + log(2.0 * pi * variance))


def judge(evidence: Evidence, before: Hypothesis = Hypothesis.WELL) -> Verdict:
    """Weigh the hypotheses by Bayes's rule; what was found the last time is likely to go on.

    The spans of successive looks overlap, so the whole distribution is not carried on: one frame would count often.
    """
    if evidence.jumped:
        return Verdict((0.0, 0.0, 0.0, 0.0, 1.0))
    if evidence.gyro is None:
        return Verdict()
    wide = DRIFT_STD_RAD_S**2
    n = min(evidence.gyro.n, MAX_INDEPENDENT)
    steady = -0.5 * n * max(evidence.gyro.misfit - 1.0, 0.0)  # what leaps lies on no line
    priors = dict.fromkeys((Hypothesis.GYRO, Hypothesis.SPIKE, Hypothesis.BEND), PRIOR_WRONG)
    if before in priors:
        priors[before] = PERSISTS
    priors[Hypothesis.WELL] = 1.0 - sum(priors.values())
    cases = []  # hypothesis, whether the yaw is astray, log of prior times density
    for is_astray, share in ((False, 1.0 - evidence.yaw_astray), (True, evidence.yaw_astray)):
        yaw, apart = wide * is_astray, log(share * (1.0 - SHARED_YAW))
        cases += [
            (Hypothesis.WELL, is_astray, log(share) + steady + _log_density(evidence, yaw=yaw)),
            (Hypothesis.GYRO, is_astray, apart + steady + _log_density(evidence, gyro=wide, yaw=yaw)),
            (Hypothesis.SPIKE, is_astray, apart + _log_density_of_leap(evidence, yaw)),
        ]
    as_frames = steady + _log_density(
        evidence, frames=wide
    )  # gyroscope and yaw drift alike, or the frames alone do
    cases += [
        (Hypothesis.GYRO, False, log(SHARED_YAW) + as_frames),
        (Hypothesis.SPIKE, False, log(SHARED_YAW) + _log_density_of_leap(evidence, None)),
        (Hypothesis.BEND, False, as_frames),
    ]
    possible = [
        (who, is_astray, log(priors[who]) + value)
        for who, is_astray, value in cases
        if (who is not Hypothesis.SPIKE or evidence.refused)
        and (who is not Hypothesis.BEND or evidence.yaw is not None)
    ]
    highest = max(value for *_, value in possible)
    weights = [(who, is_astray, exp(max(value - highest, -700.0))) for who, is_astray, value in possible]
    total = sum(w for *_, w in weights)
    probabilities = tuple(sum(w for who, _, w in weights if who is each) / total for each in Hypothesis)
    return Verdict(probabilities, sum(w for _, is_astray, w in weights if is_astray) / total)
