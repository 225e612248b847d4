"""What goes wrong with sensors and with the world they see, as changes of a recording's events.

Each function returns an `Injection`; those of a pair are applied one after the other. Times are seconds of
the flight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from math import asin, atan2, cos, inf, pi, radians, sin
from typing import Any

import numpy as np

from tests.fusion.simulated import wrap_half
from vision import Attitude, Reason
from vision.rotations import yaw_of_quaternion

from .recording import Event, FloatArray, Kind, Recording

Injection = Callable[[Recording, np.random.Generator], Recording]
Change = Callable[[Event, np.random.Generator], Iterable[Event]]
Profile = Callable[[float], float]

FOCAL_LENGTH_PX = 500.0  # of the camera whose calibration is wrong: 65 degrees over 640 pixels


def constant(angle_deg: float) -> Profile:
    """Return an angle or rate that stays, given in degrees."""
    return lambda _: radians(angle_deg)


def ramp(deg_per_s: float) -> Profile:
    """Return an angle or rate that grows, given in degrees per second."""
    return lambda t: radians(deg_per_s) * t


def each(kind: Kind, change: Change, start_s: float, end_s: float = inf) -> Injection:
    """Change every event of a kind between two times."""

    def inject(recording: Recording, rng: np.random.Generator) -> Recording:
        events: list[Event] = []
        for event in recording.events:
            if event.kind == kind and start_s <= event.t_s < end_s:
                events.extend(change(event, rng))
            else:
                events.append(event)
        return recording.with_events(events)

    return inject


def first(kind: Kind, change: Change, at_s: float) -> Injection:
    """Change the first event of a kind from a time on."""

    def inject(recording: Recording, rng: np.random.Generator) -> Recording:
        events = list(recording.events)
        k = next((k for k, e in enumerate(events) if e.kind == kind and e.t_s >= at_s), None)
        if k is None:  # the flight has ended
            return recording
        events[k : k + 1] = change(events[k], rng)
        return recording.with_events(events)

    return inject


def together(injections: Sequence[Injection]) -> Injection:
    """Apply several, one after the other."""

    def inject(recording: Recording, rng: np.random.Generator) -> Recording:
        for injection in injections:
            recording = injection(recording, rng)
        return recording

    return inject


# --- the IMU ---


def _with_gyro(event: Event, gyro: tuple[float, float, float]) -> Event:
    return replace(event, values=(gyro, event.values[1]))


def gyro_added(rate_rad_s: Profile, start_s: float, end_s: float = inf) -> Injection:
    """Add a rate, a function of the time since the start, to the gyroscope's z."""

    def change(event: Event, _: np.random.Generator) -> list[Event]:
        p, q, r = event.values[0]
        return [_with_gyro(event, (p, q, r + rate_rad_s(event.t_s - start_s)))]

    return each("imu", change, start_s, end_s)


def gyro_mapped(rate_of: Callable[[float], float], start_s: float, end_s: float = inf) -> Injection:
    """Pass each axis of the gyroscope through a function: scale, range, unit."""

    def change(event: Event, _: np.random.Generator) -> list[Event]:
        p, q, r = map(rate_of, event.values[0])
        return [_with_gyro(event, (p, q, r))]

    return each("imu", change, start_s, end_s)


def gyro_scaled(factor: float, start_s: float) -> Injection:
    """Let the gyroscope's scale be wrong."""
    return gyro_mapped(lambda rate: factor * rate, start_s)


def gyro_spikes(rate_rad_s: float, share: float, start_s: float, end_s: float) -> Injection:
    """Add a rate to the z of a share of the samples."""

    def change(event: Event, rng: np.random.Generator) -> list[Event]:
        p, q, r = event.values[0]
        hit = rng.uniform() < share
        return [_with_gyro(event, (p, q, r + rate_rad_s)) if hit else event]

    return each("imu", change, start_s, end_s)


def gyro_once(rate_rad_s: float, at_s: float) -> Injection:
    """Make one sample's z this rate."""
    return first("imu", lambda e, _: [_with_gyro(e, (*e.values[0][:2], rate_rad_s))], at_s)


