"""What workers of a fleet run in tests, in place of fusing. Each worker loads this module, so it imports little."""

from __future__ import annotations

import os
import signal
import time
from unittest.mock import patch

from fusion.fleet import workers
from fusion.fleet.row import FleetRow
from fusion.fleet.task import Task
from fusion.fleet.worker import fuse_task, prepare_process


def kill_or_fuse(task: Task) -> FleetRow:
    if task.flight.name == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    return fuse_task(task)


def prepare_with_this_module(memory_bytes: int | None) -> None:
    """Prepare a worker; to run this function it has loaded this module, so no flight's time goes by with that."""
    prepare_process(memory_bytes)


def stop_or_fuse(task: Task) -> FleetRow:
    if task.flight.name == "hanging":  # as if it waited for a dead file server: no signal but SIGKILL ends it
        (task.out.parent / "stopped").write_text(str(os.getpid()))
        os.kill(os.getpid(), signal.SIGSTOP)
    return FleetRow(flight=task.flight.name, verdict="pass")  # at once, however busy the machine is


def hang_in_time(task: Task, key: str, timeout_s: float | None) -> FleetRow:
    """Stand for `workers._fuse_in_time` in a worker of Dask, where that is not patched."""
    with patch.object(workers, "fuse_task", hang_or_fuse):
        return workers._fuse_in_time(task, key, timeout_s)


def hang_or_fuse(task: Task) -> FleetRow:
    if task.flight.name == "hanging":
        (task.out.parent / "hanging").write_text(str(os.getpid()))
        time.sleep(600)
    return FleetRow(flight=task.flight.name, verdict="pass")
