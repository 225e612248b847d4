"""Pictures of every kind become grey 8-bit ones, or one clear line."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from vision.errors import InputError
from vision.images import read_image, to_grey

GREY = np.arange(12 * 17, dtype=np.uint8).reshape(12, 17)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".pgm"])
def test_grey_files_come_back_as_they_were(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a b ü{suffix}"
    path.write_bytes(cv2.imencode(suffix, GREY)[1].tobytes())
    np.testing.assert_array_equal(read_image(path), GREY)
    np.testing.assert_array_equal(read_image(str(path)), GREY)


def test_colours_are_weighed_as_the_eye_does(tmp_path: Path) -> None:
    bgr = np.zeros((4, 5, 3), dtype=np.uint8)
    bgr[..., 2] = 200  # red: 0.299
    path = tmp_path / "red.png"
    path.write_bytes(cv2.imencode(".png", bgr)[1].tobytes())
    for grey in (read_image(path), to_grey(bgr), to_grey(np.dstack([bgr, np.full((4, 5), 255, np.uint8)]))):
        assert grey.shape == (4, 5)
        assert grey.dtype == np.uint8
        assert np.all(np.abs(grey.astype(int) - 60) <= 1)


def test_sixteen_bits_keep_their_range(tmp_path: Path) -> None:
    deep = (GREY.astype(np.uint16) << 8) + 77
    path = tmp_path / "deep.png"
    path.write_bytes(cv2.imencode(".png", deep)[1].tobytes())
    np.testing.assert_array_equal(read_image(path), GREY)
    np.testing.assert_array_equal(to_grey(deep), GREY)
    np.testing.assert_array_equal(to_grey(np.dstack([deep] * 3)), GREY)


def test_grey_arrays_pass_through() -> None:
    assert to_grey(GREY) is GREY
    np.testing.assert_array_equal(to_grey(GREY[:, :, None]), GREY)
    strided = to_grey(GREY[::2, ::-1])
    assert strided.flags.c_contiguous
    np.testing.assert_array_equal(strided, GREY[::2, ::-1])


@pytest.mark.parametrize(
    ("image", "match"),
    [
        (GREY.astype(np.float32), "type float32 .*uint8 or uint16"),
        (GREY.astype(bool), "type bool"),
        (np.zeros((4, 5, 2), np.uint8), r"shape \(4, 5, 2\)"),
        (np.zeros((0, 5), np.uint8), r"shape \(0, 5\)"),
        (np.zeros(5, np.uint8), r"shape \(5,\)"),
        (np.zeros((2, 4, 5, 3), np.uint8), "shape"),
    ],
)
def test_arrays_that_are_no_pictures(image: npt.NDArray[np.generic], match: str) -> None:
    with pytest.raises(InputError, match=match):
        to_grey(image)


@pytest.mark.parametrize("content", [b"", b"not a picture", cv2.imencode(".png", GREY)[1].tobytes()[:40]])
def test_files_that_do_not_decode(tmp_path: Path, content: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "broken.png"
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"broken\.png: picture does not decode \({len(content)} bytes\)"):
        read_image(path)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("share", [0.3, 0.9, 0.99])
def test_a_picture_cut_short_is_not_half_a_picture(tmp_path: Path, share: float) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (120, 160)).astype(np.uint8)
    whole = cv2.imencode(".jpg", noise)[1].tobytes()
    path = tmp_path / "cut.jpg"
    path.write_bytes(whole)
    assert read_image(path).shape == (120, 160)
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=r"cut\.jpg: picture does not decode"):
        read_image(path)


def test_files_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.png: there is no such picture"):
        read_image(tmp_path / "gone.png")
    with pytest.raises(InputError, match="cannot be read"):
        read_image(tmp_path)