def accel_mapped(signs: tuple[float, float, float], start_s: float = 0.0) -> Injection:
    """Multiply the accelerometer's axes."""

    def change(event: Event, _: np.random.Generator) -> list[Event]:
        gyro, accel = event.values
        return [replace(event, values=(gyro, tuple(s * a for s, a in zip(signs, accel, strict=True))))]

    return each("imu", change, start_s)


def gyro_axes(signs: tuple[float, float, float], start_s: float = 0.0) -> Injection:
    """Multiply the gyroscope's axes."""

    def change(event: Event, _: np.random.Generator) -> list[Event]:
        p, q, r = (s * w for s, w in zip(signs, event.values[0], strict=True))
        return [_with_gyro(event, (p, q, r))]

    return each("imu", change, start_s)


def gyro_mounted(R_read_body: FloatArray, start_s: float = 0.0) -> Injection:
    """Read the gyroscope along other axes: a rotation (3, 3), or one that exchanges or reverses axes."""

    def change(event: Event, _: np.random.Generator) -> list[Event]:
        p, q, r = (R_read_body @ event.values[0]).tolist()
        return [_with_gyro(event, (p, q, r))]

    return each("imu", change, start_s)


def gyro_z_stuck(start_s: float, end_s: float) -> Injection:
    """Repeat the z of the first sample; the other axes live."""

    def inject(recording: Recording, rng: np.random.Generator) -> Recording:
        stuck = next(e.values[0][2] for e in recording.events if e.kind == "imu" and e.t_s >= start_s)
        held = each("imu", lambda e, _: [_with_gyro(e, (*e.values[0][:2], stuck))], start_s, end_s)
        return held(recording, rng)

    return inject


def gyro_lagging(time_s: float, start_s: float) -> Injection:
    """Pass the gyroscope through a low-pass filter of first order with this time constant."""

    def inject(recording: Recording, rng: np.random.Generator) -> Recording:
        last_s, smooth = -inf, np.zeros(3)

        def change(event: Event, _: np.random.Generator) -> list[Event]:
            nonlocal last_s, smooth
            smooth = smooth - np.expm1((last_s - event.t_s) / time_s) * (event.values[0] - smooth)
            last_s = event.t_s
            p, q, r = smooth.tolist()
            return [_with_gyro(event, (p, q, r))]

        return each("imu", change, start_s)(recording, rng)

    return inject


# --- any source ---


def held(kind: Kind, samples: int, start_s: float) -> Injection:
    """Repeat each value for so many samples: a sensor that is read more often than it measures."""

    def inject(recording: Recording, rng: np.random.Generator) -> Recording:
        count, values = 0, ()

        def change(event: Event, _: np.random.Generator) -> list[Event]:
            nonlocal count, values
            values = event.values if count % samples == 0 else values
            count += 1
            return [replace(event, values=values)]

        return each(kind, change, start_s)(recording, rng)

    return inject


def stamped(kind: Kind, stamp_s: Profile, start_s: float) -> Injection:
    """Stamp samples by a function of the time at which they were taken, both in s."""
    return each(kind, lambda e, _: [replace(e, stamp_ns=round(stamp_s(e.t_s) * 1e9))], start_s)


def thinned(kind: Kind, every: int, start_s: float) -> Injection:
    """Lose all but one of so many samples."""

    def inject(recording: Recording, rng: np.random.Generator) -> Recording:
        count = 0

        def change(event: Event, _: np.random.Generator) -> list[Event]:
            nonlocal count
            count += 1
            return [event] if count % every == 1 else []

        return each(kind, change, start_s)(recording, rng)

    return inject


def dropped(kind: Kind, start_s: float, end_s: float = inf) -> Injection:
    """Lose all samples of a kind."""
    return each(kind, lambda *_: [], start_s, end_s)


def repeated(kind: Kind, start_s: float, end_s: float) -> Injection:
    """Repeat the values of the first sample under new stamps: a frozen sensor."""

    def inject(recording: Recording, rng: np.random.Generator) -> Recording:
        frozen = next((e for e in recording.events if e.kind == kind and e.t_s >= start_s), None)
        if frozen is None:
            return recording
        held = each(kind, lambda e, _: [replace(e, values=frozen.values)], start_s, end_s)
        return held(recording, rng)

    return inject


