"""lu-vp-detect 1.0.4, the vanishing point detector on PyPI, in an environment of its own: it wants OpenCV 4.

It runs in a process beside this one and measures one frame at a time when asked, so that its turn can come between
those of the others.
"""

from __future__ import annotations

import json
import os
import subprocess
import venv
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from vision import Attitude, Camera
from vision.images import GreyImage

from .ransac import heading_of

PACKAGES = ("numpy>=1.26,<3", "opencv-contrib-python-headless>=4.9,<5")
PEER = "lu-vp-detect==1.0.4"
LENGTH_OF_WIDTH = 30 / 640  # its default minimum length, at the size it was made for
WORKER = Path(__file__).with_name("peer_worker.py")


def environment_folder() -> Path:
    """Return where the environment is kept between runs: the user's cache folder."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "corridor-fusion" / "lu-vp-detect-1.0.4"


def make_environment(folder: Path) -> Path:
    """Create the environment where it is not there yet; return its Python.

    Raises
    ------
    RuntimeError
        Where it cannot be made, with the last words of what failed.
    """
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    ready = folder / "ready"
    if ready.exists():
        return python
    try:
        venv.EnvBuilder(with_pip=True, clear=True).create(folder)
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        for arguments in (PACKAGES, ("--no-deps", PEER)):  # it asks for the OpenCV that needs a display
            subprocess.run([*pip, *arguments], check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
        raise RuntimeError(said[-1] if said else "no reason given") from error
    ready.touch()
    return python


@dataclass(frozen=True, slots=True)
class PeerAnswer:
    """Heading in radians, NaN without an answer; its time and that of blur and Canny there, milliseconds."""

    heading_rad: float
    ms: float
    unit_ms: float


class Peer:
    """The process; use it in a ``with`` block."""

    def __init__(self, python: Path, images: list[GreyImage], camera: Camera) -> None:
        self._folder = TemporaryDirectory(prefix="corridor-peer-")
        frames = Path(self._folder.name) / "frames.npy"
        np.save(frames, np.stack(images))
        settings = {
            "length_thresh": LENGTH_OF_WIDTH * camera.width_px,
            "principal_point": [camera.cx_px, camera.cy_px],
            "focal_length": camera.fx_px,
            "seed": 0,
        }
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        self._process = subprocess.Popen(
            [str(python), str(WORKER), str(frames), json.dumps(settings)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        self._camera = camera

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._process.wait(timeout=60)
        self._folder.cleanup()

    def measure(self, index: int, attitude: Attitude) -> PeerAnswer:
        """Measure a frame; of its three vanishing points the one nearest the optical axis is the corridor's."""
        if self._process.stdin is None or self._process.stdout is None:
            raise RuntimeError("the peer has no pipes")
        print(index, file=self._process.stdin, flush=True)
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("lu-vp-detect stopped; see its words above")
        answer: dict[str, Any] = json.loads(line)
        heading = np.nan
        if answer["vps"] is not None:
            axes: npt.NDArray[np.float64] = np.array(answer["vps"])
            axis = axes[int(np.argmax(np.abs(axes[:, 2])))]
            heading = heading_of(attitude.R_level_body() @ self._camera.R_body_camera @ axis)
        return PeerAnswer(heading, answer["ms"], answer["unit_ms"])
