"""What a worker is given for one flight."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fusion.estimator.config import FusionConfig
from fusion.fleet.discovery import FoundFlight
from fusion.fleet.row import FleetRow


@dataclass(frozen=True, slots=True)
class Task:
    """One flight to be fused, and where to.

    Parameters
    ----------
    flight
        Which.
    out
        The fleet's folder, absolute.
    config
        Settings.
    config_hash
        Of settings, method and calibration file.
    camera
        Calibration file instead of the log's own.
    method
        How the pictures are measured.
    reports
        Whether to write ``report.html``.
    stamp, log_bytes
        From `fusion.fleet.fingerprint.stamp_of`.
    command
        The command line that asked for it, where there was one.
    earlier
        The flight's row of an earlier batch with the same settings and version; kept if the content is the same.
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
        """The flight's output folder, seen from the fleet's."""
        return f"flights/{self.flight.name}"
