"""`corridor batch`: whole fleets, what is kept, and what is left when workers or the whole run are killed."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fusion import FusionConfig, fuse_flight, load_flight
from fusion.fleet import page, workers
from fusion.fleet.batch import BatchSettings, Fleet, fuse_fleet
from fusion.fleet.discovery import FoundFlight
from fusion.fleet.journal import read_journal
from fusion.fleet.row import FleetRow
from fusion.fleet.tables import read_fleet
from fusion.fleet.task import Task
from fusion.fleet.worker import fuse_task
from fusion.fleet.workers import local_workers
from fusion.outputs import provenance
from tests.command import Corridor, refused
from tests.files import written
from tests.fusion.fleet import first_worker_killed, make_fleet, simulate
from tests.fusion.fleet_tasks import hang_in_time, kill_or_fuse, prepare_with_this_module, stop_or_fuse
from vision.errors import InputError

TWO = BatchSettings(jobs=2, reports=False)
BRIEF_S = 2.0  # longer than a task that does nothing takes, however busy the machine is
LIMIT_S = 300.0  # against waiting for ever


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate(tmp_path_factory.mktemp("simulated") / "hall")


@pytest.fixture(scope="module")
def fused(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Fleet]:
    """Two good flights, a torn one and one that is not there, fused: source, output, fleet."""
    folder = tmp_path_factory.mktemp("fleet")
    make_fleet(folder / "flights", flight, 2)
    written(folder / "flights" / "torn" / "mav0" / "cam0" / "data.csv", "")
    written(
        folder / "march.toml",
        '[[flight]]\npath = "flights"\n[[flight]]\npath = "flown_away"\nvehicle = "mav9"\n',
    )
    return folder, folder / "out", fuse_fleet([folder / "march.toml"], folder / "out", TWO)


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the page's figures where a test looks at the rows alone: to draw 26 takes longer than to fuse."""
    monkeypatch.setattr(page, "MIN_DRAWN", 10**6)


def by_name(rows: Any) -> dict[str, FleetRow]:
    return {row.flight: row for row in rows}


def test_each_flight_is_fused_as_fuse_does(fused: tuple[Path, Path, Fleet], flight: Path) -> None:
    _, out, fleet = fused
    result = fuse_flight(load_flight(flight))
    row = by_name(fleet.rows)["2026-03-01"]
    assert row.verdict == result.overview.verdict
    assert result.overview.errors is not None
    assert row.heading_rmse_rad == result.overview.errors.filter.heading.rmse
    assert row.frames == len(result.frames) == 21
    assert row.tracking_share == result.overview.status_share["tracking"]
    assert row.checks["frames_used"].value == next(
        check.value for check in result.overview.checks if check.name == "Frames used"
    )
    with (out / row.output / "estimates.csv").open() as file:
        headings = [float(line["heading_rad"]) for line in csv.DictReader(file) if line["heading_rad"]]
    assert headings == pytest.approx(result.estimates["heading_rad"][-len(headings) :], abs=1e-8)


def test_a_bad_flight_is_a_row_with_its_reason(fused: tuple[Path, Path, Fleet]) -> None:
    rows = by_name(fused[2].rows)
    assert sorted(rows) == ["2026-03-01", "2026-03-02", "flown_away", "torn"]
    assert rows["torn"].verdict == "unusable"
    assert "data.csv: is empty" in rows["torn"].reason
    assert rows["torn"].output == ""
    assert rows["flown_away"].verdict == "unusable"
    assert "there is no such file or folder" in rows["flown_away"].reason
    assert rows["flown_away"].vehicle == "mav9"
    assert [rows[name].vehicle for name in ("2026-03-01", "2026-03-02")] == ["mav1", "mav2"]


def test_the_tables_hold_every_row_and_are_read_back(fused: tuple[Path, Path, Fleet]) -> None:
    _, out, fleet = fused
    assert read_fleet(out / "fleet.parquet") == list(fleet.rows)
    from_csv = by_name(read_fleet(out / "fleet.csv"))
    for row in fleet.rows:
        assert from_csv[row.flight].checks == row.checks
        assert from_csv[row.flight].reason == row.reason
        if not row.has_result:
            continue
        assert from_csv[row.flight].heading_rmse_rad == pytest.approx(row.heading_rmse_rad, rel=1e-8)
    assert by_name(read_journal(out).values()) == by_name(fleet.rows)


