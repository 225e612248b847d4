"""Decode pictures and extract their features in threads ahead of the filter, in order.

The features depend only on the picture, so the number of threads does not change the result. Decoders and compiled
loops release the interpreter's lock, so threads are enough, and they start at once.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import count
from threading import Lock
from typing import TypeVar

from fusion.flight import FrameStream, GreyImage
from vision.errors import InputError

AHEAD = 3  # pictures per thread: each is held in memory until the filter takes it

Found = TypeVar("Found")


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def prefetch_features(
    frames: FrameStream, extract: Callable[[GreyImage], Found], threads: int
) -> Generator[Found | None]:
    """Yield the features of each picture, in order; None for one that cannot be read or used.

    Parameters
    ----------
    frames
        The pictures.
    extract
        Extracts the features; called in several threads at once. An `InputError` means that the picture is unusable.
    threads
        Number of threads; 0: each picture is read when it is needed.
    """
    numbers, reading, total = count(), Lock(), len(frames.t_ns)

    def extract_next() -> tuple[int, Found | None]:
        with reading:  # in order, one at a time: most sources read a file sequentially
            number = next(numbers)
            try:
                picture = frames.read(number)
            except InputError:
                return number, None
        try:
            return number, extract(picture)
        except InputError:
            return number, None

    if threads == 0:
        for _ in range(total):
            yield extract_next()[1]
        return
    pool = ThreadPoolExecutor(threads, "pictures")
    try:
        begun = min(threads * AHEAD, total)
        waiting: deque[Future[tuple[int, Found | None]]] = deque(
            pool.submit(extract_next) for _ in range(begun)
        )
        found: dict[int, Found | None] = {}
        for number in range(total):
            while number not in found:
                at, what = waiting.popleft().result()
                found[at] = what
            if begun < total:
                waiting.append(pool.submit(extract_next))
                begun += 1
            yield found.pop(number)
    finally:
        pool.shutdown(cancel_futures=True)
