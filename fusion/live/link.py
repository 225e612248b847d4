"""The link to the autopilot: UDP, TCP or serial, with pymavlink's addresses, reopened after a failure."""

from __future__ import annotations

import logging
import select
import socket
import threading
from collections.abc import Callable
from typing import Any

from vision import InputError

BAUD = 921600
AGAIN_S = 0.5
POLL_S = 0.1
MOST_BYTES = 4096
NETWORKS = ("udpin:", "udpout:", "udp:", "tcp:", "tcpin:")
_REMEDY = "give udpin:0.0.0.0:14540, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or /dev/ttyACM0,921600"


class Link:
    """Receives in a separate thread; sends in the caller's thread.

    Parameters
    ----------
    address
        ``udpin:0.0.0.0:14540``, ``udpout:HOST:PORT``, ``tcp:HOST:PORT``, ``tcpin:HOST:PORT``, or a serial device
        with its baud rate, ``/dev/ttyACM0,921600``.
    receive
        Called with all received bytes, in the link's thread.

    Raises
    ------
    InputError
        If the address is invalid, or the device does not exist.
    """

    def __init__(self, address: str, receive: Callable[[bytes], object]) -> None:
        self.address = address
        self.reopened = 0
        self._receive = receive
        self._lock = threading.Lock()
        self._port: Any = None
        self._closing = threading.Event()
        try:
            self._port = _open(address)
        except ConnectionRefusedError:
            pass  # the other side is not up yet
        except ImportError as error:
            raise InputError(
                f"link {address} needs {error.name}", remedy="pip install 'corridor-fusion[live]'"
            ) from None
        except (OSError, ValueError, IndexError) as error:
            raise InputError(f"link {address!r} cannot be opened: {error}", remedy=_REMEDY) from error
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)
        self._thread.start()

    def send(self, data: bytes) -> None:
        """Send a packet; it is lost while the link is down."""
        with self._lock:
            if self._port is not None:
                self._port.write(data)

    def close(self) -> None:
        """End the thread and the link."""
        self._closing.set()
        self._thread.join()
        self._drop()

    def _drop(self) -> None:
        with self._lock:
            port, self._port = self._port, None
        if port is not None:
            port.close()

    def _run(self) -> None:
        was_up = self._port is not None
        while not self._closing.is_set():
            try:
                if self._port is None:
                    port = _open(self.address)
                    with self._lock:
                        self._port = port
                    self.reopened += was_up
                    was_up = True
                data = _read(self._port)
            except (OSError, ValueError) as error:  # pyserial's errors are OSErrors
                if self._port is not None:
                    logging.getLogger(__name__).warning("link %s: %s", self.address, error)
                self._drop()
                self._closing.wait(AGAIN_S)
                continue
            if data:
                self._receive(data)


def _open(address: str) -> Any:
    from pymavlink import mavutil

    if address.startswith("tcp:"):
        return mavutil.mavtcp(address[4:], retries=1)
    if address.startswith(NETWORKS):
        return mavutil.mavlink_connection(address)
    if "," not in address:
        address = f"{address},{BAUD}"
    return mavutil.mavserial(address)


def _read(port: Any) -> bytes:
    """Wait briefly for bytes to read.

    Raises
    ------
    OSError
        If the link has ended.
    """
    ready, _, _ = select.select([port.fd], [], [], POLL_S)
    if not ready:
        return b""
    connection = port.port
    is_stream = isinstance(connection, socket.socket) and connection.type == socket.SOCK_STREAM
    if not is_stream:  # UDP, serial, or a server with a new connection
        return bytes(port.recv(MOST_BYTES))
    data: bytes = connection.recv(MOST_BYTES)
    if not data:
        raise ConnectionResetError("the other side has closed it")
    return data
