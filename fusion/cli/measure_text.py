"""Output of ``corridor measure`` besides its table: assumptions and result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import degrees
from pathlib import Path

from fusion.estimator.tables import Table
from fusion.logs.csv.rows import parse_time
from fusion.logs.samples import counted
from fusion.pictures.assumed_camera import AssumedViews
from fusion.pictures.attitude_file import AttitudeFile


def assumptions_text(
    paths: Sequence[Path], views: AssumedViews | None, attitudes: AttitudeFile | None, method: str
) -> list[str]:
    """Describe the assumptions of `fusion.pictures.measure.measure_images` for missing inputs.

    Parameters
    ----------
    paths
        The pictures.
    views
        The fields of view assumed; None with a calibration.
    attitudes
        The given attitudes, if any.
    method
        ``geometric`` or ``paper``, which uses no attitude.
    """
    from vision.frame import UNKNOWN_ATTITUDE

    notes = [] if views is None else views.notes()
    if method == "paper":  # this method uses no attitude
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
    """Summarise the measurement of pictures, and name the output, in one line."""
    reasons = Counter(str(reason) for reason in table["reason"])
    parts = [
        f"{reasons.pop('ok', 0)} measured",
        *(f"{count} {reason}" for reason, count in reasons.most_common()),
    ]
    places = [f"table in {out}"] if out is not None else []
    places += [f"drawings in {overlay}"] if overlay is not None else []
    return "; ".join([f"{counted(len(table), 'picture')}: {', '.join(parts)}", *places])
