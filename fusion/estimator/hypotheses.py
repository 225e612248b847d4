"""Fault isolation: probabilities of the possible faults when frames and prediction disagree. Pure functions.

**Detection.** Innovations of a filter whose model holds are white with zero mean (R. K. Mehra, "On the identification
of variances and adaptive Kalman filtering", IEEE Transactions on Automatic Control 15, 1970). Their signed mean over
half a second and over three seconds is tested: beyond `SYSTEMATIC_SIGMA` there is a systematic error. Their scatter
is noise.

**Isolation.** Gyroscope, IMU yaw and frames measure the same turn over a span. Each hypothesis predicts how the
differences of frames minus gyroscope and frames minus IMU yaw behave:

=================  =====================  =====================  ==================
hypothesis         frames - gyroscope     frames - IMU yaw       frames themselves
=================  =====================  =====================  ==================
all well           none                   none                   follow the turn
gyroscope wrong    drifts                 none                   follow the turn
gyroscope spikes   jumps                  none                   follow the turn
corridor bends     drifts                 drifts likewise        follow the bend
another axis       jumps                  jumps                  jump
stamps wrong       like the turn's rate   likewise               follow the turn
=================  =====================  =====================  ==================

The slopes g of frames minus gyroscope and y of frames minus IMU yaw are jointly Gaussian with mean zero. With the
variances r of the frames' fitted slope, q_g and q_y of gyroscope and yaw, q_b of the bias, and d_f, d_g, d_y of a
drift of the frames, the gyroscope or the yaw (zero, or `DRIFT_STD_RAD_S` squared under the hypothesis)::

    var(g) = r + d_f + q_g + d_g + q_b,    var(y) = r + d_f + q_y + d_y,    cov(g, y) = r + d_f

An IMU yaw computed from the same gyroscope repeats its errors: ``q_g + d_g`` is then in var(y) and cov(g, y) too.
Bayes' rule gives the posterior over the hypotheses and over the states of the IMU yaw (sound, disturbed, repeating).
Frames that drift by themselves cannot be distinguished from a bend.

**Decision.** A fault is reported from a probability of `REPORT_PROBABILITY` on, and acted on when it is the most
probable hypothesis: a false warning costs less than a wrong correction.
"""

from __future__ import annotations

from enum import StrEnum
from math import exp, isfinite, log, nan, radians, sqrt
from typing import NamedTuple

import numpy as np

from fusion.estimator.frame_drift import Evidence, HeadingComparison, Slope
from fusion.estimator.imu_yaw_check import YawProbabilities, log_normal

SHORT_S, LONG_S = 0.25, 1.5  # time constants of the means over about 0.5 and 3 s
CLIPPED_SIGMA = 4.0  # normalised innovations are clipped here, so that an outlier does not dominate a mean
SYSTEMATIC_SIGMA = 4.0  # a mean beyond this triggers a judgement of the slopes
CONTESTED_SIGMA = 5.5  # a mean beyond this is reported, independently of the slopes
REPORT_PROBABILITY, KEEP_PROBABILITY = 0.05, 0.02  # above which a fault is reported, and remains reported
CONTESTED_S = 1.0  # for which a fault remains reported after the last frame that showed it
DRIFT_STD_RAD_S = radians(10.0)  # rate of a faulty gyroscope's drift, and of a bend
STAMP_STD_S, WRONG_STAMP_STD_S = 0.005, 0.05  # sigma of correct and of wrong time stamps
MAX_RATE_RAD_S = 35.0  # of a gyroscope: its rate in a spike is uniform within this range
CHECK_INTERVAL_S = 0.25  # between judgements that no innovation triggers
PRIOR_FAULT = 1e-3  # prior probability of each fault, per judgement
PERSISTS = 0.5  # prior probability that the fault found last persists
MAX_INDEPENDENT = 15  # frames per span in the goodness of fit: their stated sigmas are not exact


class Hypothesis(StrEnum):
    """Which source is wrong."""

    WELL = "all well"
    GYRO = "gyroscope"
    SPIKE = "gyroscope for a moment"
    BEND = "bend"
    AXIS = "axis"
    STAMPS = "stamps"


