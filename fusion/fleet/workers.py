"""Executors that fuse flights: local processes or a Dask cluster; both take a task and return a future row.

If a worker dies, this is reported and its flight is fused again elsewhere, at most `ATTEMPTS` times. A worker that
takes too long is ended, and its flight is given up.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from multiprocessing import get_context
from typing import Any, Protocol

from fusion.fleet.fingerprint import program_version
from fusion.fleet.row import FleetRow, WorkerLostError
from fusion.fleet.task import Task
from fusion.fleet.worker import fuse_task, prepare_process, process_id
from vision.errors import InputError

ATTEMPTS = 3  # workers that may die while fusing one flight
CONNECT_S = 10.0  # timeout of the scheduler's answer
_KILL = getattr(signal, "SIGKILL", signal.SIGTERM)  # also ends processes that hang; Windows has only SIGTERM
_OVERDUE = "corridor-fusion: flights that take too long"  # a topic of Dask's events
Notify = Callable[[str], None]
"""Called with a sentence for the user."""


class Workers(Protocol):
    """Where flights are fused."""

    def submit(self, task: Task) -> Future[FleetRow]:
        """Start a flight when a worker is free."""

    def capacity(self) -> int:
        """Return how many flights are fused in parallel."""

    def lost(self, task: Task) -> int:
        """Return how many workers died with a flight."""


class _Worker:
    """A process that fuses one flight after another, and is replaced when it dies."""

    def __init__(self, memory_bytes: int | None) -> None:
        # "spawn": a fork would copy the locks of this process's threads and all its modules.
        context = get_context("spawn")
        self._pool = ProcessPoolExecutor(1, context, initializer=prepare_process, initargs=(memory_bytes,))
        self.pid = self._pool.submit(process_id).result()

    def fuse(self, task: Task, timeout_s: float | None) -> FleetRow:
        """Fuse a flight in the process, and wait for its row."""
        return self._pool.submit(fuse_task, task).result(timeout_s)

    def end(self) -> None:
        """Kill the process."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, _KILL)
        self._pool.shutdown(cancel_futures=True)


class LocalWorkers:
    """Local processes, each watched by a thread, so that the death of one does not affect the others' flights."""

    def __init__(self, jobs: int, memory_bytes: int | None, timeout_s: float | None, notify: Notify) -> None:
        self._jobs, self._memory_bytes, self._timeout_s, self._notify = jobs, memory_bytes, timeout_s, notify
        self._own = threading.local()
        self._lost: dict[str, int] = {}
        self._all: set[_Worker] = set()
        self._ending = False
        self._threads = ThreadPoolExecutor(jobs, "fleet")

    def capacity(self) -> int:
        """Return the number of processes."""
        return self._jobs

    def lost(self, task: Task) -> int:
        """Return how many processes died with a flight."""
        return self._lost.get(task.flight.name, 0)

    def submit(self, task: Task) -> Future[FleetRow]:
        """Start a flight when a process is free."""
        return self._threads.submit(self._fuse, task)

    def _fuse(self, task: Task) -> FleetRow:
        for attempt in range(1, ATTEMPTS + 1):
            worker = None
            try:
                worker = self._worker()
                return worker.fuse(task, self._timeout_s)
            except TimeoutError:
                self._drop(worker)
                raise _too_slow(task, self._timeout_s, self._notify) from None
            except BrokenProcessPool:
                if self._ending:
                    break
                self._drop(worker)
                self._lost[task.flight.name] = attempt
                again = "it is fused again" if attempt < ATTEMPTS else "given up"
                pid = "" if worker is None else f" {worker.pid}"
                self._notify(f"worker{pid} died while it fused {task.flight.name}: {again}")
        raise WorkerLostError(f"its worker process died {ATTEMPTS} times, killed or out of memory")

    def _worker(self) -> _Worker:
        """Return this thread's process, or start a new one."""
        if getattr(self._own, "worker", None) is None:
            self._own.worker = _Worker(self._memory_bytes)
            self._all.add(self._own.worker)
            if self._ending:
                self._own.worker.end()
        worker: _Worker = self._own.worker
        return worker

    def _drop(self, worker: _Worker | None) -> None:
        self._own.worker = None
        if worker is not None:
            worker.end()
            self._all.discard(worker)

    def end(self) -> None:
        """End all processes, even while they are fusing."""
        self._ending = True
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in list(self._all):
            worker.end()
        self._threads.shutdown()


def _too_slow(task: Task, timeout_s: float | None, notify: Notify) -> WorkerLostError:
    """Report that a flight is given up, and return the error for its row."""
    notify(f"{task.flight.name} took more than {timeout_s:g} s: given up, its worker ended")
    return WorkerLostError(
        f"took more than {timeout_s:g} s (allow more by --timeout; 0: as long as it likes)"
    )


