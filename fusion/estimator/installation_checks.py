"""Checks how sensors are installed (axes, units, tilt, focal length), by comparing what they measure of one motion.

The turns that frames see are regressed on those of the gyroscope: a slope of -1 is a wrong sign, one near 0 a wrong
unit, and the intercept is the gyroscope's bias. At rest the accelerometer reads (0, 0, -9.8) m/s^2 in FRD, and its
mean points where the attitude has up. Where the camera points, the vehicle's rolling shows
(`fusion.estimator.camera_yaw`), and its focal length the headings (`fusion.estimator.focal_length`).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, hypot, pi, radians, sqrt
from statistics import median
from typing import NamedTuple

from fusion.estimator.camera_yaw import CameraYaw
from fusion.estimator.faults import Fault, Notice
from fusion.estimator.focal_length import FocalLength
from fusion.estimator.frame_timing import FrameTiming
from fusion.estimator.models import Vector
from fusion.estimator.records import new_record
from vision.rotations import wrap_axis

SPAN_NS = 250_000_000  # over which frames are averaged; turns are from one span to the next
MAX_TURN_RAD = 0.35  # in that time; more is another axis
MEMORY = 1.0 - 1 / 40  # of each turn, when the next comes
MIN_TURNS, SURE_SIGMA = 3.0, 5.0
PRIOR_TURNS = 4.0  # that the stated noise counts as, beside the scatter that is found
FAST_RAD_S = 3.0  # rms that no flight along a corridor has
MAX_BIAS_RAD_S = 0.1
IMU_STEP_NS, IMU_MEMORY_S, ACCEL_MIN_S, FAST_MIN_S = 50_000_000, 3.0, 0.5, 2.0
MAX_TILT_ERROR_RAD = radians(20)
LEAN_MEMORY_S, LEAN_MIN_S = 10.0, 4.0  # no vehicle speeds up one way for so long
MAX_LEAN_RAD = radians(7)
FROM_FRAMES = 6  # so many fields of an `Installation` come from frames, the others from the IMU's samples


class Span(NamedTuple):
    """Frames of a quarter second: start, mean time since then and gyroscope's angle, the frames' stated variance.

    ``differences_rad`` are the headings less the gyroscope's angle; their median is none of the gross frames'.
    """

    since_ns: int
    time_s: float
    gyro_rad: float
    variance: float
    differences_rad: tuple[float, ...]

    @property
    def heading_rad(self) -> float:
        """Heading at the mean time."""
        return self.gyro_rad + median(self.differences_rad)

    @property
    def heading_variance(self) -> float:
        """Its variance; that of a median is pi / 2 times a mean's."""
        return 0.5 * pi * self.variance / len(self.differences_rad)

    def with_frame(self, t_ns: int, heading_rad: float, gyro_rad: float, variance: float) -> Span:
        """Take in a frame."""
        share, first = 1.0 / (len(self.differences_rad) + 1), self.differences_rad[0]
        difference = first + wrap_axis(heading_rad - gyro_rad - first)
        return Span(
            self.since_ns,
            self.time_s + share * ((t_ns - self.since_ns) * 1e-9 - self.time_s),
            self.gyro_rad + share * (gyro_rad - self.gyro_rad),
            self.variance + share * (variance - self.variance),
            (*self.differences_rad, difference),
        )


