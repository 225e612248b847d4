"""The clock of the benchmarks: how long this thread had the processor, where the system says so finely enough."""

from __future__ import annotations

import time

FINE_S = 1e-5

#: Seconds. Nothing timed here waits for anything, so on an idle machine both clocks say the same.
clock = time.thread_time if time.get_clock_info("thread_time").resolution < FINE_S else time.perf_counter
