"""Input made to take all memory or time, to crash or to fool a reader: one line, exit code 2, within 5 s and 1 GiB.

The seconds are processor time, which other programs on the machine change little.

Files that failed once lie in ``tests/corpus``; the others are made here.
"""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from fusion.evaluation.truth_file import read_truth
from fusion.printable import printable
from tests.command import Corridor, Run
from tests.files import OFFICE, ROOT, written
from vision import InputError

CORPUS = ROOT / "tests" / "corpus"
PICTURE = sorted((OFFICE / "mav0" / "cam0" / "data").iterdir())[0]
MAX_S = 5.0
LIMIT_S = 300  # of wall clock, against a wait that never ends
MAX_KIB = 1 << 20
MIB = 1 << 20


@pytest.fixture
def refused(corridor: Corridor) -> Iterator[Callable[..., str]]:
    """Run a command that has to refuse, in a line, within bounds of time and memory; gives the line."""

    def too_long(number: int, frame: object) -> None:
        raise TimeoutError(f"not done within {LIMIT_S} s")

    signal.signal(signal.SIGALRM, too_long)  # also ends a wait for a pipe that nobody writes to
    peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    def run(*arguments: str | Path) -> str:
        spent_s = processor_s()
        signal.alarm(LIMIT_S)
        found: Run = corridor(*arguments)
        signal.alarm(0)
        assert processor_s() - spent_s < MAX_S
        *notes, line = found.err.splitlines()
        assert (found.code, found.out) == (2, ""), found
        assert line.startswith("corridor: error: "), found
        assert all(note.startswith("corridor: ") for note in notes), found
        assert printable(found.err, keep="\n") == found.err
        assert os.listdir() == []
        return line

    yield run
    signal.alarm(0)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak_kib < MAX_KIB


def processor_s() -> float:
    """Processor time of this process and of its children that have ended, seconds."""
    return sum(os.times()[:4])


def sixteen_bits(side_px: int) -> bytes:
    """A grey PNG of 16 bits, all black: packed a thousandfold."""
    header = struct.pack(">IIBBBBB", side_px, side_px, 16, 0, 0, 0, 0)
    packer, row = zlib.compressobj(9), bytes(1 + 2 * side_px)
    packed = b"".join(packer.compress(row) for _ in range(min(side_px, 6_000))) + packer.flush()
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in ((b"IHDR", header), (b"IDAT", packed), (b"IEND", b""))
    )


def bag_of_pictures(path: Path, files: list[bytes]) -> Path:
    """A bag of pictures as files, ten a second."""
    from tests.fusion.test_log_rosbag import Bag

    with Bag(path, "mcap") as bag:
        for k, data in enumerate(files):
            t_ns = 1_600_000_000_000_000_000 + k * 100_000_000
            bag.write("/cam/compressed", bag.compressed(t_ns, data, "mono16; png compressed"), t_ns)
    return path


def calibration(folder: Path, **changes: str) -> Path:
    """Write the sample's calibration with fields changed."""
    text = (OFFICE / "mav0" / "cam0" / "sensor.yaml").read_text()
    for field, value in changes.items():
        text = re.sub(rf"^{field}:.*$", f"{field}: {value}", text, flags=re.MULTILINE)
    return written(folder / "camera.yaml", text)


def sparse(path: Path, text: str = "", size: int = 2 << 30) -> Path:
    """Write a file that begins so and then has two gigabytes of nothing, which take no room on the disk."""
    written(path, text)
    os.truncate(path, size)
    return path


@pytest.mark.parametrize(
    "path", sorted(p for p in CORPUS.iterdir() if p.is_file()), ids=lambda path: path.name
)
def test_a_file_that_failed_once(path: Path, refused: Callable[..., str]) -> None:
    if "config" in path.name:
        line = refused("config", path)
    elif path.suffix == ".toml":
        line = refused("fuse", path)
    elif path.suffix == ".bag":
        line = refused("inspect", path)
    else:
        line = refused("measure", PICTURE, "--camera", path)
    assert path.name in line


