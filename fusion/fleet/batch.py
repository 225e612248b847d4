"""Fuse many flights: find them, skip finished ones, distribute the others, update the table."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path

from fusion.estimator.config import FusionConfig
from fusion.files import error_text
from fusion.fleet.discovery import FoundFlight, find_flights
from fusion.fleet.fingerprint import program_version, settings_hash, stamp_of
from fusion.fleet.journal import JOURNAL, Journal, read_journal
from fusion.fleet.row import FleetRow
from fusion.fleet.tables import write_tables
from fusion.fleet.task import Task
from fusion.fleet.worker import failure
from fusion.fleet.workers import Notify, Workers, cluster_workers, local_workers
from fusion.offline.prefetch import usable_cores
from fusion.progress import Progress
from vision.errors import InputError

_WRITING_SHARE = 0.02  # largest share of the time for writing tables
_LEAST_PAUSE_S = 5.0  # between two updates of the tables
_QUEUED = 4  # distributed flights per flight being fused
TIMEOUT_S = 3600.0  # enough for a flight of some hours


@dataclass(frozen=True, slots=True)
class BatchSettings:
    """Settings and workers of a batch.

    Parameters
    ----------
    config
        Settings of the estimator, unless a flight's list entry names others.
    camera
        Calibration file instead of the logs' own.
    method
        ``geometric`` or ``paper``.
    reports
        Whether to write a ``report.html`` per flight.
    jobs
        Worker processes of this machine; None: one per core.
    memory_bytes
        Memory limit of each; None: the machine's memory over their number.
    scheduler
        Address of a Dask cluster to use instead of this machine.
    redo
        Fuse finished flights again.
    timeout_s
        Time limit of a flight, after which its worker is ended and the flight becomes a row with this reason; None:
        no limit.
    command
        The command line of the batch, for each flight's ``provenance``.
    """

    config: FusionConfig = field(default_factory=FusionConfig)
    camera: Path | None = None
    method: str = "geometric"
    reports: bool = True
    jobs: int | None = None
    memory_bytes: int | None = None
    scheduler: str | None = None
    redo: bool = False
    timeout_s: float | None = TIMEOUT_S
    command: str | None = None


@dataclass(frozen=True, slots=True)
class Fleet:
    """A batch's rows by name, the number kept from an earlier batch, and the seconds for the others."""

    rows: tuple[FleetRow, ...]
    kept: int
    wall_s: float


def fuse_fleet(
    sources: Iterable[str | Path],
    out: str | Path,
    settings: BatchSettings | None = None,
    *,
    against: Sequence[FleetRow] = (),
    progress: Progress | None = None,
    notify: Notify = lambda sentence: None,
) -> Fleet:
    """Fuse all flights of the sources into one folder: an output per flight, tables and a page.

    Results of an earlier batch in the same folder with the same log, settings and version are kept. A program that
    calls this needs ``if __name__ == "__main__":``, as for all Python processes.

    Parameters
    ----------
    sources
        See `fusion.fleet.discovery.find_flights`.
    out
        The folder.
    settings
        See `BatchSettings`; None for the defaults.
    against
        Rows of another batch to compare with, from `fusion.fleet.tables.read_fleet`.
    progress
        Called with (done, total) flights.
    notify
        Called with a sentence when a worker has died.

    Raises
    ------
    InputError
        If there are no flights, settings or their files cannot be used, or ``out`` cannot be written. A flight that
        cannot be used becomes a row with the reason.
    """
    settings = settings or BatchSettings()
    folder = _check_folder(Path(out))
    flights = find_flights(sources)
    if not flights:
        raise InputError(
            "no flight was found", remedy="name a folder that contains flights, or list them in a TOML file"
        )
    earlier = {} if settings.redo else read_journal(folder)
    tasks, kept = _divide(flights, folder, settings, earlier)
    started = time.perf_counter()
    with _workers(settings, len(tasks), notify) as workers:
        table = _Table(folder, kept, len(flights), against, Journal(folder, earlier.values()))
        try:
            if progress is not None:
                progress(len(kept), len(flights))
            for finished in _finished(tasks, workers):
                table.add([_row(task, future, workers) for task, future in finished])
                if progress is not None:
                    progress(len(table.rows), len(flights))
        finally:
            table.close()
    return Fleet(table.sorted(), len(kept), time.perf_counter() - started)


def _check_folder(out: Path) -> Path:
    """Create the fleet's folder, or check that an existing one belongs to a fleet."""
    folder = out.resolve()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        foreign = sorted(entry.name for entry in folder.iterdir() if not entry.name.startswith("."))
    except OSError as error:
        problem = f"the output folder cannot be used: {error_text(error)}"
        raise InputError(problem, file=out, remedy="choose another with -o") from error
    if foreign and JOURNAL not in foreign:
        problem = f"the output folder contains {foreign[0]!r}, and no batch of corridor's"
        raise InputError(problem, file=out, remedy="choose another with -o")
    return folder


