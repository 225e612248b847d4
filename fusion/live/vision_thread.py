"""Line extraction in a separate thread, for a loop that must not block."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy.typing as npt

from vision import Camera, InputError, extract_lines

if TYPE_CHECKING:
    from vision.lines.line_set import LineSet


class Measured(NamedTuple):
    """A picture, its time and its lines; None if it could not be read, with the cause if known."""

    t_ns: int
    lines: LineSet | None
    image: npt.NDArray[Any]
    cause: str = ""


def _ignore() -> None:
    pass


class VisionThread:
    """Finds the lines of pictures in a separate thread. Only the newest waiting picture is kept.

    Parameters
    ----------
    camera
        Camera of the pictures.
    extract
        Function that extracts a picture's lines.
    on_finished
        Called in the vision thread whenever `finished` has something new.
    """

    def __init__(
        self,
        camera: Camera,
        extract: Callable[[npt.NDArray[Any], Camera], LineSet] = extract_lines,
        on_finished: Callable[[], object] = _ignore,
    ) -> None:
        self.dropped = 0
        self._camera, self._extract, self._on_finished = camera, extract, on_finished
        self._waiting: queue.Queue[tuple[int, npt.NDArray[Any]] | None] = queue.Queue(maxsize=1)
        self._finished: queue.SimpleQueue[Measured] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="vision", daemon=True)
        self._thread.start()

    def offer(self, t_ns: int, image: npt.NDArray[Any]) -> None:
        """Hand over a picture without blocking; it replaces one that is still waiting."""
        self._put((t_ns, image))

    def finished(self) -> Iterator[Measured]:
        """Pictures measured since the last call."""
        while True:
            try:
                yield self._finished.get_nowait()
            except queue.Empty:
                return

    def wait(self) -> None:
        """Wait until all offered pictures are measured. For tests and simulations; a control loop must not."""
        self._waiting.join()

    def close(self) -> None:
        """End the thread after the present picture."""
        self._put(None)
        self._thread.join()

    def _put(self, item: tuple[int, npt.NDArray[Any]] | None) -> None:
        while True:
            try:
                self._waiting.put_nowait(item)
            except queue.Full:
                try:
                    self._waiting.get_nowait()
                except queue.Empty:
                    continue  # the thread has just taken it
                self._waiting.task_done()
                self.dropped += item is not None
            else:
                return

    def _run(self) -> None:
        while (item := self._waiting.get()) is not None:
            (t_ns, image), cause = item, ""
            try:
                lines = self._extract(image, self._camera)
            except InputError as error:
                lines, cause = None, error.problem
            except Exception:  # an error in one picture must not end vision
                logging.getLogger(__name__).exception("picture of %d ns could not be measured", t_ns)
                lines = None
            self._finished.put(Measured(t_ns, lines, image, cause))
            self._waiting.task_done()
            self._on_finished()