class TestBombs:
    @pytest.mark.parametrize("kind", ["ros1-bz2", "ros1-lz4", "mcap-zstd", "message-zstd", "file-zstd"])
    def test_a_bag(self, kind: str, tmp_path: Path, refused: Callable[..., str]) -> None:
        path = packed_bag(tmp_path / "bomb", kind)
        assert sum(file.stat().st_size for file in [path, *path.glob("*")]) < MIB
        line = refused("inspect", path)
        assert "bomb" in line
        if not kind.startswith("file"):
            assert "packed bytes become more than" in line

    def test_pictures(self, tmp_path: Path, refused: Callable[..., str]) -> None:
        header = struct.pack(">IIBBBBB", 30_000, 30_000, 8, 0, 0, 0, 0)
        chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(bytes(MIB))), (b"IEND", b"")]
        png = b"\x89PNG\r\n\x1a\n" + b"".join(
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
            for kind, data in chunks
        )
        (tmp_path / "bomb.png").write_bytes(png)
        assert "too many pixels" in refused("measure", tmp_path / "bomb.png")
        size = struct.pack(">HH", 9_000, 9_000)
        jpeg = PICTURE.read_bytes()
        at = jpeg.index(b"\xff\xc0") + 5
        (tmp_path / "bomb.jpg").write_bytes(jpeg[:at] + size + jpeg[at + 4 :])
        assert "9000x9000 pixels" in refused("measure", tmp_path / "bomb.jpg")
        assert "9000x9000 pixels" in refused(
            "measure", tmp_path / "bomb.jpg", "--camera", calibration(tmp_path)
        )

    @pytest.mark.parametrize("side_px", [6_000, 30_000])
    def test_pictures_in_a_bag(self, side_px: int, tmp_path: Path, corridor: Corridor) -> None:
        """Tiny files of 16 bits whose headers claim a thousand times the camera's pixels: counted, never unpacked."""
        bomb = sixteen_bits(side_px)
        assert len(bomb) < MIB
        bag = bag_of_pictures(tmp_path / "bag", [PICTURE.read_bytes(), bomb, bomb, PICTURE.read_bytes()])
        peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        run = corridor("fuse", bag, "--camera", calibration(tmp_path), "-o", tmp_path / "out")
        assert run.code == 0, run.err
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak_kib < MAX_KIB // 4
        rows = (tmp_path / "out" / "frames.csv").read_text().splitlines()[1:]
        assert [row.split(",")[2] == "unreadable" for row in rows] == [False, True, True, False]

    def test_a_text_of_two_gigabytes(self, tmp_path: Path, refused: Callable[..., str]) -> None:
        line = f"has {2 << 30} bytes, too many"
        assert line in refused("config", sparse(tmp_path / "a.toml", "method = 1\n"))
        assert line in refused("fuse", sparse(tmp_path / "b.toml", 'log = "x"\n'))
        assert line in refused("measure", PICTURE, "--camera", sparse(tmp_path / "c.yaml", "a: 1\n"))
        bag = tmp_path / "bag"
        sparse(bag / "metadata.yaml", "rosbag2_bagfile_information:\n")
        assert line in refused("inspect", bag)
        refused("fuse", "--imu", sparse(tmp_path / "d.csv", "t,x\n"), "--video", OFFICE)

    @pytest.mark.parametrize(
        "text",
        [
            ".".join(["a"] * 20_000) + " = 1",
            "[" + ".".join(["a"] * 20_000) + "]",
            f"x = {'[' * 5_000}{']' * 5_000}",
            f"x = {'{a = ' * 300}1{'}' * 300}",
            f"x = {'9' * 5_000}",
            f"x = {'9' * 400}",
            "\n".join(f"a{k}.b.c = {k}" for k in range(14_000)),
            'camera_delay_s = "1 ' + " " * 100_000 + 'x"',
            "k" * 100_000 + " = 1",
        ],
        ids=["name", "table", "lists", "tables", "digits", "whole", "many", "unit", "long"],
    )
    def test_toml(self, text: str, tmp_path: Path, refused: Callable[..., str]) -> None:
        assert "x.toml" in refused("config", written(tmp_path / "x.toml", text))
        assert "x.toml" in refused("fuse", tmp_path / "x.toml")

    @pytest.mark.parametrize(
        "field", ["T_BS", "resolution", "intrinsics", "distortion_coefficients", "camera_model"]
    )
    def test_aliases_in_every_field(self, field: str, tmp_path: Path, refused: Callable[..., str]) -> None:
        for width, levels in ((10, 9), (2, 5)):
            lines = [f"a0: &a0 [{','.join(['1'] * 20_000)}]"]
            lines += [f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * width)}]" for k in range(1, levels)]
            path = calibration(tmp_path, **{field: f"*a{levels - 1}"})
            written(path, "\n".join(lines) + "\n" + path.read_text())
            line = refused("measure", PICTURE, "--camera", path)
            assert "aliases" in line or "values" in line

    def test_merged_mappings(self, tmp_path: Path, refused: Callable[..., str]) -> None:
        lines = ["m0: &m0 {a: 1}"]
        lines += [f"m{k}: &m{k} {{<<: [{','.join([f'*m{k - 1}'] * 10)}]}}" for k in range(1, 9)]
        line = refused("measure", PICTURE, "--camera", written(tmp_path / "x.yaml", "\n".join(lines)))
        assert "aliases" in line

    def test_a_line_that_a_search_could_take_forever_on(
        self, tmp_path: Path, refused: Callable[..., str]
    ) -> None:
        for number, line in enumerate(
            [
                "k" * 60_000,
                "1," * 30_000,
                "1" + " " * 60_000,
                "(" * 60_000,
                " " * 60_000 + "x[" + " " * 60_000,
            ]
        ):
            text = f"{line}\n{line}\n"
            path = written(tmp_path / f"{number}.csv", text)
            refused("fuse", "--imu", path, "--video", PICTURE.parent, "--camera", calibration(tmp_path))
            refused("evaluate", tmp_path, "--truth", path)

    def test_a_text_without_line_breaks(self, tmp_path: Path, refused: Callable[..., str]) -> None:
        path = written(tmp_path / "x.csv", "t,gx,gy,gz,ax,ay,az\n" + "1" * (20 * MIB))
        refused("fuse", "--imu", path, "--video", PICTURE.parent, "--camera", calibration(tmp_path))