def _divide(
    flights: Sequence[FoundFlight], folder: Path, settings: BatchSettings, earlier: dict[str, FleetRow]
) -> tuple[list[Task], list[FleetRow]]:
    """Separate the flights to be fused from the rows of finished ones."""
    configs = {flight.config: settings.config for flight in flights}
    configs |= {file: FusionConfig.from_toml(file) for file in configs if file is not None}
    hashes = {
        file: settings_hash(config.model_dump() | {"method": settings.method}, settings.camera)
        for file, config in configs.items()
    }
    tasks, kept = [], []
    for flight in flights:
        stamp, log_bytes = stamp_of(flight.path)
        row = earlier.get(flight.name)
        if row is not None and not _is_up_to_date(row, hashes[flight.config], folder, settings.reports):
            row = None
        if row is not None and row.log_stamp == stamp and row.path == str(flight.path):
            date = row.date if "T" in row.date else flight.date
            kept.append(replace(row, vehicle=flight.vehicle, date=date))
            continue
        tasks.append(
            Task(
                flight,
                folder,
                configs[flight.config],
                hashes[flight.config],
                settings.camera,
                settings.method,
                settings.reports,
                stamp,
                log_bytes,
                settings.command,
                row,
            )
        )
    return tasks, kept


def _is_up_to_date(row: FleetRow, config_hash: str, folder: Path, reports: bool) -> bool:
    """Whether a row is still up to date."""
    if row.verdict == "error" or (row.config_hash, row.version) != (config_hash, program_version()):
        return False
    wanted = "report.html" if reports else "summary.json"
    return not row.has_result or (folder / row.output / wanted).is_file()


def _workers(settings: BatchSettings, flights: int, notify: Notify) -> AbstractContextManager[Workers]:
    if settings.scheduler is not None:
        return cluster_workers(settings.scheduler, settings.timeout_s, notify)
    jobs = max(1, min(settings.jobs or usable_cores(), flights))
    memory_bytes = settings.memory_bytes or usable_memory_bytes() // jobs
    return local_workers(jobs, memory_bytes, settings.timeout_s, notify)


def usable_memory_bytes() -> int:
    """Return the memory of the machine, or of the container if that is less; 4 GB if neither is known."""
    try:
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        machine = 4 * 10**9
    try:
        container = Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii").strip()
    except OSError:
        container = "max"
    return min(machine, int(container)) if container.isdigit() else machine


def _finished(tasks: Sequence[Task], workers: Workers) -> Iterator[list[tuple[Task, Future[FleetRow]]]]:
    """Distribute tasks, a few in advance, and yield those that have ended since the last time."""
    waiting = iter(tasks)
    running: dict[Future[FleetRow], Task] = {}
    while True:
        while len(running) < _QUEUED * workers.capacity() and (task := next(waiting, None)) is not None:
            running[workers.submit(task)] = task
        if not running:
            return
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        yield [(running.pop(future), future) for future in done]


def _row(task: Task, future: Future[FleetRow], workers: Workers) -> FleetRow:
    lost = workers.lost(task)
    try:
        return replace(future.result(), lost_workers=lost)
    except CancelledError as error:
        raise InputError(
            "the cluster has gone", remedy="run the same again: the flights that are done are kept"
        ) from error
    except Exception as error:  # of the process or the cluster; a flight's own errors are in its row
        flight = task.flight
        return FleetRow(
            flight=flight.name,
            vehicle=flight.vehicle,
            date=flight.date,
            path=str(flight.path),
            log_bytes=task.log_bytes,
            log_stamp=task.stamp,
            config_hash=task.config_hash,
            version=program_version(),
            lost_workers=lost,
            **failure(error),
        )


class _Table:
    """The rows so far, written to the journal at once and to the tables soon after."""

    def __init__(
        self,
        folder: Path,
        kept: Sequence[FleetRow],
        total: int,
        against: Sequence[FleetRow],
        journal: Journal,
    ) -> None:
        self.rows = {row.flight: row for row in kept}
        self._folder, self._total, self._against, self._journal = folder, total, against, journal
        self._next_s = 0.0

    def add(self, rows: Sequence[FleetRow]) -> None:
        """Add flights' rows."""
        for row in rows:
            self.rows[row.flight] = row
            self._journal.add(row)
        if time.monotonic() >= self._next_s and len(self.rows) < self._total:  # otherwise `close` writes them
            self._write(
                with_page=self._next_s > 0.0
            )  # not the first time: the page loads the plotting library

    def sorted(self) -> tuple[FleetRow, ...]:
        """Return the rows by name."""
        return tuple(self.rows[name] for name in sorted(self.rows))

    def close(self) -> None:
        """Write the tables for the last time."""
        self._journal.close()
        self._write(with_page=True)

    def _write(self, *, with_page: bool) -> None:
        started = time.monotonic()
        rows = self.sorted()
        write_tables(rows, self._folder)
        if with_page:
            from fusion.fleet.page import write_page

            write_page(rows, self._folder, self._total, self._against)
        ended = time.monotonic()
        self._next_s = ended + max((ended - started) / _WRITING_SHARE, _LEAST_PAUSE_S)