class Installation(NamedTuple):
    """What has been compared so far.

    Parameters
    ----------
    span, last_span
        The frames of the present span, and of the one before.
    sums
        Weight, x, y, xx, xy, yy, stated variance of the turns; x is the gyroscope's, y the frames', rad/s.
    camera_yaw
        Whether the camera points to one side.
    focal_length
        Whether its focal length is wrong.
    timing
        Whether frames are stamped early or late.
    accel_m_s2, lean, turning_rad2_s2, imu_s, imu_ns
        Mean specific force, mean angle (3,) between it and the attitude's up about each axis, and mean square of the
        gyroscope's rate, over how long, and when they were last taken in.
    """

    span: Span | None = None
    last_span: Span | None = None
    sums: tuple[float, float, float, float, float, float, float] = (0.0,) * 7
    camera_yaw: CameraYaw = CameraYaw()
    focal_length: FocalLength = FocalLength()
    timing: FrameTiming = FrameTiming()
    accel_m_s2: Vector = (0.0, 0.0, 0.0)
    lean: Vector = (0.0, 0.0, 0.0)
    turning_rad2_s2: float = 0.0
    imu_s: float = 0.0
    imu_ns: int | None = None

    def interrupted(self) -> Installation:
        """Start another turn and another mean: time has moved, or something else carries the heading."""
        return self._replace(
            span=None,
            last_span=None,
            imu_ns=None,
            focal_length=self.focal_length.interrupted(),
            timing=self.timing.interrupted(),
        )

    def with_frame(self, t_ns: int, heading_rad: float, gyro_rad: float, std_rad: float) -> Installation:
        """Take a frame's heading and its sigma, and the angle that the gyroscope has turned by then."""
        span, variance = self.span, std_rad * std_rad
        timing = self.timing.with_frame(t_ns, heading_rad, gyro_rad, std_rad)
        if span is not None and t_ns - span.since_ns < SPAN_NS:
            return self._replace(span=span.with_frame(t_ns, heading_rad, gyro_rad, variance), timing=timing)
        new = Span(t_ns, 0.0, gyro_rad, variance, (heading_rad - gyro_rad,))
        if span is None or t_ns - span.since_ns > 2 * SPAN_NS:
            focal = self.focal_length.interrupted()
            return self._replace(span=new, last_span=None, focal_length=focal, timing=timing)
        middle_ns = span.since_ns + round(1e9 * span.time_s)
        focal = self.focal_length.with_heading(
            middle_ns, span.heading_rad, span.gyro_rad, span.heading_variance
        )
        then = self.last_span
        done = self._replace(span=new, last_span=span, focal_length=focal, timing=timing)
        if then is None:
            return done
        turn = wrap_axis(span.heading_rad - then.heading_rad)
        if abs(turn) > MAX_TURN_RAD:
            return done
        apart_s = (span.since_ns - then.since_ns) * 1e-9 + span.time_s - then.time_s
        x, y = (span.gyro_rad - then.gyro_rad) / apart_s, turn / apart_s
        stated = (span.heading_variance + then.heading_variance) / apart_s**2
        n, sx, sy, sxx, sxy, syy, noise = (MEMORY * value for value in self.sums)
        sums = (n + 1.0, sx + x, sy + y, sxx + x * x, sxy + x * y, syy + y * y, noise + stated)
        return done._replace(sums=sums)

    def with_elevation(
        self, t_ns: int, elevation_rad: float, std_rad: float, roll_rad: float
    ) -> Installation:
        """Take what `fusion.estimator.camera_yaw.CameraYaw.with_elevation` takes."""
        seen = self.camera_yaw.with_elevation(t_ns, elevation_rad, std_rad, roll_rad)
        return self if seen is self.camera_yaw else self._replace(camera_yaw=seen)

    def with_imu(
        self, t_ns: int, gyro_rad_s: Vector, accel_m_s2: Vector | None, down: Vector
    ) -> Installation:
        """Take an IMU sample, where it is time for one; the specific force stays zero where there is none.

        ``down`` is that of the attitude in use, body FRD.
        """
        if self.imu_ns is not None and t_ns - self.imu_ns < IMU_STEP_NS:
            return self
        p, q, r = gyro_rad_s
        turning = p * p + q * q + r * r
        if self.imu_ns is None:
            accel = self.accel_m_s2 if accel_m_s2 is None else accel_m_s2
            return self._replace(imu_ns=t_ns, accel_m_s2=accel, turning_rad2_s2=turning, imu_s=0.0)
        step_s = (t_ns - self.imu_ns) * 1e-9
        gain = step_s / (min(self.imu_s, IMU_MEMORY_S) + step_s)
        mean, mx, my, mz = self.turning_rad2_s2, *self.accel_m_s2
        ax, ay, az = self.accel_m_s2 if accel_m_s2 is None else accel_m_s2
        slow, lean = step_s / (min(self.imu_s, LEAN_MEMORY_S) + step_s), self.lean
        if accel_m_s2 is not None:
            (lx, ly, lz), (nx, ny, nz) = lean, _lean(accel_m_s2, down)
            lean = (lx + slow * (nx - lx), ly + slow * (ny - ly), lz + slow * (nz - lz))
        accel = (mx + gain * (ax - mx), my + gain * (ay - my), mz + gain * (az - mz))
        found = (accel, lean, mean + gain * (turning - mean), self.imu_s + step_s, t_ns)
        return new_record(Installation, (*self[:FROM_FRAMES], *found))

    def agrees_on_imu(self, other: Installation) -> bool:
        """Whether the IMU's samples have left the same; what comes from frames may differ."""
        return self is other or self[FROM_FRAMES:] == other[FROM_FRAMES:]

    def with_frames_of(self, other: Installation) -> Installation:
        """Take over what comes from frames; what comes from the IMU stays."""
        return new_record(Installation, (*other[:FROM_FRAMES], *self[FROM_FRAMES:]))

    def notices(self, down: Vector, gyro_scale_std: float = 0.0) -> Iterator[Notice]:
        """Say what is installed otherwise than told; ``down`` is that of the attitude in use, body FRD.

        A gyroscope in degrees spoils the tilt, and a wrong tilt reverses the level yaw rate: then the turns tell
        nothing of the gyroscope.
        """
        if self.imu_s > FAST_MIN_S and self.turning_rad2_s2 > FAST_RAD_S**2:
            text = f"gyroscope turns at {sqrt(self.turning_rad2_s2):.0f} rad/s: convert deg/s to rad/s"
            yield Notice(Fault.GYRO_SCALE, text)
            return
        tilt = self._tilt_fault_text(down)
        if tilt is None:
            of_turns = list(self._turn_notices(gyro_scale_std))
            yield from of_turns
            # Against a gyroscope in another unit, or of another sign, nothing shows how frames are stamped.
            if self.timing.is_off and not any(
                n.fault in (Fault.GYRO_SIGN, Fault.GYRO_SCALE) for n in of_turns
            ):
                yield Notice(Fault.CAMERA_CLOCK, self.timing.text)
            if self.camera_yaw.is_off:
                angle = degrees(abs(self.camera_yaw.angle_rad))
                text = f"camera points {angle:.0f} deg to one side: check principal point and mounting"
                yield Notice(Fault.CAMERA_YAW, text)
        else:
            yield Notice(Fault.TILT_WRONG, tilt)

    def _tilt_fault_text(self, down: Vector) -> str | None:
        ax, ay, az = self.accel_m_s2
        if self.imu_s < ACCEL_MIN_S:
            return None
        if az > 5.0:
            return "accelerometer is upside down: give FRD, (0, 0, -9.8) m/s^2 at rest"
        dot = -(ax * down[0] + ay * down[1] + az * down[2])
        cross = hypot(ay * down[2] - az * down[1], az * down[0] - ax * down[2], ax * down[1] - ay * down[0])
        if dot < 0.0:
            return "attitude is upside down: give it from FRD to a world with z down"
        leans = self.imu_s > LEAN_MIN_S and hypot(*self.lean) > MAX_LEAN_RAD
        if leans or cross > MAX_TILT_ERROR_RAD * dot:
            return "attitude and accelerometer disagree: check how each is mounted"
        return None

    def _turn_notices(self, gyro_scale_std: float) -> Iterator[Notice]:
        n, sx, sy, sxx, sxy, syy, stated = self.sums
        if n < MIN_TURNS:
            return
        vxx, vxy, vyy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
        if vxx <= 1e-6 * sxx or vxx <= 0.0:
            return
        slope = vxy / vxx
        scatter = max(vyy - slope * vxy, 0.0) + PRIOR_TURNS * stated / n
        noise = scatter / (n - 2.0 + PRIOR_TURNS)
        std = sqrt(noise / vxx)
        if sxx > FAST_RAD_S**2 * n and abs(slope) + std < 0.1:
            yield Notice(Fault.GYRO_SCALE, "gyroscope turns far more than the camera: convert deg/s to rad/s")
            return
        if slope < -0.5 and -slope > SURE_SIGMA * std:
            text = "gyroscope turns against the camera: give it in FRD, positive to the right"
            yield Notice(Fault.GYRO_SIGN, text)
            return
        if 0.5 < slope < 2.0 and self.focal_length.is_off(gyro_scale_std):
            seen = 1.0 + self.focal_length.share
            text = (
                f"camera sees {seen:.2f} times the gyroscope's turns: check focal length and gyroscope scale"
            )
            yield Notice(Fault.FOCAL_LENGTH, text)
        bias = (sx - sy / slope) / n if 0.5 < slope < 2.0 else (sx - sy) / n
        if abs(bias) > MAX_BIAS_RAD_S and abs(bias) > SURE_SIGMA * sqrt(noise / n):
            text = f"gyroscope is off by {degrees(abs(bias)):.0f} deg/s: calibrate it at rest"
            yield Notice(Fault.GYRO_BIAS, text)


def _lean(force: Vector, down: Vector) -> Vector:
    """Angle (3,) from the attitude's up to the specific force, rad about the body's axes; small ones are exact."""
    (fx, fy, fz), (dx, dy, dz) = force, down
    norm = max(hypot(fx, fy, fz), 1.0)
    return (fy * dz - fz * dy) / norm, (fz * dx - fx * dz) / norm, (fx * dy - fy * dx) / norm
