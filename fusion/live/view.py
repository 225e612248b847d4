"""Live view: pictures with their lines, heading and offset with sigma, over a Foxglove web socket.

The messages are those that `corridor fuse --export mcap` writes, so one layout shows both.
"""

from __future__ import annotations

import json
import queue
import threading
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion.estimator.estimate import Estimate
from fusion.estimator.frame_update import FrameResult
from fusion.estimator.tables import ESTIMATE_DTYPE, estimate_row
from fusion.outputs import foxglove as messages
from fusion.outputs.mcap import ESTIMATE, IMAGE, OVERLAY
from fusion.result.conventions import Frame
from vision import InputError

JPEG_QUALITY = 70
MOST_WAITING = 20


class FoxgloveViewer:
    """Serves a `fusion.live.session.LiveSession` to Foxglove or Lichtblick, from a separate thread.

    Parameters
    ----------
    host, port
        Where to listen.

    Raises
    ------
    InputError
        If the SDK is not installed, or the port is in use.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 8765) -> None:
        try:
            import foxglove
        except ImportError:
            raise InputError(
                "--view needs foxglove-sdk", remedy="pip install 'corridor-fusion[view]'"
            ) from None
        try:
            self._server = foxglove.start_server(name="corridor live", host=host, port=port)
        except (OSError, RuntimeError) as error:
            raise InputError(
                f"cannot serve at {host}:{port}: {error}", remedy="choose another --view-port"
            ) from error
        schemas = {
            IMAGE: messages.COMPRESSED_IMAGE,
            OVERLAY: messages.IMAGE_ANNOTATIONS,
            ESTIMATE: messages.table_schema("corridor_fusion.Estimate", ESTIMATE_DTYPE, Frame.FRD),
        }
        self._channels = {topic: _channel(topic, schema) for topic, schema in schemas.items()}
        self._waiting: queue.Queue[tuple[Any, ...] | None] = queue.Queue(maxsize=MOST_WAITING)
        self._thread = threading.Thread(target=self._run, name="view", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Address of the server."""
        return int(self._server.port)

    def frame(self, t_ns: int, image: npt.NDArray[np.uint8], result: FrameResult) -> None:
        """Show a picture; it is dropped while earlier ones are waiting."""
        self._offer((t_ns, image, result))

    def estimate(self, now_ns: int, e: Estimate) -> None:
        """Show an estimate."""
        self._offer((now_ns, e))

    def close(self) -> None:
        """End."""
        self._waiting.put(None)
        self._thread.join()
        self._server.stop()

    def _offer(self, item: tuple[Any, ...]) -> None:
        if not self._waiting.full():
            self._waiting.put_nowait(item)

    def _run(self) -> None:
        names = ESTIMATE_DTYPE.names or ()
        while (item := self._waiting.get()) is not None:
            if len(item) == 2:
                t_ns, e = item
                self._channels[ESTIMATE].log(messages.row_message(names, estimate_row(e)), log_time=t_ns)
                continue
            t_ns, image, result = item
            self._channels[IMAGE].log(messages.image_message(t_ns, image, JPEG_QUALITY), log_time=t_ns)
            if result.measurement is not None:
                overlay = messages.overlay_message(t_ns, result.measurement, image.shape[1])
                self._channels[OVERLAY].log(overlay, log_time=t_ns)


def _channel(topic: str, schema: dict[str, Any]) -> Any:
    import foxglove

    described = foxglove.Schema(name=schema["title"], encoding="jsonschema", data=json.dumps(schema).encode())
    return foxglove.Channel(topic, schema=described, message_encoding="json")
