"""Code of a worker process: limits of its resources, and the fusing of one flight."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fusion.fleet.row import FleetRow
    from fusion.fleet.task import Task

_MAX_REASON = 600  # characters


def prepare_process(memory_bytes: int | None) -> None:
    """Set up a local worker process, before it imports heavy modules.

    It limits its memory to ``memory_bytes``, leaves interrupts to its parent, and ends when the parent has ended.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    if memory_bytes is not None and sys.platform == "linux":  # not enforced by other systems
        from resource import RLIMIT_DATA, getrlimit, setrlimit

        hard = getrlimit(RLIMIT_DATA)[1]
        setrlimit(RLIMIT_DATA, (memory_bytes if hard < 0 else min(memory_bytes, hard), hard))


def _leave_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def process_id() -> int:
    """Return the id of this process."""
    return os.getpid()


@cache
def limit_threads() -> None:
    """Limit OpenCV, BLAS and OpenMP to one thread in this process: there is one process per core.

    numba starts no threads, as no compiled code is parallel; to set their number after its import makes it refuse to
    compile.
    """
    import cv2
    import numpy  # noqa: F401  # its BLAS must be loaded to be limited
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
    cv2.setNumThreads(1)


def fuse_task(task: Task) -> FleetRow:
    """Fuse a flight as ``corridor fuse`` does; any error becomes its row's reason."""
    from fusion.fleet.fingerprint import content_of, hashes_of, library_versions, program_version
    from fusion.fleet.row import FleetRow

    started = time.perf_counter()
    limit_threads()
    log_hash, found = "", {}
    try:
        hashes = hashes_of(task.flight.path)
        log_hash = content_of(task.flight.path, hashes)
        if task.earlier is not None and task.earlier.log_hash == log_hash:
            return replace(task.earlier, log_stamp=task.stamp, path=str(task.flight.path))
        found = _fused(task, hashes)
    except Exception as error:
        found = failure(error)
    known = {"date": task.flight.date} | found
    return FleetRow(
        **known,
        flight=task.flight.name,
        vehicle=task.flight.vehicle,
        path=str(task.flight.path),
        total_s=time.perf_counter() - started,
        peak_memory_mb=_peak_memory_mb(),
        worker=f"{socket.gethostname()}:{os.getpid()}",
        log_bytes=task.log_bytes,
        log_hash=log_hash,
        log_stamp=task.stamp,
        config_hash=task.config_hash,
        version=program_version(),
        libraries=library_versions(),
    )


def _fused(task: Task, hashes: Mapping[Path, str]) -> dict[str, Any]:
    """Fuse a flight and write its output; return the fields of its row."""
    from fusion.fleet.measure import measures, started
    from fusion.logs import load_flight
    from fusion.offline.fuse import fuse_flight
    from fusion.outputs.folder import check_out_dir, write_outputs
    from vision.errors import InputError

    try:
        flight = load_flight(task.flight.path, camera=task.camera)
        result = fuse_flight(flight, task.config, method=task.method, jobs=1)
    except InputError as error:
        # A missing library is not a fault of the log: the flight is tried again next time.
        is_mended_here = (error.remedy or "").startswith("pip install")
        return failure(error, "error" if is_mended_here else "unusable")
    folder = check_out_dir(task.out / task.folder)
    write_outputs(result, flight, folder, report=task.reports, command=task.command, hashes=hashes)
    found = measures(result, flight) | {"output": task.folder}
    return found | {"date": started(flight) or task.flight.date}


def failure(error: BaseException, verdict: str = "error") -> dict[str, Any]:
    """Return the reason for a row without a result, in one line; for bugs with the place in the code."""
    from fusion.fleet.row import WorkerLostError
    from vision.errors import InputError

    text = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        text = "needs more memory than its worker may take (allow more by --memory, or fewer --jobs)"
    elif not isinstance(error, InputError | OSError | WorkerLostError):
        places = traceback.extract_tb(error.__traceback__)
        place = f", {Path(places[-1].filename).name} line {places[-1].lineno}" if places else ""
        text = f"unexpected {type(error).__name__}: {text}{place}"
    return {"verdict": verdict, "reason": text if len(text) <= _MAX_REASON else text[:_MAX_REASON] + " ..."}


def _peak_memory_mb() -> float | None:
    try:
        from resource import RUSAGE_SELF, getrusage
    except ImportError:  # Windows
        return None
    unit = 1 if sys.platform == "darwin" else 1024  # macOS counts bytes
    return getrusage(RUSAGE_SELF).ru_maxrss * unit / 1e6
