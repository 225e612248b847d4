"""An alignment as the command line shows it."""

from __future__ import annotations

from math import degrees, isfinite
from textwrap import wrap

from fusion.alignment.result import Alignment, Quantity
from fusion.printable import printable

WIDTH = 110
_LABELS = {
    "clock_offset_s": "time offset",
    "clock_rate": "clock rate",
    "focal_scale": "focal length",
    "mount_yaw_rad": "mounting yaw",
    "mount_pitch_rad": "mounting pitch",
    "mount_roll_rad": "mounting roll",
}


def alignment_text(alignment: Alignment) -> str:
    """Return a line per quantity, each followed by its meaning."""
    lines = [f"{'':15} {'found':>12}  {'sigma':>10}"]
    for quantity in alignment.quantities:
        value, sigma = _numbers(quantity)
        lines.append(f"{_LABELS[quantity.name]:15} {value:>12}  {sigma:>10}  {_verdict(quantity)}".rstrip())
        lines += wrap(quantity.sentence, WIDTH, initial_indent="  ", subsequent_indent="  ")
    frames = (
        f"{alignment.n_frames} frames read, {alignment.n_used} of them used for time offset and focal length."
    )
    return "\n".join(printable(line) for line in [*lines, *alignment.notes, frames])


def note_of(quantity: Quantity) -> str:
    """Return the comment on a quantity in a manifest."""
    value, sigma = _numbers(quantity)
    if quantity.changes:
        return f"corridor align: sigma {sigma}"
    return f"left as it was: corridor align found {value}, sigma {sigma}"


def _verdict(quantity: Quantity) -> str:
    if quantity.changes:
        return "corrects"
    return "fits" if quantity.usable else "not known"


def _numbers(quantity: Quantity) -> tuple[str, str]:
    """Value and sigma with their unit; a dash if nothing was found."""
    value, sigma = quantity.value, quantity.sigma
    if quantity.name == "clock_offset_s":
        texts = f"{1e3 * value:.1f} ms", f"{1e3 * sigma:.1f} ms"
    elif quantity.name == "clock_rate":
        texts = f"x {value:.5f}", f"{sigma:.5f}"
    elif quantity.name == "focal_scale":
        texts = f"x {value:.4f}", f"{sigma:.4f}"
    else:
        texts = f"{degrees(value):.2f} deg", f"{degrees(sigma):.2f} deg"
    return texts[0] if isfinite(value) else "-", texts[1] if isfinite(sigma) else "-"