class Innovations(NamedTuple):
    """Signed means of the frames' normalised innovations, with their variances for white innovations."""

    short: float = 0.0
    long: float = 0.0
    short_variance: float = 0.0
    long_variance: float = 0.0

    def with_innovation(self, normalised: float, interval_s: float, rho: float) -> Innovations:
        """Add a normalised innovation; ``rho`` is its correlation with the one before."""
        z = min(max(normalised, -CLIPPED_SIGMA), CLIPPED_SIGMA)
        unit = (1.0 + rho) / (1.0 - rho)  # variance, per term, of a sum of correlated terms of variance one

        def mean(old: float, variance: float, time_s: float) -> tuple[float, float]:
            a = 1.0 - exp(-interval_s / time_s)
            return old + a * (z - old), (1.0 - a) ** 2 * variance + a * a * unit

        short, short_variance = mean(self.short, self.short_variance, SHORT_S)
        long, long_variance = mean(self.long, self.long_variance, LONG_S)
        return Innovations(short, long, short_variance, long_variance)

    @property
    def short_sigmas(self) -> float:
        """Mean over half a second, in standard deviations."""
        return self.short / sqrt(self.short_variance) if self.short_variance > 0.0 else 0.0

    @property
    def long_sigmas(self) -> float:
        """Mean over three seconds, in standard deviations."""
        return self.long / sqrt(self.long_variance) if self.long_variance > 0.0 else 0.0

    @property
    def one_sided_sigmas(self) -> float:
        """The larger of the two means, in standard deviations."""
        return max(abs(self.short_sigmas), abs(self.long_sigmas))

    @property
    def systematic(self) -> bool:
        """Whether the innovations have a significant mean."""
        return self.one_sided_sigmas > SYSTEMATIC_SIGMA


class Verdict(NamedTuple):
    """Probabilities of the hypotheses, in the order of `Hypothesis`; they sum to one.

    ``yaw_disturbed`` is the marginal probability that the IMU's yaw is disturbed; NaN without an IMU yaw.
    """

    probabilities: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    yaw_disturbed: float = nan

    @property
    def most_probable(self) -> Hypothesis:
        """The most probable hypothesis."""
        return tuple(Hypothesis)[int(np.argmax(self.probabilities))]

    def fault_to_report(self, is_reported: bool) -> Hypothesis:
        """Return the most probable fault if it is to be reported, or to remain so; else `Hypothesis.WELL`."""
        least = KEEP_PROBABILITY if is_reported else REPORT_PROBABILITY
        if self.probability_of(Hypothesis.WELL) > 1.0 - least:
            return Hypothesis.WELL
        return tuple(Hypothesis)[1 + int(np.argmax(self.probabilities[1:]))]

    def probability_of(self, hypothesis: Hypothesis) -> float:
        """Return the probability of a hypothesis."""
        return self.probabilities[tuple(Hypothesis).index(hypothesis)]


class ReportedFault(NamedTuple):
    """A reported fault, and when it was last found."""

    hypothesis: Hypothesis
    t_ns: int


class Diagnosis(NamedTuple):
    """Evidence of the frames against the prediction, and the isolated fault.

    Parameters
    ----------
    innovations, comparisons
        The evidence so far.
    rejected_share
        Share of the frames of the last half second that were not used.
    judged_ns, found, verdict
        Time of the last judgement, its result, and the probabilities if it was made with the last frame.
    reported
        The fault reported last.
    jump_rad
        Size of a jump of the gyroscope while no frame arrived; 0 without one.
    straight_bias_rad_s
        The gyroscope's bias from before a bend; during the bend the filter's own bias absorbs its rate. NaN while
        there is no bend.
    yaw_probabilities
        Probabilities that the IMU's yaw is disturbed, and that it repeats the gyroscope's errors.
    """

    innovations: Innovations = Innovations()
    comparisons: tuple[HeadingComparison, ...] = ()
    rejected_share: float = 0.0
    judged_ns: int | None = None
    found: Hypothesis = Hypothesis.WELL
    verdict: Verdict = Verdict()
    reported: ReportedFault | None = None
    jump_rad: float = 0.0
    straight_bias_rad_s: float = nan
    yaw_probabilities: YawProbabilities = YawProbabilities()

    def without_evidence(self) -> Diagnosis:
        """Drop evidence from before a jump of the heading."""
        return self._replace(
            innovations=Innovations(), comparisons=(), rejected_share=0.0, found=Hypothesis.WELL
        )

    def restarted(self) -> Diagnosis:
        """Drop all but the reported fault and the probabilities of the IMU's yaw."""
        return Diagnosis(reported=self.reported, yaw_probabilities=self.yaw_probabilities)

    def with_verdict(self, t_ns: int, verdict: Verdict, judgement_due: bool) -> Diagnosis:
        """Store a verdict; ``judgement_due`` if it was due by time and not triggered by an innovation."""
        yaw_probabilities = self.yaw_probabilities
        if judgement_due and isfinite(verdict.yaw_disturbed):
            yaw_probabilities = yaw_probabilities.with_judgement(verdict.yaw_disturbed)
        reported = self.reported
        doubt = verdict.fault_to_report(reported is not None and t_ns - reported.t_ns < CONTESTED_S * 1e9)
        if doubt is not Hypothesis.WELL or self.innovations.one_sided_sigmas > CONTESTED_SIGMA:
            reported = ReportedFault(doubt, t_ns)
        found = verdict.most_probable
        return self._replace(
            judged_ns=t_ns,
            found=found,
            verdict=verdict,
            reported=reported,
            yaw_probabilities=yaw_probabilities,
        )


