"""The command ``corridor live``: the estimator on the vehicle."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fusion.cli.console import compile_notice, echo, say
from fusion.cli.options import ConfigOption

if TYPE_CHECKING:
    from fusion.live.core import LiveCore
    from fusion.live.session import LiveSession
    from fusion.live.view import FoxgloveViewer

SHORT_HELP = "On the vehicle: camera and MAVLink in, estimates out."
HELP = """Estimate heading and lateral offset in flight, from a camera and an autopilot's MAVLink, and send them.

PICTURES is a camera's device, a network stream, a video or a folder. --record writes all inputs and outputs to one
file. Ctrl-C ends it. Addresses, messages, wiring and what to check before a flight: docs/live.md.

\b
Examples:
  corridor live /dev/video0 --camera cam.yaml --link /dev/ttyACM0,921600 --config hall.toml --record flight.mcap
  corridor live rtsp://10.0.0.2/front --camera cam.yaml --link udpin:0.0.0.0:14540 --view
  corridor live hall.mp4 --camera cam.yaml --link udpin:127.0.0.1:14540

Next: corridor fuse flight.mcap reproduces the estimates that were sent, bit for bit, and writes a report.
"""


PicturesArgument = Annotated[
    str, typer.Argument(metavar="PICTURES", help="A camera: /dev/video0, rtsp://..., hall.mp4, a folder.")
]
CalibrationOption = Annotated[
    Path, typer.Option("--camera", metavar="CAM.yaml", help="Calibration, as for corridor fuse.")
]
LinkOption = Annotated[
    str, typer.Option("--link", metavar="ADDRESS", help="The autopilot's address, as for pymavlink.")
]
RecordOption = Annotated[
    Path | None, typer.Option("--record", metavar="FILE.mcap", help="Write a recording.")
]
PlotRateOption = Annotated[
    float, typer.Option("--plot-rate", help="NAMED_VALUE_FLOAT per second, for each name; 0: none.")
]
ImuRateOption = Annotated[
    float, typer.Option("--imu-rate", help="IMU messages per second to request; 0: request none.")
]
PositionOption = Annotated[
    str, typer.Option("--position", help="Send a position in ODOMETRY: auto (to ArduPilot), always or never.")
]
VelocityOption = Annotated[
    bool, typer.Option("--use-velocity", help="Use the speed in the autopilot's LOCAL_POSITION_NED.")
]
DurationOption = Annotated[
    float | None, typer.Option("--duration", metavar="SECONDS", help="End after this time.")
]


def live(
    pictures: PicturesArgument,
    camera: CalibrationOption,
    link: LinkOption = "udpin:0.0.0.0:14540",
    config: ConfigOption = None,
    record: RecordOption = None,
    view: Annotated[bool, typer.Option("--view", help="Serve pictures and estimates to Foxglove.")] = False,
    view_host: Annotated[str, typer.Option("--view-host", help="Address to serve at.")] = "127.0.0.1",
    view_port: Annotated[int, typer.Option("--view-port", help="Port to serve at.")] = 8765,
    rate_hz: Annotated[float, typer.Option("--rate", help="Estimates per second.")] = 50.0,
    plot_rate_hz: PlotRateOption = 10.0,
    imu_rate_hz: ImuRateOption = 100.0,
    position: PositionOption = "auto",
    use_velocity: VelocityOption = False,
    duration_s: DurationOption = None,
) -> None:
    """Run until interrupted, and print the result."""
    from fusion import FusionConfig
    from fusion.live.cameras import camera_source
    from fusion.live.clock import HostClock
    from fusion.live.recording import Recorder
    from fusion.live.session import LiveSession, live_config, status_line
    from fusion.live.settings import LiveSettings
    from fusion.settings.toml import build
    from vision import Camera, InputError

    settings = build(
        LiveSettings,
        {
            "rate_hz": rate_hz,
            "plot_rate_hz": plot_rate_hz,
            "imu_rate_hz": imu_rate_hz,
            "send_position": position,
            "use_velocity": use_velocity,
        },
    )
    calibration = Camera.from_yaml(camera)
    fusion_config = live_config(None if config is None else FusionConfig.from_toml(config))
    clock = HostClock()
    source = camera_source(pictures, calibration, clock)
    viewer = _served_viewer(view_host, view_port) if view else None
    recorder = None if record is None else Recorder(record, fusion_config, calibration, settings)
    try:
        session = LiveSession(
            link, source, calibration, fusion_config, settings, recorder=recorder, viewer=viewer, clock=clock
        )
    except InputError:
        if recorder is not None:
            recorder.discard()
        raise
    with _signals_stop(session), compile_notice("the line finder"):
        session.run(duration_s, lambda s: say(status_line(s)))
    echo(_summary(session, record))


def _served_viewer(host: str, port: int) -> FoxgloveViewer:
    """Start serving pictures and estimates, and print the address."""
    from fusion.live.view import FoxgloveViewer

    viewer = FoxgloveViewer(host, port)
    say(f"watch in Foxglove or Lichtblick: open connection ws://{host}:{port}")
    return viewer


@contextmanager
def _signals_stop(session: LiveSession) -> Iterator[None]:
    """Let SIGINT and SIGTERM end the session's run properly within the block."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: session.stop()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def _summary(session: LiveSession, record: Path | None) -> str:
    s, core = session.statistics, session.core
    shares = ", ".join(f"{name} {n / max(s.estimates, 1):.0%}" for name, n in s.statuses.items())
    delay = core.estimate.camera_delay_s
    lines = [
        f"estimates     {s.estimates}: {shares or 'none'}; {s.packets_sent} packets sent",
        f"frames        {s.frames} measured, {s.frames_used} used, {s.frames_dropped} dropped",
        f"latency       p50 {s.latency_ms(50):.1f} ms, p99 {s.latency_ms(99):.1f} ms from shutter to message",
        f"camera delay  {1e3 * delay:.1f} ms +- {1e3 * core.estimate.camera_delay_std_s:.1f}",
        f"autopilot     {_autopilot(core)}, rebooted {core.counters['autopilot_restarts']} times",
        f"reopened      camera {s.camera_reopened}, link {s.link_reopened} times",
    ]
    if record is not None:
        lost = (
            f"; {s.not_recorded} messages were not recorded: the disk was too slow" if s.not_recorded else ""
        )
        lines.append(f"recording     {record}{lost}; next: corridor fuse {record}")
    return "\n".join(lines)


def _autopilot(core: LiveCore) -> str:
    if core.vehicle is None:
        return "none heard"
    trip_ns = core.clock.round_trip_ns
    trip = "" if trip_ns is None else f", round trip {1e-6 * trip_ns:.1f} ms"
    return f"system {core.vehicle.system_id}, clock {core.clock.state}{trip}"