def packed_bag(path: Path, kind: str) -> Path:
    """Write a bag of one message of 128 MiB of zeros, packed."""
    pytest.importorskip("rosbags")
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    writer: Any
    if kind.startswith("ros1"):
        path = path.with_suffix(".bag")
        writer, store = rosbag1.Writer(path), get_typestore(Stores.ROS1_NOETIC)
        writer.set_compression(getattr(rosbag1.Writer.CompressionFormat, kind[-3:].upper()))
    else:
        plugin = rosbag2.StoragePlugin.MCAP if kind.startswith("mcap") else rosbag2.StoragePlugin.SQLITE3
        writer, store = (
            rosbag2.Writer(path, version=9, storage_plugin=plugin),
            get_typestore(Stores.ROS2_HUMBLE),
        )
        mode = "STORAGE" if kind.startswith("mcap") else kind.split("-")[0].upper()
        writer.set_compression(getattr(rosbag2.CompressionMode, mode), rosbag2.CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        writer.write(topic, 10**18, bytes(128 * MIB))
    return path


class TestPipes:
    @pytest.fixture
    def pipe(self, tmp_path: Path) -> Path:
        os.mkfifo(tmp_path / "pipe.csv")
        return tmp_path / "pipe.csv"

    def test_named_as_a_file(self, pipe: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
        word = "pipe or a device"
        assert word in refused("measure", pipe)
        assert word in refused("measure", PICTURE, "--camera", pipe)
        assert word in refused("measure", PICTURE, "--attitude", pipe)
        assert word in refused("config", pipe)
        assert word in refused("fuse", OFFICE, "--config", pipe)
        with pytest.raises(InputError, match=word):
            read_truth(pipe)
        refused("inspect", pipe)
        refused("fuse", pipe)
        refused("fuse", "--imu", pipe, "--video", PICTURE.parent, "--camera", calibration(tmp_path))
        refused("fuse", "--imu", pipe, "--video", pipe)

    def test_among_the_pictures_of_a_flight(
        self, tmp_path: Path, corridor: Corridor, refused: Callable[..., str]
    ) -> None:
        cam = tmp_path / "flight" / "mav0" / "cam0"
        (cam / "data").mkdir(parents=True)
        shutil.copy(OFFICE / "mav0" / "cam0" / "sensor.yaml", cam)
        os.mkfifo(cam / "data" / "1600001000000000000.jpg")
        refused("inspect", cam / "data" / "1600001000000000000.jpg")
        assert corridor("fuse", tmp_path / "flight", "-o", tmp_path / "out").code == 0
        assert ",unreadable," in (tmp_path / "out" / "frames.csv").read_text()
        os.mkfifo(cam / "data.csv")
        refused("fuse", tmp_path / "flight")

    def test_a_device_is_written_to_and_stays(self, corridor: Corridor) -> None:
        run = corridor("measure", PICTURE, "-o", "/dev/null")
        assert run.code == 0
        assert not Path("/dev/null").is_file()


class TestValues:
    @pytest.mark.parametrize(
        ("field", "value"),
        [
            ("resolution", "[.inf, 480]"),
            ("resolution", "[.nan, 480]"),
            ("resolution", f"[{'9' * 400}, 480]"),
            ("resolution", "[1000000000, 480]"),
            ("resolution", f"{'[' * 5_000}{']' * 5_000}"),
            ("intrinsics", f"[{'9' * 5_000}, 1, 1, 1]"),
            ("camera_model", "{}"),
        ],
    )
    def test_in_a_calibration(
        self, field: str, value: str, tmp_path: Path, refused: Callable[..., str]
    ) -> None:
        refused("measure", PICTURE, "--camera", calibration(tmp_path, **{field: value}))

    def test_nesting_in_json(self, tmp_path: Path, refused: Callable[..., str]) -> None:
        refused("measure", PICTURE, "--camera", written(tmp_path / "x.json", "[" * 5_000 + "]" * 5_000))
        refused(
            "measure", PICTURE, "--camera", written(tmp_path / "y.json", '{"K": ' * 5_000 + "1" + "}" * 5_000)
        )

    @pytest.mark.parametrize(
        "value", ['"v\\u0000.mp4"', '"~nosuchuser/v.mp4"', '"v\\u001b[31m.mp4"', f'"{"v" * 5000}"']
    )
    def test_paths_in_a_manifest(self, value: str, tmp_path: Path, refused: Callable[..., str]) -> None:
        for text in (
            f"log = {value}\n",
            f"[camera]\nfile = {value}\n",
            f'log = "x"\n[imu]\nnoise = {value}\n',
        ):
            refused("fuse", written(tmp_path / "x.toml", text))

    def test_start_beyond_all_clocks(self, tmp_path: Path, refused: Callable[..., str]) -> None:
        for start in (2**63, -(2**63), 2**62 + 1):
            refused("fuse", written(tmp_path / "x.toml", f'[camera]\nfile = "v.mp4"\nstart_ns = {start}\n'))

    @pytest.mark.parametrize("field", ["x" * 200_000, "9" * 5_000, "1e999", '"' + "x" * 200_000])
    def test_fields_of_a_table(self, field: str, tmp_path: Path, refused: Callable[..., str]) -> None:
        refused(
            "measure",
            PICTURE,
            "--attitude",
            written(tmp_path / "a.csv", f"image,roll_rad,pitch_rad\nx,{field},0\n"),
        )
        refused(
            "measure",
            PICTURE,
            "--attitude",
            written(tmp_path / "b.csv", f"timestamp_ns,qw,qx,qy,qz\n{field},1,0,0,0\n"),
        )
        for name in ("estimates.csv", "smoothed.csv", "frames.csv"):
            written(tmp_path / "out" / name, f"timestamp_ns\n{field}\n")
        written(tmp_path / "out" / "summary.json", '{"verdict": "pass"}')
        refused("evaluate", tmp_path / "out", "--truth", OFFICE)
        refused(
            "evaluate",
            tmp_path / "out",
            "--truth",
            written(tmp_path / "t.csv", f"timestamp_ns,heading_rad\n{field},{field}\n"),
        )
        imu = written(tmp_path / "imu.csv", f"timestamp_ns,gx,gy,gz,ax,ay,az\n{field},1,1,1,1,1,1\n")
        refused("fuse", "--imu", imu, "--video", PICTURE.parent, "--camera", calibration(tmp_path))
        shutil.copytree(
            OFFICE / "mav0" / "cam0", tmp_path / "f" / "mav0" / "cam0", ignore=shutil.ignore_patterns("*.jpg")
        )
        written(tmp_path / "f" / "mav0" / "cam0" / "data.csv", f"#timestamp,filename\n{field},{field}\n")
        refused("fuse", tmp_path / "f")

    def test_a_summary_nested_deeply(self, tmp_path: Path, refused: Callable[..., str]) -> None:
        written(tmp_path / "out" / "summary.json", "[" * 100_000)
        for name in ("estimates.csv", "smoothed.csv", "frames.csv"):
            written(tmp_path / "out" / name, "x\n")
        refused("evaluate", tmp_path / "out", "--truth", OFFICE)
        assert "did not write" in refused("fuse", OFFICE, "-o", tmp_path / "out")


class TestTerminal:
    ESCAPE = "\x1b]0;owned\x07\x9b31m\u202e"

    def test_names_are_shown_escaped(self, tmp_path: Path, refused: Callable[..., str]) -> None:
        line = refused("fuse", tmp_path / f"a{self.ESCAPE}")
        assert r"a\x1b]0;owned\x07\x9b31m\u202e" in line
        line = refused("config", written(tmp_path / "x.toml", '"\\u001b[31m" = "\\u009b2J"\n'))
        assert "\\x1b" in line
        line = refused("measure", written(tmp_path / "line\nbreak.jpg", ""))
        assert "line break.jpg" in line

    def test_what_inspect_prints(self, corridor: Corridor, tmp_path: Path) -> None:
        flight = tmp_path / f"flight{self.ESCAPE}"
        shutil.copytree(OFFICE, flight)
        with (flight / "mav0" / "cam0" / "data.csv").open("a") as file:
            file.write(f"1600001016000000000,gone{self.ESCAPE}.jpg\n")
        for options in ((), ("--json",)):
            run = corridor("inspect", flight, *options)
            assert run.code == 0, run.err
            assert printable(run.out, keep="\n") == run.out
            assert "owned" in run.out
            assert printable(run.err, keep="\n") == run.err

    def test_lines_do_not_grow_with_the_file(self, tmp_path: Path, refused: Callable[..., str]) -> None:
        text = f"resolution: [{', '.join(['1'] * 20_000)}]"
        line = refused(
            "measure", PICTURE, "--camera", written(tmp_path / "x.yaml", f"{text}\nT_BS: 1\nintrinsics: 1\n")
        )
        assert len(line) < 2_500
