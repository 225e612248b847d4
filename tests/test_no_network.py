"""Nothing is fetched and nothing is reported: no command opens a network connection."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.files import OFFICE, ROOT

# Pairs of sockets within the process are no network.
GUARD = """
import sys
from socket import AF_INET, AF_INET6

NETWORK = {"socket.connect", "socket.bind", "socket.sendto", "socket.getaddrinfo", "urllib.Request"}

def hook(event, arguments):
    if event in NETWORK or (event == "socket.__new__" and arguments[1] in (AF_INET, AF_INET6)):
        sys.__stderr__.write(f"network: {event} {arguments[1:]}\\n")
        sys.__stderr__.flush()
        import os
        os._exit(99)

sys.addaudithook(hook)
from fusion.__main__ import main
sys.argv = ["corridor", *sys.argv[1:]]
main()
"""
CAMERA = OFFICE / "mav0" / "cam0"


def run(folder: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", GUARD, *map(str, arguments)]
    environment = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(folder)}
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment)


def test_the_guard_sees_a_connection(tmp_path: Path) -> None:
    code = GUARD.partition("from fusion")[0] + "import socket; socket.create_connection(('127.0.0.1', 9))"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert found.returncode == 99
    assert "network: socket." in found.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ("config",),
        ("inspect", OFFICE),
        ("measure", sorted((CAMERA / "data").iterdir())[0]),
        ("fuse", "short", "--export", "tum", "-o", "out"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_command_opens_no_connection(arguments: tuple[str | Path, ...], tmp_path: Path) -> None:
    cam = tmp_path / "short" / "mav0" / "cam0"
    (cam / "data").mkdir(parents=True)
    for picture in sorted((CAMERA / "data").iterdir())[:10]:
        (cam / "data" / picture.name).write_bytes(picture.read_bytes())
    (cam / "sensor.yaml").write_bytes((CAMERA / "sensor.yaml").read_bytes())
    found = run(tmp_path, *arguments)
    assert found.returncode == 0, found.stderr
    assert "network:" not in found.stderr


def test_a_playlist_named_like_a_video_fetches_nothing(tmp_path: Path) -> None:
    pytest.importorskip("av")
    playlist = (
        "#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\nhttp://127.0.0.1:9/secret.ts\n#EXT-X-ENDLIST\n"
    )
    (tmp_path / "video.mp4").write_text(playlist)
    found = run(tmp_path, "inspect", "video.mp4")
    assert found.returncode == 2
    assert "does not open as a video" in found.stderr
    assert "refused" not in found.stderr.lower()  # a connection to a closed port would be
