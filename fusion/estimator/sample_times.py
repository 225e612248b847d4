"""Times of a source's samples: age and mean interval."""

from __future__ import annotations

from math import isfinite, nan
from typing import NamedTuple

from fusion.estimator.config import FusionConfig
from fusion.estimator.records import new_record


def seconds_since(t_ns: int, then_ns: int | None) -> float:
    """Return the age in seconds; NaN if ``then_ns`` is None."""
    return nan if then_ns is None else (t_ns - then_ns) * 1e-9


class SampleTimes(NamedTuple):
    """Time of a source's last sample, None before the first, and mean interval, NaN before the second."""

    last_ns: int | None = None
    interval_s: float = nan

    def with_sample(self, t_ns: int) -> SampleTimes:
        """Add the newest sample's time; the interval is a low-pass filtered mean."""
        last_ns, old_s = self
        if last_ns is None:
            return SampleTimes(t_ns, old_s)
        interval_s = (t_ns - last_ns) * 1e-9
        if isfinite(old_s):
            interval_s = 0.8 * old_s + 0.2 * min(interval_s, 3 * old_s)
        return new_record(SampleTimes, (t_ns, interval_s))

    def begins_period(self, t_ns: int, rate_hz: float | None) -> bool:
        """Whether the next sample is the first in its period of a rate; always if the rate is None."""
        if self.last_ns is None or rate_hz is None:
            return True
        period_ns = round(1e9 / rate_hz)
        return t_ns // period_ns != self.last_ns // period_ns

    def clock_set_back(self) -> SampleTimes:
        """Forget the last sample; keep the interval."""
        return SampleTimes(None, self.interval_s)

    def age_s(self, t_ns: int) -> float:
        """Return the time since the last sample, s; NaN before the first."""
        return seconds_since(t_ns, self.last_ns)

    def age_limit_s(self, config: FusionConfig) -> float:
        """Return the age beyond which the source is silent: at least 2.5 of its intervals."""
        limit_s = config.coasting_after_s
        return max(limit_s, 2.5 * self.interval_s) if isfinite(self.interval_s) else limit_s

    def is_silent(self, t_ns: int, config: FusionConfig) -> bool:
        """Whether the source has delivered samples and no longer does."""
        return self.last_ns is not None and (t_ns - self.last_ns) * 1e-9 > self.age_limit_s(config)