def test_the_page_links_the_outputs_worst_first(fused: tuple[Path, Path, Fleet]) -> None:
    text = (fused[1] / "fleet.html").read_text()
    assert text.index('<th class="name">torn') < text.index('<a href="flights/2026-03-01/">')
    assert "is empty" in text
    assert "http" not in text.replace("http-equiv", "")


class ThisProcess:
    """Stands for a worker process where only the fusing matters."""

    pid = 0

    def __init__(self, memory_bytes: int | None) -> None:
        pass

    def fuse(self, task: Task, timeout_s: float | None) -> FleetRow:
        return fuse_task(task)

    def end(self) -> None:
        pass


def test_what_is_done_is_kept(flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "_Worker", ThisProcess)
    one = replace(TWO, jobs=1)
    source, out = make_fleet(tmp_path / "flights", flight, 2), tmp_path / "out"
    first = fuse_fleet([source], out, one)
    written_ns = (out / "flights" / "2026-03-01" / "summary.json").stat().st_mtime_ns
    again = fuse_fleet([source], out, one)
    assert (again.kept, again.rows) == (2, first.rows)
    # Touched, not changed: the content tells.
    manifest = source / "2026-03-01" / "flight.toml"
    os.utime(manifest, ns=(1, 1))
    touched = fuse_fleet([source], out, one)
    assert touched.kept == 1
    assert (out / "flights" / "2026-03-01" / "summary.json").stat().st_mtime_ns == written_ns
    assert fuse_fleet([source], out, one).kept == 2
    # Changed: done again, it alone.
    manifest.write_text(manifest.read_text() + "corridor_width_m = 2.0\n")
    changed = fuse_fleet([source], out, one)
    assert changed.kept == 1
    assert (out / "flights" / "2026-03-01" / "summary.json").stat().st_mtime_ns > written_ns
    hashes = [[row.log_hash for row in fleet.rows] for fleet in (first, changed)]
    assert hashes[0][0] != hashes[1][0]
    assert hashes[0][1] == hashes[1][1]
    # Other settings, or an output that has gone: done again.
    other = replace(one, config=FusionConfig(min_lines=5))
    assert fuse_fleet([source], out, other).kept == 0
    (out / "flights" / "2026-03-02" / "summary.json").unlink()
    assert fuse_fleet([source], out, other).kept == 1


def test_a_killed_worker_costs_no_flight(flight: Path, tmp_path: Path) -> None:
    source, out = make_fleet(tmp_path / "flights", flight, 6), tmp_path / "out"
    told: list[str] = []

    def progress(done: int, total: int) -> None:
        if done:  # whole while others are being fused
            assert len(read_fleet(out)) >= 1

    with first_worker_killed(out) as killed:
        fleet = fuse_fleet([source], out, TWO, progress=progress, notify=told.append)
    assert fleet.rows[0].heading_rmse_rad is not None
    assert [row.reason for row in fleet.rows] == [""] * 6
    assert sum(row.lost_workers for row in fleet.rows) == 1
    assert len(told) == 1
    assert f"worker {killed[0]} died while it fused 2026-03-" in told[0]
    assert len({row.heading_rmse_rad for row in fleet.rows}) == 1


def test_a_flight_that_kills_its_workers_is_given_up(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "fuse_task", kill_or_fuse)
    source, out = make_fleet(tmp_path / "flights", flight, 3), tmp_path / "out"
    (source / "2026-03-02").rename(source / "deadly")
    told: list[str] = []
    rows = by_name(fuse_fleet([source], out, TWO, notify=told.append).rows)
    assert rows["deadly"].verdict == "error"
    assert rows["deadly"].reason == "its worker process died 3 times, killed or out of memory"
    assert rows["deadly"].lost_workers == 3
    assert len(told) == 3
    assert told[-1].endswith("deadly: given up")
    assert rows["2026-03-01"].has_result
    assert rows["2026-03-03"].has_result
    monkeypatch.undo()  # an error, unlike a log that cannot be used, is tried again
    again = fuse_fleet([source], out, replace(TWO, jobs=1))
    assert again.kept == 2
    assert by_name(again.rows)["deadly"].has_result


def test_a_flight_that_hangs_is_given_up(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "fuse_task", stop_or_fuse)
    monkeypatch.setattr(workers, "prepare_process", prepare_with_this_module)
    source, out = make_fleet(tmp_path / "flights", flight, 3), tmp_path / "out"
    (source / "2026-03-02").rename(source / "hanging")
    told: list[str] = []
    rows = by_name(fuse_fleet([source], out, replace(TWO, timeout_s=BRIEF_S), notify=told.append).rows)
    assert rows["hanging"].verdict == "error"
    assert rows["hanging"].reason.startswith("took more than 2 s (allow more by --timeout")
    assert rows["hanging"].lost_workers == 0
    assert told == ["hanging took more than 2 s: given up, its worker ended"]
    assert rows["2026-03-01"].has_result
    assert rows["2026-03-03"].has_result
    assert not is_running(int((tmp_path / "stopped").read_text()))


