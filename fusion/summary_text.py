"""A fused flight or a set of pictures in words: what the command line prints, plain and stable.

Numbers come from the summary that is written beside the tables; nothing is computed here but units.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion.logs.csv_table import counted, parse_time
from fusion.measure_images import ASSUMED_FOV_RAD
from fusion.tables import Table

if TYPE_CHECKING:
    from fusion.attitude_file import AttitudeFile
    from vision import Camera


def assumptions_text(
    paths: Sequence[Path], camera: Camera | None, attitudes: AttitudeFile | None, method: str
) -> list[str]:
    """Say what `measure_images` takes for granted where it was not told."""
    from vision.frame import UNKNOWN_ATTITUDE

    notes = []
    if camera is None:
        view = f"a horizontal field of view of {degrees(ASSUMED_FOV_RAD):.0f} degrees"
        notes.append(f"no --camera: assuming {view}, no distortion, looking straight ahead")
    if method == "paper":  # which uses no attitude
        return notes
    level = f"assuming level within about {degrees(UNKNOWN_ATTITUDE.std_rad):.0f} degrees"
    if attitudes is None:
        return [*notes, f"no --attitude: {level}"]
    missing = sum(attitudes.of(path, parse_time(path.stem)) is None for path in paths)
    notes += attitudes.problems
    if missing:
        notes.append(f"{counted(missing, 'picture')} without an attitude in --attitude: {level}")
    return notes


def measured_text(table: Table, out: Path | None, overlay: Path | None) -> str:
    """Say in one line what came of measuring pictures, and where it lies."""
    reasons = Counter(str(reason) for reason in table["reason"])
    parts = [
        f"{reasons.pop('ok', 0)} measured",
        *(f"{count} {reason}" for reason, count in reasons.most_common()),
    ]
    places = [f"table in {out}"] if out is not None else []
    places += [f"drawings in {overlay}"] if overlay is not None else []
    return "; ".join([f"{counted(len(table), 'picture')}: {', '.join(parts)}", *places])


def fusion_text(summary: dict[str, Any], folder: Path) -> str:
    """Lay out a summary for reading."""
    raise NotImplementedError