def stamps_shifted(kind: Kind, shift_s: float, start_s: float, end_s: float = inf) -> Injection:
    """Stamp the samples wrongly; they arrive when they did."""
    shift_ns = round(shift_s * 1e9)
    return each(kind, lambda e, _: [replace(e, stamp_ns=e.stamp_ns + shift_ns)], start_s, end_s)


def stamp_once(kind: Kind, shift_s: float, at_s: float) -> Injection:
    """Stamp one sample wrongly."""
    return first(kind, lambda e, _: [replace(e, stamp_ns=e.stamp_ns + round(shift_s * 1e9))], at_s)


def stamps_jitter(kind: Kind, std_s: float, start_s: float, end_s: float = inf) -> Injection:
    """Stamp the samples with noise."""

    def change(event: Event, rng: np.random.Generator) -> list[Event]:
        return [replace(event, stamp_ns=event.stamp_ns + round(float(rng.normal(0.0, std_s)) * 1e9))]

    return each(kind, change, start_s, end_s)


def late(kind: Kind, delay_s: float, *, stamped: bool, start_s: float = 0.0) -> Injection:
    """Deliver samples later; ``stamped`` as they arrive, or rightly."""
    delay_ns = round(delay_s * 1e9)

    def change(event: Event, _: np.random.Generator) -> list[Event]:
        stamp_ns = event.true_ns + delay_ns if stamped else event.stamp_ns
        return [replace(event, stamp_ns=stamp_ns, arrival_ns=event.true_ns + delay_ns)]

    return each(kind, change, start_s)


# --- frames ---


def _with_frame(event: Event, **changes: Any) -> Event:
    return replace(event, values=(replace(event.values[0], **changes),))


def frames_with(start_s: float, end_s: float = inf, **changes: Any) -> Injection:
    """Set fields of the frames' measurements."""
    return each("frame", lambda e, _: [_with_frame(e, **changes)], start_s, end_s)


def axis_off(angle_rad: Profile, start_s: float, end_s: float = inf) -> Injection:
    """See an axis that is off by an angle, a function of the time since the start."""

    def change(event: Event, _: np.random.Generator) -> list[Event]:
        heading = event.values[0].heading_rad + angle_rad(event.t_s - start_s)
        return [_with_frame(event, heading_rad=float(wrap_half(heading)))]

    return each("frame", change, start_s, end_s)


def axis_random(start_s: float, end_s: float) -> Injection:
    """See another direction in every frame."""

    def change(event: Event, rng: np.random.Generator) -> list[Event]:
        return [_with_frame(event, heading_rad=float(rng.uniform(-pi / 2, pi / 2)))]

    return each("frame", change, start_s, end_s)


def axis_off_at_times(angle_rad: float, share: float, start_s: float, end_s: float) -> Injection:
    """See an axis that is off by an angle in a share of the frames."""

    def change(event: Event, rng: np.random.Generator) -> list[Event]:
        seen = event.values[0].heading_rad + (angle_rad if rng.uniform() < share else 0.0)
        return [_with_frame(event, heading_rad=float(wrap_half(seen)))]

    return each("frame", change, start_s, end_s)


def frames_mirrored(start_s: float = 0.0) -> Injection:
    """See left and right exchanged."""
    return each("frame", lambda e, _: [_with_frame(e, heading_rad=-e.values[0].heading_rad)], start_s)


def frames_old(frames: int, start_s: float) -> Injection:
    """Show what was seen some frames ago: a queue that nobody empties."""

    def inject(recording: Recording, rng: np.random.Generator) -> Recording:
        queue = [e.values for e in recording.events if e.kind == "frame"]
        first = sum(e.kind == "frame" and e.t_s < start_s for e in recording.events)
        old = iter(queue[max(first - frames, 0) :])
        return each("frame", lambda e, _: [replace(e, values=next(old))], start_s)(recording, rng)

    return inject


def frames_refused(start_s: float, end_s: float = inf) -> Injection:
    """Let vision find no single axis."""
    return frames_with(start_s, end_s, accepted=False, reason=Reason.AMBIGUOUS)


def sigma_scaled(factor: float, start_s: float = 0.0) -> Injection:
    """State the same errors with another standard deviation."""

    def change(event: Event, _: np.random.Generator) -> list[Event]:
        return [_with_frame(event, heading_std_rad=factor * event.values[0].heading_std_rad)]

    return each("frame", change, start_s)


