"""Table of the checks on a fused flight: one rule per kind of fault.

To add a check, write its rule in a ``checks_*`` module, add its thresholds to `fusion.evaluation.verdict.Limits`, and
list it in `CHECKS`.
"""

from __future__ import annotations

from fusion.evaluation.checks_cause import likely_cause
from fusion.evaluation.checks_filter import (
    ALONG_THE_CORRIDOR,
    INNOVATIONS_OVER_GATE,
    INNOVATIONS_OVER_SIGMA,
    LONGEST_COAST,
    OFFSET_KNOWN,
)
from fusion.evaluation.checks_frames import CAMERA_TIME, FRAMES_USED, REJECTIONS
from fusion.evaluation.checks_input import GAPS, GYRO_BIAS, IMU_YAW_STEPS, PROBLEMS, RATES
from fusion.evaluation.checks_truth import ERRORS_OVER_SIGMA, HEADING_ERROR, OFFSET_ERROR
from fusion.evaluation.verdict import CheckRule, Limits
from fusion.flight import Flight
from fusion.result.result import FusionResult
from fusion.result.summary import Check

#: In the order of importance to a reader.
CHECKS: tuple[CheckRule, ...] = (
    HEADING_ERROR,
    OFFSET_ERROR,
    FRAMES_USED,
    REJECTIONS,
    INNOVATIONS_OVER_GATE,
    LONGEST_COAST,
    ALONG_THE_CORRIDOR,
    OFFSET_KNOWN,
    INNOVATIONS_OVER_SIGMA,
    ERRORS_OVER_SIGMA,
    CAMERA_TIME,
    GYRO_BIAS,
    IMU_YAW_STEPS,
    RATES,
    GAPS,
    PROBLEMS,
)


def run_checks(result: FusionResult, flight: Flight, limits: Limits | None = None) -> tuple[Check, ...]:
    """Run all checks on a fused flight, in the order of `CHECKS`, preceded by the likely cause of a fault.

    Parameters
    ----------
    result, flight
        Result of `fusion.fuse_flight`, and its flight.
    limits
        Thresholds; None for the defaults.
    """
    checks = tuple(rule.apply(result, flight, limits or Limits()) for rule in CHECKS)
    cause = likely_cause(result, flight, checks)
    return checks if cause is None else (cause, *checks)