@contextmanager
def local_workers(
    jobs: int, memory_bytes: int | None, timeout_s: float | None, notify: Notify
) -> Iterator[LocalWorkers]:
    """Provide local processes, which are ended with the block.

    Parameters
    ----------
    jobs
        Number of processes.
    memory_bytes
        Memory limit of each; None: no limit.
    timeout_s
        Time limit per flight; None: no limit.
    notify
        Called with a sentence when one has died.
    """
    workers = LocalWorkers(jobs, memory_bytes, timeout_s, notify)
    try:
        yield workers
    finally:
        workers.end()


class ClusterWorkers:
    """Workers of a Dask cluster; its scheduler passes a lost worker's flights to others."""

    def __init__(self, client: Any, timeout_s: float | None, notify: Notify) -> None:
        self._client, self._timeout_s, self._notify = client, timeout_s, notify
        self._running: dict[str, Any] = {}  # Dask cancels futures without references
        self._overdue: set[str] = set()
        self._lost: dict[str, int] = {}
        client.subscribe_topic("all", self._on_event)
        client.subscribe_topic(_OVERDUE, self._on_overdue)

    def capacity(self) -> int:
        """Return the present number of threads of all workers."""
        threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    def submit(self, task: Task) -> Future[FleetRow]:
        """Start a flight when a worker is free."""
        row: Future[FleetRow] = Future()
        key = self._key(task)
        self._running[key] = self._client.submit(
            _fuse_in_time, task, key, self._timeout_s, key=key, pure=False
        )
        self._running[key].add_done_callback(lambda fused: self._copy_result(task, fused, row))
        return row

    def _copy_result(self, task: Task, fused: Any, row: Future[FleetRow]) -> None:
        """Copy the result of Dask's future to ours."""
        del self._running[fused.key]
        try:
            if fused.key in self._overdue:
                raise _too_slow(task, self._timeout_s, self._notify)
            row.set_result(fused.result())
        except Exception as error:  # any error must reach the caller that waits for the row
            row.set_exception(error)

    def _key(self, task: Task) -> str:
        return f"fuse {task.flight.name} ({self._client.id})"

    def lost(self, task: Task) -> int:
        """Return how many workers died with a flight."""
        return self._lost.get(self._key(task), 0)

    def _on_event(self, event: tuple[float, Any]) -> None:
        message = event[1]
        if (
            not isinstance(message, dict)
            or message.get("action") != "remove-worker"
            or message.get("expected")
        ):
            return
        for key in message.get("processing-tasks", ()):
            if str(key).endswith(f"({self._client.id})"):
                self._lost[key] = self._lost.get(key, 0) + 1
                name = str(key).removeprefix("fuse ").rpartition(" (")[0]
                self._notify(f"worker {message.get('worker')} died while it fused {name}: it is fused again")

    async def _on_overdue(self, event: tuple[float, Any]) -> None:
        """Give up a flight, and restart the worker that is still fusing it."""
        key, worker = event[1]
        if key in self._running:
            self._overdue.add(key)
            await self._client.cancel([self._running[key]])  # otherwise it would be passed to another worker
            await self._client.restart_workers([worker], raise_for_error=False)


def _fuse_in_time(task: Task, key: str, timeout_s: float | None) -> FleetRow:
    """Fuse a flight in a worker of Dask, and report if it takes too long."""
    from distributed import get_worker

    worker = get_worker()
    seconds = threading.TIMEOUT_MAX if timeout_s is None else timeout_s
    timer = threading.Timer(seconds, worker.log_event, (_OVERDUE, (key, worker.address)))
    timer.daemon = True
    timer.start()
    try:
        return fuse_task(task)
    finally:
        timer.cancel()


@contextmanager
def cluster_workers(address: str, timeout_s: float | None, notify: Notify) -> Iterator[ClusterWorkers]:
    """Provide the workers of a Dask cluster, which keeps running after the block.

    Parameters
    ----------
    address
        Address of its scheduler, such as ``tcp://10.0.0.5:8786``.
    timeout_s
        Time limit per flight; None: no limit.
    notify
        Called with a sentence when a worker has died.

    Raises
    ------
    InputError
        If Dask is not installed, no scheduler answers, or a worker has another version of this program.
    """
    if find_spec("distributed") is None:
        raise InputError("--scheduler needs Dask distributed", remedy='pip install "corridor-fusion[fleet]"')
    from distributed import Client

    try:
        connect: Any = Client
        client = connect(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        problem = f"--scheduler {address}: no scheduler answers there ({error})"
        raise InputError(
            problem, remedy="start one with `dask scheduler`, and give the address it prints"
        ) from error
    try:
        _check_versions(client, address)
        yield ClusterWorkers(client, timeout_s, notify)
    finally:
        client.close()


def _check_versions(client: Any, address: str) -> None:
    try:
        versions: dict[str, str] = client.run(program_version)
    except Exception as error:
        problem = f"--scheduler {address}: its workers cannot run corridor-fusion ({error})"
        raise InputError(problem, remedy="install it on every machine of the cluster") from error
    mine = program_version()
    for worker, theirs in versions.items():
        if theirs != mine:
            problem = f"--scheduler {address}: worker {worker} has corridor-fusion {theirs}, not {mine}"
            raise InputError(problem, remedy="install the same version everywhere")
