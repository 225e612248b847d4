"""Procedural grey textures as ripmaps: averaged separately along the two axes.

A floor seen at a flat angle is then blurred along the view and sharp across it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from fusion.simulate.render.mesh import TEXTURE_LEVELS, TEXTURE_SIZE

SIZE, LEVELS = TEXTURE_SIZE, TEXTURE_LEVELS
Picture = npt.NDArray[np.float32]
Canvas = npt.NDArray[np.uint8]


class TextureSet(NamedTuple):
    """All textures: numbers by name, and the concatenated averaged copies.

    A texture's copies are stored row-major by (level along v, level along u); each is (SIZE >> lv, SIZE >> lu).
    """

    number: dict[str, int]
    copies: Picture


def _noise(rng: np.random.Generator, cells: tuple[int, int], octaves: int = 4, gain: float = 0.5) -> Picture:
    """Tileable fractal noise, mean 0, standard deviation 1; ``cells`` along v and u at the coarsest octave."""
    total = np.zeros((SIZE, SIZE), np.float32)
    weight = 1.0
    for octave in range(octaves):
        rows, columns = min(cells[0] << octave, SIZE), min(cells[1] << octave, SIZE)
        coarse = rng.standard_normal((rows, columns)).astype(np.float32)
        padded = np.pad(coarse, 4, mode="wrap")
        scale_v, scale_u = SIZE // rows, SIZE // columns
        fine = cv2.resize(padded, None, fx=scale_u, fy=scale_v, interpolation=cv2.INTER_CUBIC)
        total += weight * fine[4 * scale_v : 4 * scale_v + SIZE, 4 * scale_u : 4 * scale_u + SIZE]
        weight *= gain
    return np.asarray((total - total.mean()) / total.std())


def _plaster(rng: np.random.Generator) -> Picture:
    return 1 + 0.025 * _noise(rng, (2, 2), 3) + 0.02 * _noise(rng, (64, 64), 2)


def _wood(rng: np.random.Generator) -> Picture:
    grain = _noise(rng, (1, 16), 4, 0.7)
    rings = np.sin(3 * _noise(rng, (1, 4), 2) + np.linspace(0, 12 * np.pi, SIZE, endpoint=False))
    return np.asarray(1 + 0.12 * grain + 0.06 * rings, np.float32)


def _speckle(rng: np.random.Generator) -> Picture:
    chips = np.clip(_noise(rng, (32, 32), 3, 0.8), -2, 3)
    return np.asarray(1 + 0.07 * chips + 0.05 * _noise(rng, (2, 2), 3), np.float32)


def _carpet(rng: np.random.Generator) -> Picture:
    return 1 + 0.18 * rng.standard_normal((SIZE, SIZE)).astype(np.float32) + 0.06 * _noise(rng, (4, 4), 3)


def _vinyl(rng: np.random.Generator) -> Picture:
    return 1 + 0.06 * _noise(rng, (2, 2), 6, 0.75)


def _metal(rng: np.random.Generator) -> Picture:
    return 1 + 0.05 * _noise(rng, (2, 1), 2) + 0.03 * _noise(rng, (4, 128), 1)


def _ceiling_board(rng: np.random.Generator) -> Picture:
    holes = np.clip(_noise(rng, (64, 64), 2, 0.9) - 1.6, 0, 1)
    return np.asarray(1 - 0.35 * holes + 0.02 * _noise(rng, (2, 2), 2), np.float32)


def _brick(rng: np.random.Generator, mortar: float = 0.78, joint: int = 3) -> Picture:
    """8 courses of 4 bricks a repetition, running bond; joints so many 32nds of a course wide."""
    picture = 1 + 0.08 * _noise(rng, (32, 32), 3)
    rows, columns = 8, 4
    height, width = SIZE // rows, SIZE // columns
    for row in range(rows):
        shift = (row % 2) * width // 2
        for column in range(columns):
            u = np.arange(column * width + shift, (column + 1) * width + shift) % SIZE
            picture[row * height : (row + 1) * height, u] *= 1 + 0.10 * rng.standard_normal()
        picture[row * height : row * height + joint] = mortar
        for column in range(columns):
            u = (column * width + shift + np.arange(joint)) % SIZE
            picture[row * height : (row + 1) * height, u] = mortar
    return np.asarray(picture, np.float32)


def _brick_light_mortar(rng: np.random.Generator) -> Picture:
    return _brick(rng, 1.6, 4)


def _blocks(rng: np.random.Generator) -> Picture:
    """8 courses of 4 painted blocks a repetition, running bond."""
    picture = 1 + 0.03 * _noise(rng, (32, 32), 3)
    rows, columns = 8, 4
    height, width = SIZE // rows, SIZE // columns
    for row in range(rows):
        picture[row * height : row * height + 2] *= 0.75
        for column in range(columns):
            begin = column * width + (row % 2) * width // 2
            u = np.arange(begin, begin + width) % SIZE
            picture[row * height : (row + 1) * height, u] *= 1 + 0.02 * rng.standard_normal()
            picture[row * height : (row + 1) * height, u[:2]] *= 0.75
    return np.asarray(picture, np.float32)


def _bytes(picture: Picture) -> Canvas:
    """To the 8 bits that OpenCV draws on; values are reflectances 0 to 1."""
    return np.ascontiguousarray(np.clip(255 * picture, 0, 255).astype(np.uint8))


def _ink(reflectance: float) -> int:
    return round(255 * reflectance)


def _text_lines(canvas: Canvas, rng: np.random.Generator, box: tuple[int, int, int, int], ink: int) -> None:
    """Fill a box (top, bottom, left, right) with lines of word-like strokes."""
    top, bottom, left, right = box
    height = int(rng.integers(5, 12))
    for row in range(top, bottom - height, int(height * 1.8)):
        column = left
        while column < right - 4:
            stop = min(column + int(rng.integers(6, 34)), right)
            word = canvas[row : row + height, column:stop]
            word[rng.random(word.shape) < 0.55] = ink
            column = stop + int(rng.integers(3, 6))
            if rng.random() < 0.06:
                break


def _border(canvas: Canvas, width: int, ink: int) -> None:
    if width:
        canvas[:width], canvas[-width:], canvas[:, :width], canvas[:, -width:] = ink, ink, ink, ink


def _poster(rng: np.random.Generator) -> Picture:
    """Draw a sheet: title, coloured fields, a blotchy photograph and lines of text."""
    paper, ink = (230, 25) if rng.random() < 0.7 else (64, 217)
    canvas = np.full((SIZE, SIZE), paper, np.uint8)
    split = int(rng.integers(90, 190))
    photo = _bytes(0.45 + 0.22 * _noise(rng, (4, 4), 4))
    canvas[24:split, 16 : SIZE - 16] = photo[24:split, 16 : SIZE - 16]
    for _ in range(int(rng.integers(1, 6))):
        top, left = rng.integers(20, 180, 2).tolist()
        height, width = rng.integers(15, 80, 2).tolist()
        corner, shade = (
            (min(left + width, SIZE - 16), min(top + height, SIZE - 16)),
            _ink(rng.uniform(0.05, 0.95)),
        )
        if rng.random() < 0.35:
            cv2.circle(canvas, (left, top), int(width / 2.5), shade, -1, cv2.LINE_AA)
        else:
            cv2.rectangle(canvas, (left, top), corner, shade, -1)
    title = "".join(rng.choice(list("ABCDEFGHKLMNOPRSTUVXYZ 0123456789"), 9).tolist())
    cv2.putText(
        canvas, title, (14, min(split + 34, 240)), cv2.FONT_HERSHEY_SIMPLEX, 1.15, ink, 3, cv2.LINE_AA
    )
    _text_lines(canvas, rng, (min(split + 48, 236), 244, 16, SIZE - 16), ink)
    _border(canvas, int(rng.integers(0, 7)), _ink(rng.uniform(0.05, 0.6)))
    return np.asarray(canvas / 255, np.float32)


def _board(rng: np.random.Generator) -> Picture:
    """Draw a cork or felt board with sheets of paper pinned at small angles."""
    canvas = _bytes(rng.uniform(0.2, 0.45) * (1 + 0.12 * _noise(rng, (64, 64), 2)))
    for _ in range(int(rng.integers(5, 14))):
        x, y = rng.uniform(30, SIZE - 30, 2).tolist()
        width, height = float(rng.uniform(22, 60)), float(rng.uniform(28, 75))
        sheet = cv2.boxPoints(((x, y), (width, height), float(rng.normal(0, 4))))
        cv2.fillConvexPoly(
            canvas, np.asarray(sheet * 8, np.int32), _ink(rng.uniform(0.5, 0.95)), cv2.LINE_AA, 3
        )
        box = (y - height / 3, y + height / 3, x - width / 3, x + width / 3)
        _text_lines(canvas, rng, tuple(int(np.clip(v, 4, SIZE - 4)) for v in box), 38)  # type: ignore[arg-type]
    _border(canvas, int(rng.integers(4, 9)), _ink(rng.uniform(0.2, 0.8)))
    return np.asarray(canvas / 255, np.float32)


def _sign(rng: np.random.Generator) -> Picture:
    """Draw a room number."""
    paper, ink = (235, 20) if rng.random() < 0.6 else (46, 230)
    canvas = np.full((SIZE, SIZE), paper, np.uint8)
    number = f"{int(rng.integers(100, 999))}"
    cv2.putText(canvas, number, (20, 140), cv2.FONT_HERSHEY_SIMPLEX, 3.4, ink, 12, cv2.LINE_AA)
    cv2.rectangle(canvas, (24, 180), (230, 192), ink, -1)
    return np.asarray(canvas / 255, np.float32)


def _window(rng: np.random.Generator) -> Picture:
    """Draw the view outside: sky, a hazy horizon, trees or houses; used as emitted light."""
    rows = np.linspace(0, 1, SIZE, dtype=np.float32)[:, None]
    picture = 1.15 - 0.25 * rows + np.zeros((SIZE, SIZE), np.float32)
    skyline = 150 + 18 * _noise(rng, (1, 8), 3)[0]
    mask = np.arange(SIZE)[:, None] > skyline[None, :]
    ground = 0.5 + 0.12 * _noise(rng, (8, 8), 4)
    return np.asarray(np.clip(np.where(mask, ground, picture), 0.1, 1.3), np.float32)


POSTERS = tuple(f"poster{i}" for i in range(8))
BOARDS = tuple(f"board{i}" for i in range(4))
SIGNS = tuple(f"sign{i}" for i in range(5))
WINDOWS = ("window0", "window1")
_DRAW = {
    "plaster": _plaster, "wood": _wood, "speckle": _speckle, "carpet": _carpet, "vinyl": _vinyl, "metal": _metal,
    "ceiling_board": _ceiling_board, "brick": _brick,
    **dict.fromkeys(POSTERS, _poster), **dict.fromkeys(BOARDS, _board), **dict.fromkeys(SIGNS, _sign),
    **dict.fromkeys(WINDOWS, _window), "blocks": _blocks,
    "brick_light_mortar": _brick_light_mortar,
}  # fmt: skip


def _ripmap(picture: Picture) -> list[Picture]:
    # rows are numbered from the bottom: v grows upwards on a wall
    rows = [np.ascontiguousarray(picture[::-1])]
    for _ in range(1, LEVELS):
        rows.append(np.asarray((rows[-1][0::2] + rows[-1][1::2]) / 2, np.float32))
    copies: list[Picture] = []
    for row in rows:
        copy = row
        copies.append(copy)
        for _ in range(1, LEVELS):
            copy = np.asarray((copy[:, 0::2] + copy[:, 1::2]) / 2, np.float32)
            copies.append(copy)
    return copies


@lru_cache(maxsize=1)
def texture_set(seed: int = 2018) -> TextureSet:
    """Draw all textures once per process; the same in every scene (materials vary scale, offset and strength)."""
    number = {name: i for i, name in enumerate(_DRAW)}
    flat = [
        copy.ravel()
        for i, draw in enumerate(_DRAW.values())
        for copy in _ripmap(draw(np.random.default_rng((seed, i))))
    ]
    return TextureSet(number, np.concatenate(flat).astype(np.float32))