def corner_off(offset_norm: float, start_s: float, end_s: float) -> Injection:
    """Take another edge for the corner of wall and floor."""

    def change(event: Event, _: np.random.Generator) -> list[Event]:
        return [_with_frame(event, lateral_offset_norm=event.values[0].lateral_offset_norm + offset_norm)]

    return each("frame", change, start_s, end_s)


def calibration_wrong(right_px: float = 0.0, focal_factor: float = 1.0) -> Injection:
    """See each axis through a camera whose principal point or focal length is told wrongly.

    The vanishing point is where the true camera sees it; told another one, it is another direction, which levelling
    turns into heading and elevation.
    """

    def inject(recording: Recording, rng: np.random.Generator) -> Recording:
        def change(event: Event, _: np.random.Generator) -> list[Event]:
            heading = event.values[0].heading_rad
            roll = float(np.interp(event.t_s, recording.t_s, recording.roll_rad))
            pitch = float(np.interp(event.t_s, recording.t_s, recording.pitch_rad))
            R = Attitude(roll, pitch).R_level_body()
            forward, right, down = R.T @ np.array([cos(heading), -sin(heading), 0.0])
            seen = np.array(
                [
                    1.0,
                    (right / forward + right_px / FOCAL_LENGTH_PX) / focal_factor,
                    down / forward / focal_factor,
                ]
            )
            x, y, z = (R @ seen / np.linalg.norm(seen)).tolist()
            elevation = event.values[0].elevation_rad - asin(z)
            return [_with_frame(event, heading_rad=atan2(-y, x), elevation_rad=elevation)]

        return each("frame", change, 0.0)(recording, rng)

    return inject


# --- attitude and velocity ---


def _product(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float, float]:
    """Product of two quaternions w, x, y, z."""
    w, x, y, z = a
    p, q, r, s = b
    return (
        w * p - x * q - y * r - z * s,
        w * q + x * p + y * s - z * r,
        w * r - x * s + y * p + z * q,
        w * s + x * r - y * q + z * p,
    )


def _turned(event: Event, angle_rad: float) -> Event:
    turn = (cos(angle_rad / 2), 0.0, 0.0, sin(angle_rad / 2))
    return replace(event, values=(_product(turn, event.values[0]),))


def yaw_off(angle_rad: float, start_s: float, end_s: float = inf) -> Injection:
    """Turn the attitude about the vertical: steel or a motor's current."""
    return yaw_pulled(lambda _: angle_rad, start_s, end_s)


def yaw_pulled(angle_rad: Profile, start_s: float, end_s: float = inf) -> Injection:
    """Turn it by an angle that is a function of the time since the start."""
    return each("attitude", lambda e, _: [_turned(e, angle_rad(e.t_s - start_s))], start_s, end_s)


def yaw_mapped(factor: float, start_s: float) -> Injection:
    """Multiply the yaw: -1 turns it the wrong way, 0 freezes it."""

    def change(event: Event, _: np.random.Generator) -> list[Event]:
        return [_turned(event, (factor - 1.0) * yaw_of_quaternion(event.values[0]))]

    return each("attitude", change, start_s)


def attitude_upside_down(start_s: float = 0.0) -> Injection:
    """Give the attitude of a body frame whose y points left and z up."""
    flip = (0.0, 1.0, 0.0, 0.0)
    return each("attitude", lambda e, _: [replace(e, values=(_product(e.values[0], flip),))], start_s)


def attitude_tilted(roll_rad: float, start_s: float) -> Injection:
    """Roll the attitude by a constant angle."""
    turn = (cos(roll_rad / 2), sin(roll_rad / 2), 0.0, 0.0)
    return each("attitude", lambda e, _: [replace(e, values=(_product(e.values[0], turn),))], start_s)


def velocities(v_body: tuple[float, float, float], start_s: float, end_s: float) -> Injection:
    """Add a velocity stream of 20 Hz that says this."""

    def inject(recording: Recording, _: np.random.Generator) -> Recording:
        times = np.round(np.arange(start_s, end_s, 0.05) * 1e9).astype(np.int64).tolist()
        added = [Event("velocity", t, t, t, (v_body,)) for t in times]
        return recording.with_events([*recording.events, *added])

    return inject
