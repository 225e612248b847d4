"""Cross-section of the corridor that the frames show: frames of another one are not used for a time.

An offset in half widths refers to the walls beside the vehicle. Ahead of a place where the corridor becomes wider or
narrower, a frame increasingly shows the walls beyond it, and its offset refers to them. The corridor's height over
its width, by the frame's four corners, reveals it: neither a displacement nor a climb of the vehicle changes it.

It is averaged over the frames. Frames are held back from one on whose aspect differs from the average by more than
`MIN_CHANGE`, and `CHANGE_SIGMA` of its sigmas, up to one that has clearly the average aspect again. This holds where
the offset is 0 too: if only one wall steps, the centre line does as well. After `HELD_S` the vehicle is assumed to be
beyond the place, and the average of the frames that were held back is the new one.
"""

from __future__ import annotations

from math import exp, log
from typing import NamedTuple

from fusion.estimator.sample_times import seconds_since
from vision.measurement import FrameMeasurement

MIN_CHANGE = 0.15  # of the logarithm of height over width; lasting errors of the corners are smaller
MAX_RETURNED = 0.075  # a smaller change shows the average cross-section again
CHANGE_SIGMA = 3.0
MAX_LOG_STD = 0.3  # less certain aspects are not used
AVERAGE_S = 3.0  # time constant of the average
MAX_INTERVAL_S = 0.5  # of two frames in the average
HELD_S = 4.0


class Average(NamedTuple):
    """Average of the logarithm of height over width, the number of frames in it, and the time of the last one."""

    log_aspect: float = 0.0
    n: int = 0
    t_ns: int = 0

    def with_value(self, t_ns: int, log_aspect: float) -> Average:
        """Add the value of a frame: the mean at first, later a first-order low-pass filter."""
        n = self.n + 1
        interval_s = min(max(seconds_since(t_ns, self.t_ns), 0.0), MAX_INTERVAL_S)
        gain = max(1.0 / n, 1.0 - exp(-interval_s / AVERAGE_S))
        return Average(self.log_aspect + gain * (log_aspect - self.log_aspect), n, t_ns)


class CrossSection(NamedTuple):
    """Cross-section of the corridor.

    Parameters
    ----------
    average
        Of the frames that show it.
    other
        Of the frames that are held back, because they show another one.
    held_since_ns
        Time of the first of these; None while no frames are held back.
    """

    average: Average = Average()
    other: Average = Average()
    held_since_ns: int | None = None

    @property
    def is_another_seen(self) -> bool:
        """Whether the last frame is held back."""
        return self.held_since_ns is not None

    def with_frame(self, t_ns: int, m: FrameMeasurement) -> CrossSection:
        """Compare a frame with the average, and update it; a frame without an aspect only lets time pass."""
        since_ns = self.held_since_ns
        if since_ns is not None and seconds_since(t_ns, since_ns) > HELD_S:
            return CrossSection(self.other).with_frame(t_ns, m)
        if not (m.corridor_aspect > 0.0 and m.corridor_aspect_std < MAX_LOG_STD * m.corridor_aspect):
            return self
        log_aspect, log_std = log(m.corridor_aspect), m.corridor_aspect_std / m.corridor_aspect
        change = abs(log_aspect - self.average.log_aspect)
        if since_ns is not None:
            is_another = change > MAX_RETURNED
        else:
            is_another = self.average.n > 0 and change > max(MIN_CHANGE, CHANGE_SIGMA * log_std)
        if not is_another:
            return CrossSection(self.average.with_value(t_ns, log_aspect))
        other = self.other.with_value(t_ns, log_aspect)
        return CrossSection(self.average, other, t_ns if since_ns is None else since_ns)