def test_each_output_tells_the_command_and_the_files_that_were_hashed_once(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = FoundFlight("hall", flight)
    task = Task(found, tmp_path, FusionConfig(), "", None, "geometric", False, "", 0, "corridor batch hall")

    def hash_again(path: Path) -> str:
        raise AssertionError(f"{path} was hashed for the fingerprint")

    monkeypatch.setattr(provenance, "sha256_of", hash_again)
    assert fuse_task(task).reason == ""
    told = json.loads((tmp_path / task.folder / "summary.json").read_text())["provenance"]
    assert told["command"] == "corridor batch hall"
    imu = next(entry for entry in told["inputs"] if entry["path"].endswith("imu0/data.csv"))
    assert imu["sha256"] == hashlib.sha256((flight / "mav0" / "imu0" / "data.csv").read_bytes()).hexdigest()


@pytest.mark.usefixtures("no_figures")
def test_a_killed_run_goes_on_and_leaves_no_worker(flight: Path, tmp_path: Path) -> None:
    source, out = make_fleet(tmp_path / "flights", flight, 6), tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "fusion",
        "batch",
        str(source),
        "-o",
        str(out),
        "--jobs",
        "2",
        "--no-reports",
    ]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    while run.poll() is None and not read_journal(out):
        time.sleep(0.005)
    run.kill()
    run.wait()
    rows = read_journal(out)
    assert 1 <= len(rows) < 6
    pids = {int(row.worker.rpartition(":")[2]) for row in rows.values()}
    assert not (out / "fleet.csv").exists() or read_fleet(out / "fleet.csv")
    wait_until_ended(pids)
    fleet = fuse_fleet([source], out, TWO)
    assert fleet.kept >= 1
    assert all(row.has_result for row in fleet.rows)
    assert len(fleet.rows) == 6


def wait_until_ended(pids: Iterable[int]) -> None:
    """Wait for processes that are bound to end, with a limit that only one that hangs reaches."""
    ends = time.monotonic() + LIMIT_S
    while any(map(is_running, pids)):
        assert time.monotonic() < ends
        time.sleep(0.05)


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.usefixtures("no_figures")
def test_an_interrupt_ends_the_workers_and_keeps_the_rows(flight: Path, tmp_path: Path) -> None:
    source, out = make_fleet(tmp_path / "flights", flight, 6), tmp_path / "out"

    def progress(done: int, total: int) -> None:
        if done >= 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fuse_fleet([source], out, TWO, progress=progress)
    assert 2 <= len(read_fleet(out)) <= 6
    assert len(read_fleet(out)) == len(read_journal(out))


def test_a_worker_keeps_to_its_memory_and_threads(flight: Path, tmp_path: Path) -> None:
    task = Task(FoundFlight("hall", flight), tmp_path, FusionConfig(), "", None, "geometric", False, "", 0)
    with local_workers(1, 3 * 10**9, None, print) as one:
        assert one.submit(task).result().has_result
        (worker,) = one._all
        pool = worker._pool
        with pytest.raises(MemoryError):
            pool.submit(bytearray, 4 * 10**9).result()
        assert pool.submit(threads).result() == ([1], 1)
        assert one.submit(task).result().has_result


