from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from fusion.flight import FrameStream, GreyImage
from fusion.offline.prefetch import AHEAD, prefetch_features
from vision.errors import InputError

N = 40


class Source:
    """Pictures of their own number; a file that is read on from where it stands, by one at a time."""

    def __init__(self, unreadable: tuple[int, ...] = ()) -> None:
        self.unreadable = unreadable
        self.read_so_far: list[int] = []
        self.readers: set[int] = set()
        self._reading = False

    def read(self, index: int) -> GreyImage:
        assert not self._reading
        self._reading = True
        time.sleep(0.0005)
        self.read_so_far.append(index)
        self.readers.add(threading.get_ident())
        self._reading = False
        if index in self.unreadable:
            raise InputError(f"picture {index} is broken")
        return np.full((1, 1), index, np.uint8)


def frames(source: Source) -> FrameStream:
    return FrameStream(np.arange(N, dtype=np.int64), source)


def number_of(picture: GreyImage) -> int:
    """Find the picture's number; every third takes long, so that later ones are found before it."""
    number = int(picture[0, 0])
    time.sleep(0.004 if number % 3 == 0 else 0.0)
    if number == 11:
        raise InputError("picture 11 has another size")
    return number


@pytest.mark.parametrize("threads", [0, 1, 2, 5, 100])
def test_what_is_found_comes_in_order_whatever_the_threads(threads: int) -> None:
    source = Source(unreadable=(0, 23))
    found = list(prefetch_features(frames(source), number_of, threads))
    assert found == [None if k in (0, 11, 23) else k for k in range(N)]
    assert source.read_so_far == list(range(N))
    assert (source.readers == {threading.get_ident()}) == (threads == 0)


def test_no_more_pictures_are_held_than_said() -> None:
    source = Source()
    pictures = prefetch_features(frames(source), number_of, 2)
    for taken in range(1, 11):
        next(pictures)
        time.sleep(0.01)
        assert len(source.read_so_far) <= taken + 2 * AHEAD
    pictures.close()


def test_threads_end_with_who_asks() -> None:
    source = Source()
    pictures = prefetch_features(frames(source), number_of, 3)
    next(pictures)
    pictures.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("pictures")]
    assert len(source.read_so_far) < N


def test_an_error_of_the_program_is_not_taken_for_a_broken_picture() -> None:
    def look(picture: GreyImage) -> int:
        return 1 // (int(picture[0, 0]) - 5)

    with pytest.raises(ZeroDivisionError):
        list(prefetch_features(frames(Source()), look, 2))
