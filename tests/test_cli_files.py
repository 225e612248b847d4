"""``corridor fuse`` on manifests, logs, and files named one by one, as a user runs it."""

from __future__ import annotations

import os
import shutil
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fusion import load_flight
from fusion.alignment.manifest import load_to_align
from fusion.estimator.tables import ESTIMATE_DTYPE
from fusion.logs.manifest.file import read_manifest
from fusion.outputs.folder import OUTPUT_FILES
from fusion.result.tables_csv import read_table
from tests.command import Corridor, refused
from tests.files import OFFICE
from vision import InputError

N_FRAMES = 30
G = 9.80665


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make hall.mp4, imu.csv (its clock 20 s ahead) and camera.yaml of the first seconds of the sample flight."""
    av = pytest.importorskip("av")
    folder = tmp_path_factory.mktemp("files")
    flight = load_flight(OFFICE)
    assert flight.imu is not None
    t_ns = flight.frames.t_ns[:N_FRAMES]
    with av.open(str(folder / "hall.mp4"), "w") as file:
        stream = file.add_stream("libx264", rate=20, options={"crf": "14"})
        stream.width, stream.height, stream.pix_fmt = (
            flight.camera.width_px,
            flight.camera.height_px,
            "yuv420p",
        )
        stream.codec_context.time_base = Fraction(1, 90000)
        for k in range(N_FRAMES):
            frame = av.VideoFrame.from_ndarray(flight.frames.read(k), format="gray").reformat(
                format="yuv420p"
            )
            frame.pts, frame.time_base = round((t_ns[k] - t_ns[0]) * 9e-5), Fraction(1, 90000)
            for packet in stream.encode(frame):
                file.mux(packet)
        for packet in stream.encode(None):
            file.mux(packet)
    keep = flight.imu.t_ns <= t_ns[-1]
    values = [
        (flight.imu.t_ns[keep] - t_ns[0]) / 1e9 + 20.0,
        flight.imu.gyro_rad_s[keep],
        flight.imu.accel_m_s2[keep] / G,
    ]
    header = "time_s,gyro_x,gyro_y,gyro_z,acc_x_g,acc_y_g,acc_z_g"
    np.savetxt(folder / "imu.csv", np.column_stack(values), "%.9f", ",", header=header, comments="")
    shutil.copy(OFFICE / "mav0" / "cam0" / "sensor.yaml", folder / "camera.yaml")
    return folder


def test_imu_and_video_named_one_by_one(corridor: Corridor, files: Path) -> None:
    named = ("--imu", files / "imu.csv", "--video", files / "hall.mp4", "--camera", files / "camera.yaml")
    run = corridor("fuse", *named, "--clock-offset", "20")
    assert run.code == 0, run.err
    assert set(os.listdir("hall_fused")) == set(OUTPUT_FILES)
    table = read_table("hall_fused/estimates.csv", ESTIMATE_DTYPE)
    assert np.isfinite(table["heading_rad"]).mean() > 0.8
    manifest = read_manifest("hall_fused/flight.toml")
    assert manifest.name == "hall"
    assert manifest.log == files / "imu.csv"
    assert manifest.camera.file == files / "hall.mp4"
    assert manifest.camera.clock_offset_s == 20.0
    assert manifest.imu.topic == "imu"
    # What was written is enough to do it again, from elsewhere too.
    again = corridor("fuse", "hall_fused", "-o", "again")
    assert again.code == 0, again.err
    assert Path("again/estimates.csv").read_bytes() == Path("hall_fused/estimates.csv").read_bytes()


def test_in_python_the_files_are_named_as_on_the_command_line(files: Path) -> None:
    named = {"imu": files / "imu.csv", "video": files / "hall.mp4", "camera": files / "camera.yaml"}
    flight = load_flight(**named, clock_offset_s=20.0)
    assert flight.name == "hall"
    assert flight.imu is not None
    assert len(flight.frames.t_ns) == N_FRAMES
    assert flight.frames.t_ns[0] - flight.imu.t_ns[0] == pytest.approx(0, abs=1_000_000)
    other = load_flight(OFFICE, attitude=str(OFFICE))
    assert other.attitude is not None
    with pytest.raises(InputError, match=r"no pictures are named \(give a flight, or video and imu\)"):
        load_flight(imu=named["imu"])
    with pytest.raises(InputError, match="no such file or folder"):
        load_flight(imu="none.csv", video=named["video"])


def test_a_manifest_and_options_on_top_of_it(corridor: Corridor, files: Path) -> None:
    camera = '[camera]\nfile = "hall.mp4"\ncalibration = "camera.yaml"\n'
    imu = '[imu]\nfile = "imu.csv"\nclock_offset_s = -20.0\nframe = "frd"\n'
    (files / "hall.toml").write_text(camera + imu)
    run = corridor("fuse", files / "hall.toml", "-o", "out")
    assert run.code == 0, run.err
    assert read_manifest("out/flight.toml").imu.clock_offset_s == -20.0
    assert os.path.relpath(files, "out") in Path("out/flight.toml").read_text()
    by_hand = corridor(
        "fuse", files / "hall.toml", "--imu", files / "imu.csv", "--clock-offset", "20", "-o", "other"
    )
    assert by_hand.code == 0, by_hand.err
    one, two = (
        read_table(f"{name}/estimates.csv", ESTIMATE_DTYPE)["heading_rad"] for name in ("out", "other")
    )
    np.testing.assert_allclose(one, two, atol=1e-9)


def test_too_little_is_named(corridor: Corridor, files: Path) -> None:
    refused(corridor("fuse"), "no flight is named", "--imu LOG --video VIDEO")
    refused(corridor("fuse", "--imu", files / "imu.csv"), "no pictures are named")
    refused(corridor("fuse", "--imu", files / "none.csv", "--video", files / "hall.mp4"), "none.csv", "--imu")
    refused(corridor("fuse", files / "imu.csv"), "without pictures", "--video VIDEO --camera CAM.yaml")
    refused(corridor("fuse", files / "hall.mp4"), "contains no calibration of the camera", "--camera")
    named = ("--imu", files / "imu.csv", "--video", files / "hall.mp4", "--camera", files / "camera.yaml")
    refused(corridor("fuse", *named), "covers 20.0 to", "--clock-offset", "20.000")


def test_without_a_calibration_the_lines_to_align_work(
    corridor: Corridor, files: Path, tmp_path: Path
) -> None:
    named = ("--imu", files / "imu.csv", "--video", files / "hall.mp4", "--clock-offset", "20")
    run = corridor("fuse", *named)
    refused(run, "contains no calibration", "`corridor align flight.toml --write`")
    lines = run.err.strip().removesuffix(")").split("lines in flight.toml: ")[1].split(", ")
    described = tmp_path / "flight.toml"
    described.write_text("\n".join(lines) + "\n")
    loaded = load_to_align(described, None)
    assert not loaded.camera_known
    assert loaded.flight.imu is not None
    assert loaded.flight.frames.t_ns[0] == pytest.approx(20_000_000_000)


def test_without_a_calibration_a_phone_s_camera_axis_is_named(
    corridor: Corridor, files: Path, tmp_path: Path
) -> None:
    phone = tmp_path / "sensors"
    phone.mkdir()
    lines = [line.split(",") for line in (files / "imu.csv").read_text().splitlines()[1:]]
    for name, first in (("Gyroscope", 1), ("Accelerometer", 4)):
        rows = [",".join((line[0], *line[first : first + 3])) for line in lines]
        (phone / f"{name}.csv").write_text("\n".join(["seconds_elapsed,x,y,z", *rows, ""]))
    run = corridor("fuse", "--imu", phone, "--video", files / "hall.mp4", "--clock-offset", "20")
    refused(run, "contains no calibration", 'imu.camera_axis = "-z"')


def test_the_file_at_fault_is_named(corridor: Corridor, files: Path, tmp_path: Path) -> None:
    imu = np.loadtxt(files / "imu.csv", delimiter=",", skiprows=1)
    imu[:, 0] -= 20.0
    imu[:, 1:4] *= 1000.0  # no IMU turns so fast
    header = (files / "imu.csv").read_text().splitlines()[0]
    np.savetxt(tmp_path / "fast.csv", imu, "%.9f", ",", header=header, comments="")
    beside = ("--video", files / "hall.mp4", "--camera", files / "camera.yaml")
    refused(corridor("fuse", "--imu", tmp_path / "fast.csv", *beside), "fast.csv: imu: one gyroscope sample")


def test_a_manifest_with_a_slip(corridor: Corridor, files: Path) -> None:
    (files / "slip.toml").write_text('[camera]\nfile = "hall.mp4"\ncalibratoin = "camera.yaml"\n')
    refused(
        corridor("fuse", files / "slip.toml"), "slip.toml", "camera.calibratoin", "did you mean calibration?"
    )


def test_a_manifest_of_the_users_is_not_overwritten(corridor: Corridor, files: Path, tmp_path: Path) -> None:
    hall = tmp_path / "hall"
    hall.mkdir()
    (hall / "flight.toml").write_text(f'log = "{OFFICE.as_posix()}"\n')
    run = corridor("fuse", hall, "-o", hall)
    refused(run, "contains 'flight.toml', which corridor did not write")
    assert (hall / "flight.toml").read_text() == f'log = "{OFFICE.as_posix()}"\n'


def test_a_manifest_does_not_choose_where_the_output_goes(
    corridor: Corridor, files: Path, tmp_path: Path
) -> None:
    for name in ("../../evil", "/evil", "..", "a\\\\b"):
        (files / "evil.toml").write_text(f'name = "{name}"\nlog = "{OFFICE.as_posix()}"\n')
        refused(corridor("fuse", files / "evil.toml"), "name = ", "give a plain name, without slashes")


def test_a_list_of_pictures_names_none_elsewhere(corridor: Corridor, tmp_path: Path) -> None:
    cam = tmp_path / "flight" / "mav0" / "cam0"
    (cam / "data").mkdir(parents=True)
    shutil.copy(OFFICE / "mav0" / "cam0" / "sensor.yaml", cam)
    secret = tmp_path / "secret.jpg"
    shutil.copy(sorted((OFFICE / "mav0" / "cam0" / "data").iterdir())[0], secret)
    for name in ("../../../../secret.jpg", str(secret), "a/../../data.csv"):
        (cam / "data.csv").write_text(f"#timestamp [ns],filename\n1000000000,{name}\n")
        refused(corridor("fuse", tmp_path / "flight"), "data.csv: names", "outside data/")
    (cam / "data.csv").unlink()
    shutil.copy(secret, cam / "data" / "1.jpg")
    (cam / "data" / "times.csv").write_text("timestamp_ns,filename\n1000000000,../../../../secret.jpg\n")
    (tmp_path / "flight.toml").write_text(
        '[camera]\nfile = "flight/mav0/cam0/data"\ntimes = "flight/mav0/cam0/data/times.csv"\n'
        'calibration = "flight/mav0/cam0/sensor.yaml"\n'
    )
    refused(corridor("fuse", tmp_path / "flight.toml"), "names '../../../../secret.jpg', outside the folder")


def test_files_outside_a_manifests_folder_are_told(corridor: Corridor, files: Path, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "flight.toml").write_text(
        f'[camera]\nfile = "{files}/hall.mp4"\ncalibration = "{files}/camera.yaml"\n'
    )
    run = corridor("fuse", tmp_path / "there", "-o", "out")
    assert run.code == 0, run.err
    assert f"flight.toml reads {files}/hall.mp4 and 1 more, outside its folder" in run.err


@pytest.fixture
def odd_name(tmp_path: Path) -> Path:
    """A flight of three pictures in a folder whose name, as an old system wrote it, is not UTF-8."""
    flight = tmp_path / os.fsdecode(b"g\xe4nge") / "flight"
    cam = flight / "mav0" / "cam0"
    try:
        (cam / "data").mkdir(parents=True)
    except OSError:
        pytest.skip("this file system takes only UTF-8 names")
    shutil.copy(OFFICE / "mav0" / "cam0" / "sensor.yaml", cam)
    for picture in sorted((OFFICE / "mav0" / "cam0" / "data").iterdir())[:3]:
        shutil.copy(picture, cam / "data")
    return flight


@pytest.mark.parametrize("verb", ["fuse", "inspect", "align"])
def test_a_name_that_is_not_utf_8_is_refused_before_any_work(
    corridor: Corridor, odd_name: Path, verb: str
) -> None:
    refused(corridor(verb, odd_name), r"g\udce4nge/flight: the name contains bytes", "rename it")
    calibration = odd_name / "mav0" / "cam0" / "sensor.yaml"
    if verb == "fuse":
        refused(corridor(verb, OFFICE, "--camera", calibration), r"sensor.yaml: the name contains bytes")


def test_tables_escape_a_name_that_is_not_utf_8(corridor: Corridor, odd_name: Path) -> None:
    run = corridor("measure", odd_name / "mav0" / "cam0" / "data", "-o", os.fsdecode(b"\xe4.csv"))
    assert run.code == 0, run.err
    assert r"g\udce4nge/flight/mav0" in Path(os.fsdecode(b"\xe4.csv")).read_text("utf-8").splitlines()[1]
    for options in ([], ["--against", os.fsdecode(b"\xe4")]):
        run = corridor(
            "batch", odd_name.parent.parent, "-o", os.fsdecode(b"\xe4" * (1 + len(options))), *options
        )
        assert run.code == 0, run.err
    for name in ("fleet.csv", "fleet.jsonl", "fleet.html"):
        text = (Path(os.fsdecode(b"\xe4")) / name).read_text("utf-8")
        assert r"g\udce4nge/flight: the name" in text.replace("\\\\", "\\"), name
