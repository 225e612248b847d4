"""Checks of the sensors' installation (axes, units, tilt, focal length) by their measurements of the same motion.

- Turn rates: over spans of a quarter second, the frames' turn rate y is regressed on the gyroscope's rate x:
  ``y = a + m x``. A slope m near -1 is a wrong sign, one near 0 a wrong unit; ``-a / m`` is the gyroscope's bias.
  Sums fade with `MEMORY`, and the stated variances count as `PRIOR_TURNS` turns beside the residuals.
- Gravity: at rest the accelerometer reads (0, 0, -9.8) m/s^2 in FRD. The mean angle e between each force and the
  attitude's vertical then is a mean acceleration g e: over a time T, the speed changes by g e T, which is limited.
- Camera: its yaw shows when the vehicle rolls (`camera_yaw`), its focal length in the headings (`focal_length`), its
  time stamps in turns (`frame_timing`).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, hypot, pi, radians, sqrt
from statistics import median
from typing import NamedTuple

from fusion.estimator.faults import Fault, Notice
from fusion.estimator.installation.camera_yaw import CameraYaw
from fusion.estimator.installation.focal_length import FocalLength
from fusion.estimator.installation.frame_timing import FrameTiming
from fusion.estimator.lateral.updates import usable_force
from fusion.estimator.models import Vector
from fusion.estimator.records import new_record
from vision.rotations import wrap_axis

SPAN_NS = 250_000_000  # over which frames are averaged; turns are from one span to the next
MAX_TURN_RAD = 0.35  # a larger change of the frames' heading in that time is another axis
MEMORY = 1.0 - 1 / 40  # forgetting factor per turn
MIN_TURNS, SURE_SIGMA = 3.0, 5.0
PRIOR_TURNS = 4.0  # degrees of freedom of the stated noise, beside the residuals
FAST_RAD_S = 3.0  # rms turn rate that no flight along a corridor reaches
# A flip ends; rates in degrees, taken for radians, exceed this at least once in each half second of a flight.
SLOW_RAD_S, SLOW_NS = 1.0, 500_000_000
MAX_BIAS_RAD_S = 0.1
IMU_STEP_NS, IMU_MEMORY_S, ACCEL_MIN_S, FAST_MIN_S = 50_000_000, 3.0, 0.5, 2.0
LEAN_MEMORY_S = 10.0
MAX_LEAN_RAD, LEAN_S = radians(7), 7.0  # together, a change of speed of 8.4 m/s
GRAVITY_M_S2, MIN_FORCE_M_S2 = 9.8, 4.9  # no vehicle falls for so long that the mean is half of gravity
INVERTED = "accelerometer is upside down: give FRD, (0, 0, -9.8) m/s^2 at rest"
FROM_FRAMES = 6  # the first fields of an `Installation` come from frames, the others from the IMU


class Span(NamedTuple):
    """Frames of a quarter second: start, means of the time since then, gyroscope's angle and stated variance.

    ``differences_rad`` are the headings less the gyroscope's angle; their median is robust to outliers.
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
        """Variance of the heading; that of a median is pi / 2 times a mean's."""
        return 0.5 * pi * self.variance / len(self.differences_rad)

    def with_frame(self, t_ns: int, heading_rad: float, gyro_rad: float, variance: float) -> Span:
        """Add a frame."""
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
    """Statistics of the installation checks.

    Parameters
    ----------
    span, last_span
        The frames of the present span, and of the one before.
    sums
        Sums of weight, x, y, xx, xy, yy and stated variance of the turn rates, rad/s.
    camera_yaw
        Estimate of the camera's yaw error.
    focal_length
        Estimate of the focal length's error.
    timing
        Estimate of the frames' time-stamp error.
    force_m_s2, force_z, upright, lean, turning_rad2_s2, imu_s, imu_ns
        Means: size of the specific force; component of its direction along the body's z; cosine and angle (3,) from
        the attitude's up to it, the angle about each axis; square of the gyroscope's rate. The time over which they
        are averaged, and their last update.
    fast_ns
        Times of the first and the last rate beyond `SLOW_RAD_S` without a pause of `SLOW_NS` between.
    """

    span: Span | None = None
    last_span: Span | None = None
    sums: tuple[float, float, float, float, float, float, float] = (0.0,) * 7
    camera_yaw: CameraYaw = CameraYaw()
    focal_length: FocalLength = FocalLength()
    timing: FrameTiming = FrameTiming()
    force_m_s2: float = GRAVITY_M_S2
    force_z: float = -1.0
    upright: float = 1.0
    lean: Vector = (0.0, 0.0, 0.0)
    turning_rad2_s2: float = 0.0
    imu_s: float = 0.0
    imu_ns: int | None = None
    fast_ns: tuple[int, int] = (0, 0)

    def interrupted(self) -> Installation:
        """Restart spans and means after a change of the clock or of the source that propagates the heading."""
        return self._replace(
            span=None,
            last_span=None,
            imu_ns=None,
            focal_length=self.focal_length.interrupted(),
            timing=self.timing.interrupted(),
        )

    def with_frame(self, t_ns: int, heading_rad: float, gyro_rad: float, std_rad: float) -> Installation:
        """Add a frame's heading and its sigma, with the gyroscope's angle at its time."""
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
        """Add an elevation; arguments as in `camera_yaw.CameraYaw.with_elevation`."""
        seen = self.camera_yaw.with_elevation(t_ns, elevation_rad, std_rad, roll_rad)
        return self if seen is self.camera_yaw else self._replace(camera_yaw=seen)

    def with_imu(
        self, t_ns: int, gyro_rad_s: Vector, accel_m_s2: Vector | None, down: Vector
    ) -> Installation:
        """Add an IMU sample every `IMU_STEP_NS`; without a usable force its means stay.

        ``down`` is gravity's direction by the attitude in use, body FRD.
        """
        if self.imu_ns is not None and t_ns - self.imu_ns < IMU_STEP_NS:
            return self
        accel_m_s2 = usable_force(accel_m_s2)
        p, q, r = gyro_rad_s
        turning = p * p + q * q + r * r
        if self.imu_ns is None:
            return self._replace(imu_ns=t_ns, turning_rad2_s2=turning, imu_s=0.0, fast_ns=(t_ns, t_ns))
        step_s = (t_ns - self.imu_ns) * 1e-9
        gain = step_s / (min(self.imu_s, IMU_MEMORY_S) + step_s)
        slow = step_s / (min(self.imu_s, LEAN_MEMORY_S) + step_s)
        force, z, upright = self.force_m_s2, self.force_z, self.upright
        mean, lean = self.turning_rad2_s2, self.lean
        if accel_m_s2 is not None:
            size = hypot(*accel_m_s2)
            cosine, nx, ny, nz = _lean(accel_m_s2, size, down)
            lx, ly, lz = lean
            force += gain * (size - force)
            z += gain * (accel_m_s2[2] / max(size, 1.0) - z)
            upright += gain * (cosine - upright)
            lean = (lx + slow * (nx - lx), ly + slow * (ny - ly), lz + slow * (nz - lz))
        fast = self.fast_ns
        if turning > SLOW_RAD_S**2:
            fast = (fast[0] if t_ns - fast[1] <= SLOW_NS else t_ns, t_ns)
        found = (force, z, upright, lean, mean + gain * (turning - mean), self.imu_s + step_s, t_ns, fast)
        return new_record(Installation, (*self[:FROM_FRAMES], *found))

    def agrees_on_imu(self, other: Installation) -> bool:
        """Whether the fields from the IMU are equal; those from frames may differ."""
        return self is other or self[FROM_FRAMES:] == other[FROM_FRAMES:]

    def with_frames_of(self, other: Installation) -> Installation:
        """Return the record with the fields from frames of another one."""
        return new_record(Installation, (*other[:FROM_FRAMES], *self[FROM_FRAMES:]))

    def notices(self, gyro_scale_std: float = 0.0) -> Iterator[Notice]:
        """Yield the installation faults, but none that follows from another one.

        A gyroscope in degrees corrupts the tilt, and a tilt upside down reverses the level yaw rate. One that leans
        changes the size of the turns, and the roll.
        """
        if self._is_in_degrees():
            text = f"gyroscope turns at {sqrt(self.turning_rad2_s2):.0f} rad/s: convert deg/s to rad/s"
            yield Notice(Fault.GYRO_SCALE, text)
            if self._accelerometer_is_inverted():  # independent of the tilt
                yield Notice(Fault.TILT_WRONG, INVERTED)
            return
        accel, tilt = self._accelerometer_fault_text(), self._tilt_fault_text()
        if accel or tilt:
            yield Notice(Fault.TILT_WRONG, accel or tilt or "")
        if self._tilt_is_inverted():
            return
        of_turns = list(self._turn_notices(gyro_scale_std))
        yield from (n for n in of_turns if tilt is None or n.fault is not Fault.FOCAL_LENGTH)
        # A gyroscope of another unit or sign makes the estimated stamp error meaningless.
        if self.timing.is_off and not any(n.fault in (Fault.GYRO_SIGN, Fault.GYRO_SCALE) for n in of_turns):
            yield Notice(Fault.CAMERA_CLOCK, self.timing.text)
        if tilt is None and self.camera_yaw.is_off:
            angle = degrees(abs(self.camera_yaw.angle_rad))
            text = f"camera points {angle:.0f} deg to one side: check principal point and mounting"
            yield Notice(Fault.CAMERA_YAW, text)

    def _is_in_degrees(self) -> bool:
        """Whether the gyroscope is too fast for too long, and frames have not confirmed its rates."""
        if self.imu_s <= FAST_MIN_S or self.turning_rad2_s2 <= FAST_RAD_S**2 or self.imu_ns is None:
            return False
        first_ns, last_ns = self.fast_ns
        lasts = last_ns - first_ns > 0.9e9 * FAST_MIN_S and self.imu_ns - last_ns <= SLOW_NS
        return lasts and not self._scale_is_confirmed()

    def _accelerometer_is_inverted(self) -> bool:
        return self.imu_s >= ACCEL_MIN_S and self.force_z > 0.5

    def _accelerometer_fault_text(self) -> str | None:
        if self.imu_s < ACCEL_MIN_S:
            return None
        if self._accelerometer_is_inverted():
            return INVERTED
        if self.force_m_s2 < MIN_FORCE_M_S2:
            return f"accelerometer reads {self.force_m_s2:.1f} m/s^2 and not gravity: check its unit, m/s^2"
        return None

    def _tilt_is_inverted(self) -> bool:
        """Whether the tilt in use is upside down, by an accelerometer that may be so itself."""
        return self.imu_s >= ACCEL_MIN_S and self.force_z * self.upright > 0.0

    def _tilt_fault_text(self) -> str | None:
        """Return what is wrong with attitude or accelerometer, by comparison."""
        if self.imu_s < ACCEL_MIN_S:
            return None
        if self.upright < 0.0:
            return "attitude is upside down: give it from FRD to a world with z down"
        if hypot(*self.lean) * min(self.imu_s, LEAN_S) > MAX_LEAN_RAD * LEAN_S:
            return "attitude and accelerometer disagree: check how each is mounted"
        return None

    def _slope(self) -> tuple[float, float, float] | None:
        """Return the slope of the turn rates, its sigma, and the variance of a rate; None if there are too few."""
        n, sx, sy, sxx, sxy, syy, stated = self.sums
        if n < MIN_TURNS:
            return None
        vxx, vxy, vyy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
        if vxx <= 1e-6 * sxx or vxx <= 0.0:
            return None
        slope = vxy / vxx
        scatter = max(vyy - slope * vxy, 0.0) + PRIOR_TURNS * stated / n
        noise = scatter / (n - 2.0 + PRIOR_TURNS)
        return slope, sqrt(noise / vxx), noise

    def _scale_is_confirmed(self) -> bool:
        """Whether the frames have shown the gyroscope's turns, of whichever sign."""
        found = self._slope()
        if found is None:
            return False
        slope, std, _ = found
        return 0.5 < abs(slope) < 2.0 and abs(slope) > SURE_SIGMA * std

    def _turn_notices(self, gyro_scale_std: float) -> Iterator[Notice]:
        if (found := self._slope()) is None:
            return
        slope, std, noise = found
        n, sx, sy, sxx, *_ = self.sums
        if sxx > FAST_RAD_S**2 * n and abs(slope) + std < 0.1:
            yield Notice(Fault.GYRO_SCALE, "gyroscope turns far more than the camera: convert deg/s to rad/s")
            return
        if slope < -0.5 and -slope > SURE_SIGMA * std:
            text = "gyroscope turns against the camera: give it in FRD, positive to the right"
            yield Notice(Fault.GYRO_SIGN, text)
            return
        if 0.5 < slope < 2.0 and (focal := self.focal_length.error(gyro_scale_std)):
            seen = 1.0 + focal
            text = (
                f"camera sees {seen:.2f} times the gyroscope's turns: check focal length and gyroscope scale"
            )
            yield Notice(Fault.FOCAL_LENGTH, text)
        bias = (sx - sy / slope) / n if 0.5 < slope < 2.0 else (sx - sy) / n
        if abs(bias) > MAX_BIAS_RAD_S and abs(bias) > SURE_SIGMA * sqrt(noise / n):
            text = f"gyroscope is off by {degrees(abs(bias)):.0f} deg/s: calibrate it at rest"
            yield Notice(Fault.GYRO_BIAS, text)


def _lean(force: Vector, size: float, down: Vector) -> tuple[float, float, float, float]:
    """Return cosine and angle from the attitude's up to a force of this size; about each axis, if small."""
    (fx, fy, fz), (dx, dy, dz) = force, down
    norm = max(size, 1.0)
    cosine = -(fx * dx + fy * dy + fz * dz) / norm
    return cosine, (fy * dz - fz * dy) / norm, (fz * dx - fx * dz) / norm, (fx * dy - fy * dx) / norm