class _Drifts(NamedTuple):
    """Variances d of the sources' drifts under a hypothesis; whether the IMU's yaw repeats the gyroscope's errors."""

    frames: float = 0.0
    gyro: float = 0.0
    yaw: float = 0.0
    repeats: bool = False


def _log_density(evidence: Evidence, drifts: _Drifts) -> float:
    """Return the log density of the two slopes; errors of the frames are in both."""
    if evidence.gyro is None:
        return 0.0
    g, frames = evidence.gyro.rate_rad_s, evidence.gyro.rate_std**2 + drifts.frames
    by_gyro = evidence.gyro_variance + drifts.gyro
    var_g = frames + by_gyro + evidence.bias_variance
    if evidence.yaw is None:
        return log_normal(g, var_g)
    y, common = evidence.yaw.rate_rad_s, frames + by_gyro * drifts.repeats
    var_y = common + evidence.yaw_variance + drifts.yaw
    given_y = common / var_y
    return log_normal(y, var_y) + log_normal(g - given_y * y, var_g - given_y * common)


def _log_density_of_spike(evidence: Evidence, drifts: _Drifts) -> float:
    """Return the same for a gyroscope whose rate is uniform over its range."""
    uniform = -log(2.0 * MAX_RATE_RAD_S)
    if evidence.gyro is None or evidence.yaw is None:
        return uniform
    variance = evidence.yaw_variance + drifts.yaw
    if drifts.repeats:
        return uniform + log_normal(evidence.yaw.rate_rad_s - evidence.gyro.rate_rad_s, variance)
    return uniform + log_normal(evidence.yaw.rate_rad_s, variance + evidence.gyro.rate_std**2)


def _log_ratio_of_stamps(gyro: Slope) -> float:
    """Return the log likelihood ratio of wrong time stamps of the frames over correct ones."""
    off_s, variance = gyro.stamp_s, gyro.stamp_variance
    if not isfinite(variance):
        return 0.0
    wrong = log_normal(off_s, variance + WRONG_STAMP_STD_S**2)
    return wrong - log_normal(off_s, variance + STAMP_STD_S**2)


def judge(evidence: Evidence, before: Hypothesis = Hypothesis.WELL) -> Verdict:
    """Return the posterior of the hypotheses by Bayes' rule; the prior favours the fault found last.

    Only that fault is carried over, not the whole posterior: successive spans overlap, so frames would count
    repeatedly.
    """
    if evidence.jumped:
        return Verdict((0.0, 0.0, 0.0, 0.0, 1.0, 0.0))
    if evidence.gyro is None:
        return Verdict()
    wide, n = DRIFT_STD_RAD_S**2, min(evidence.gyro.n, MAX_INDEPENDENT)
    steady = -0.5 * n * max(evidence.gyro.misfit - 1.0, 0.0)  # a jump does not fit a line
    faults = (Hypothesis.GYRO, Hypothesis.SPIKE, Hypothesis.BEND, Hypothesis.STAMPS)
    priors = dict.fromkeys(faults, PRIOR_FAULT)
    if before in priors:
        priors[before] = PERSISTS
    priors[Hypothesis.WELL] = 1.0 - sum(priors.values())
    disturbed, repeating = evidence.yaw_probabilities[:2]
    wrong_stamps = _log_ratio_of_stamps(evidence.gyro)
    cases = []  # hypothesis, fault of the IMU yaw, log of prior times density
    for yaw_fault, share, yaw in (
        ("nothing", (1.0 - disturbed) * (1.0 - repeating), _Drifts()),
        ("disturbed", disturbed, _Drifts(yaw=wide)),
        ("repeating", (1.0 - disturbed) * repeating, _Drifts(repeats=True)),
    ):
        logs = {
            Hypothesis.WELL: steady + _log_density(evidence, yaw),
            Hypothesis.GYRO: steady + _log_density(evidence, yaw._replace(gyro=wide)),
        }
        logs[Hypothesis.STAMPS] = logs[Hypothesis.WELL] + wrong_stamps
        if evidence.frames_rejected:
            logs[Hypothesis.SPIKE] = _log_density_of_spike(evidence, yaw)
        if evidence.yaw is not None and yaw_fault != "disturbed":
            logs[Hypothesis.BEND] = steady + _log_density(evidence, yaw._replace(frames=wide))
        cases += [
            (hypothesis, yaw_fault, log(share * priors[hypothesis]) + value)
            for hypothesis, value in logs.items()
        ]
    highest = max(value for *_, value in cases)
    weights = [
        (hypothesis, yaw_fault, exp(max(value - highest, -700.0))) for hypothesis, yaw_fault, value in cases
    ]
    total = sum(w for *_, w in weights)
    probabilities = tuple(
        sum(w for hypothesis, _, w in weights if hypothesis is each) / total for each in Hypothesis
    )
    if evidence.yaw is None:
        return Verdict(probabilities)
    return Verdict(probabilities, sum(w for _, yaw_fault, w in weights if yaw_fault == "disturbed") / total)
