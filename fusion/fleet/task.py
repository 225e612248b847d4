"""Task of a worker: one flight."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fusion.estimator.config import FusionConfig
from fusion.fleet.discovery import FoundFlight
from fusion.fleet.row import FleetRow


@dataclass(frozen=True, slots=True)
class Task:
    """One flight to be fused, and its output.

    Parameters
    ----------
    flight
        The flight.
    out
        The fleet's folder, absolute.
    config
        Settings.
    config_hash
        Of settings, method and calibration file.
    camera
        Calibration file instead of the log's own.
    method
        Method of measuring the pictures.
    reports
        Whether to write ``report.html``.
    stamp, log_bytes
        From `fusion.fleet.fingerprint.stamp_of`.
    command
        The command line, if any.
    earlier
        The flight's row of an earlier batch with the same settings and version; kept if the content is unchanged.
    """

    flight: FoundFlight
    out: Path
    config: FusionConfig
    config_hash: str
    camera: Path | None
    method: str
    reports: bool
    stamp: str
    log_bytes: int
    command: str | None = None
    earlier: FleetRow | None = None

    @property
    def folder(self) -> str:
        """The flight's output folder, relative to the fleet's."""
        return f"flights/{self.flight.name}"