def test_a_worker_that_loaded_numba_before_can_compile() -> None:
    """As where the script that starts the fleet imports `vision`, and nothing is in numba's cache yet."""
    code = (
        "import numba; from fusion.fleet.worker import limit_threads, prepare_process; prepare_process(None); "
        "limit_threads(); print(numba.njit(lambda x: x + 1)(1))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "2\n", done.stderr


def threads() -> tuple[list[int], int]:
    import cv2
    from threadpoolctl import threadpool_info

    return (
        sorted({library["num_threads"] for library in threadpool_info()}),
        cv2.getNumThreads(),
    )


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a cluster of two workers."""
    distributed = pytest.importorskip("distributed")
    folder = str(tmp_path_factory.mktemp("dask"))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=folder
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.usefixtures("no_figures")
def test_two_workers_of_a_cluster_one_of_them_killed(
    scheduler: str, flight: Path, fused: tuple[Path, Path, Fleet], tmp_path: Path
) -> None:
    source, out = make_fleet(tmp_path / "flights", flight, 6), tmp_path / "out"
    told: list[str] = []
    settings = replace(TWO, scheduler=scheduler)
    with first_worker_killed(out):
        fleet = fuse_fleet([source], out, settings, notify=told.append)
    assert fuse_fleet([source], out, settings).kept == 6
    assert [row.reason for row in fleet.rows] == [""] * 6
    assert sum(row.lost_workers for row in fleet.rows) >= 1
    assert all("died while it fused 2026-03-" in sentence for sentence in told)
    assert told
    local = by_name(fused[2].rows)["2026-03-01"]
    assert {row.heading_rmse_rad for row in fleet.rows} == {local.heading_rmse_rad}


def test_a_flight_that_hangs_on_a_cluster_is_given_up(
    scheduler: str, flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "_fuse_in_time", hang_in_time)
    source, out = make_fleet(tmp_path / "flights", flight, 3), tmp_path / "out"
    (source / "2026-03-02").rename(source / "hanging")
    told: list[str] = []
    settings = replace(TWO, scheduler=scheduler, timeout_s=BRIEF_S)
    rows = by_name(fuse_fleet([source], out, settings, notify=told.append).rows)
    wait_until_ended([int((tmp_path / "hanging").read_text())])
    assert rows["hanging"].reason.startswith("took more than 2 s")
    assert rows["hanging"].lost_workers == 0
    assert told == ["hanging took more than 2 s: given up, its worker ended"]
    assert rows["2026-03-01"].has_result
    assert rows["2026-03-03"].has_result


def test_a_cluster_that_goes_is_told(flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(workers, "_fuse_in_time", hang_in_time)
    source, out = make_fleet(tmp_path / "flights", flight, 2), tmp_path / "out"
    (source / "2026-03-02").rename(source / "hanging")
    cluster = distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, dashboard_address=None, local_directory=str(tmp_path / "dask")
    )

    def progress(done: int, total: int) -> None:
        if done == 1:
            closing.start()

    closing = threading.Thread(target=cluster.close)
    settings = replace(TWO, scheduler=cluster.scheduler_address)
    with pytest.raises(InputError, match="the cluster has gone"):
        fuse_fleet([source], out, settings, progress=progress)
    closing.join()
    assert list(read_journal(out)) == ["2026-03-01"]


# The command


def test_the_command_prints_the_worst_and_what_changed(
    corridor: Corridor, fused: tuple[Path, Path, Fleet]
) -> None:
    folder, out, _ = fused
    run = corridor("batch", folder / "march.toml", "-o", out, "--no-reports", "--jobs", "2")
    assert run.code == 0, run.err
    assert run.out.startswith("4 flights: 2 unusable, ")
    assert "4 kept" in run.out
    assert "unusable  torn: " in run.out
    settings = written(Path("wide.toml"), "corridor_width_m = 2.4\n")
    more = ("--config", settings, "--against", out / "fleet.parquet", "--json")
    run = corridor("batch", folder / "march.toml", "-o", "new", "--no-reports", "--jobs", "1", *more)
    assert run.code == 0, run.err
    assert '"only_before": []' in run.out
    assert '"verdict_before"' in run.out
    assert "The settings differ" in Path("new/fleet.html").read_text()


def test_what_cannot_be_done_is_refused_at_once(
    corridor: Corridor, tmp_path: Path, flight: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused(corridor("batch", "nowhere", "-o", "../out"), "nowhere: there is no such file or folder")
    refused(corridor("batch", tmp_path / "*.bag", "-o", tmp_path / "out"), "no flight was found")
    foreign = written(tmp_path / "mine" / "thesis.txt", "all of it").parent
    refused(corridor("batch", flight, "-o", foreign), "contains 'thesis.txt'", "another with -o")
    refused(corridor("batch", flight, "-o", tmp_path / "o", "--memory", "lots"), "--memory lots", "2GB")
    table = written(tmp_path / "old.csv", "a,b\n1,2\n")
    refused(corridor("batch", flight, "-o", tmp_path / "o", "--against", table), "is not a fleet table")
    monkeypatch.setattr(workers, "CONNECT_S", 0.5)
    scheduler = "tcp://127.0.0.1:9"
    run = corridor("batch", flight, "-o", tmp_path / "o", "--scheduler", scheduler)
    refused(run, f"--scheduler {scheduler}: no scheduler answers", "dask scheduler")
