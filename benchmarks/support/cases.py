"""Pictures whose heading is known: frames of flights and of simulated corridors, one at a time.

A flight with ``corridor_truth.csv`` is known exactly. A flight without one is measured against the vehicle's own
yaw, whose zero is not the corridor's axis: one constant per stretch of frames is taken out of the errors, and what is
left holds the yaw's own error too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import atan2, degrees, hypot, nan, pi, radians
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from fusion.evaluation.errors import interpolate_truth
from fusion.flight import AttitudeStream, Flight
from fusion.logs import load_flight
from fusion.simulate import RandomView, office_views
from vision import Attitude, Camera, FrameMeasurement, measure_frame
from vision.frame import Method
from vision.images import GreyImage
from vision.rotations import yaw_of

FloatArray = npt.NDArray[np.float64]
Size = tuple[int, int]

ROOT = Path(__file__).resolve().parents[2]
SHARED_FLIGHTS = ROOT.parent / "shared" / "flights"
TILT_STD_RAD = radians(0.5)  # of the roll and pitch that come with a simulated view, as `Attitude` assumes
SIMULATED_FOV_RAD = radians(70.0)
# Frames of flights without truth in which the vehicle flies along one corridor; between them it turns.
STRETCHES = {"mononav_hallway": ((0, 42), (62, 91))}


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A picture to measure, and what is right.

    Parameters
    ----------
    source, index
        Where it comes from, and its number there.
    attitude
        Roll and pitch as a log has them, not exact.
    headings_rad
        Right answers: one, or several where the picture shows several corridors.
    offset_norm
        Lateral offset of the camera over half the width; NaN where unknown.
    exact
        Whether the truth is: a vehicle's own yaw is none to hold a sigma against.
    """

    source: str
    index: int
    image: GreyImage
    camera: Camera
    attitude: Attitude | None
    headings_rad: tuple[float, ...]
    offset_norm: float = nan
    exact: bool = True

    def error_rad(self, heading_rad: float) -> float:
        """Signed distance to the nearest right answer; a corridor looks alike from both ends."""
        errors = [half_turn(heading_rad - h) for h in self.headings_rad]
        return min(errors, key=abs)


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a case; angles in radians, offsets over half the width, NaN where there is none.

    ``offset_norm`` is the true one, ``answer_norm`` what was measured.
    """

    source: str
    index: int
    accepted: bool
    reason: str
    n_lines: int
    n_inliers: int
    truth_rad: float
    heading_rad: float
    error_rad: float
    std_rad: float
    second_score: float
    elevation_rad: float
    offset_norm: float
    offset_error_norm: float
    offset_std_norm: float
    vision_ms: float
    exact: bool
    answer_norm: float = nan
    perturbation: str = "none"


def half_turn(angle_rad: float) -> float:
    """Bring an angle into [-pi/2, pi/2)."""
    return (angle_rad + pi / 2) % pi - pi / 2


def size_name(size: Size) -> str:
    """Write a size as width x height."""
    return f"{size[0]}x{size[1]}"


def measure(case: Case, method: Method = "geometric") -> tuple[Result, FrameMeasurement]:
    """Measure a case by itself, without any prior."""
    found = measure_frame(case.image, case.camera, case.attitude, method=method)
    return score(case, found), found


def score(case: Case, found: FrameMeasurement) -> Result:
    """Compare a measurement with the truth."""
    error = case.error_rad(found.heading_rad)
    # Across another corridor the offset is not known.
    is_first = half_turn(found.heading_rad - case.headings_rad[0]) == error
    offset = case.offset_norm if is_first or error != error else nan
    return Result(
        source=case.source,
        index=case.index,
        accepted=found.accepted,
        reason=str(found.reason),
        n_lines=found.n_lines,
        n_inliers=found.n_inliers,
        truth_rad=half_turn(found.heading_rad - error) if error == error else case.headings_rad[0],
        heading_rad=found.heading_rad,
        error_rad=error,
        std_rad=found.heading_std_rad,
        second_score=found.second_score,
        elevation_rad=found.elevation_rad,
        offset_norm=offset,
        offset_error_norm=found.lateral_offset_norm - offset,
        offset_std_norm=found.lateral_offset_norm_std,
        vision_ms=found.vision_ms,
        exact=case.exact,
        answer_norm=found.lateral_offset_norm,
    )


def flight_folders() -> list[Path]:
    """``data/office`` and the flights shared beside the repository, as far as they are there."""
    beside = sorted(SHARED_FLIGHTS.iterdir()) if SHARED_FLIGHTS.is_dir() else []
    found: dict[str, Path] = {}
    for folder in [ROOT / "data" / "office", *beside]:
        if (folder / "mav0").is_dir():
            found.setdefault(folder.name, folder)
    return list(found.values())


def flight_named(name: str) -> Path | None:
    """Return the folder of a flight; None where it is not in this checkout."""
    return next((folder for folder in flight_folders() if folder.name == name), None)


def flight_cases(folder: Path, size: Size, *, every: int = 1) -> list[list[Case]]:
    """Load the frames of a flight whose heading is known, a list for each stretch; empty where none is.

    Headings of stretches without truth are the vehicle's yaw; see `less_constant`.

    Parameters
    ----------
    every
        Take only every so many frames.
    """
    flight = load_flight(folder)
    if flight.truth is None and flight.name not in STRETCHES:
        return []
    headings, offsets, known = _truth_of(flight)
    attitudes = attitudes_at(flight.attitude, flight.frames.t_ns)
    camera = flight.camera.resized(*size)
    cases = []
    for first, last in STRETCHES.get(flight.name, ((0, len(known)),)):
        label = f" {first}-{last - 1}" if flight.truth is None else ""
        name = flight.name.removeprefix("mononav_")
        cases.append(
            [
                Case(
                    source=f"{name}{label} {size_name(size)}",
                    index=i,
                    image=scaled(flight.frames.read(i), size),
                    camera=camera,
                    attitude=attitudes[i],
                    headings_rad=(float(headings[i]),),
                    offset_norm=float(offsets[i]),
                    exact=flight.truth is not None,
                )
                for i in range(first, last, every)
                if known[i]
            ]
        )
    return cases


def turn_cases(folder: Path, size: Size, constants_rad: Sequence[float], *, every: int = 1) -> list[Case]:
    """Load the frames between two stretches, in which the vehicle turns: relative to either corridor is right.

    Parameters
    ----------
    constants_rad
        The axis of each stretch's corridor by the vehicle's yaw, as `constant_rad` finds them.
    """
    flight = load_flight(folder)
    if flight.attitude is None:
        return []
    (_, first), (last, _) = STRETCHES[flight.name]
    t_ns = flight.frames.t_ns
    yaw = _own_yaw(flight.attitude, t_ns)
    attitudes = attitudes_at(flight.attitude, t_ns)
    return [
        Case(
            source=f"{flight.name.removeprefix('mononav_')} turn {size_name(size)}",
            index=i,
            image=scaled(flight.frames.read(i), size),
            camera=flight.camera.resized(*size),
            attitude=attitudes[i],
            headings_rad=tuple(half_turn(float(yaw[i]) + c) for c in constants_rad),
            exact=False,
        )
        for i in range(first, last, every)
    ]


def right_answers(
    flown_rad: float, others_rad: Sequence[float], tie_rad: float = radians(15.0)
) -> tuple[float, ...]:
    """List the headings that are right where several corridors meet.

    Relative to the corridor being flown is always right, for its walls are all that some views hold. Relative to
    another one is right where the camera looks rather along that one, or about as much (within ``tie_rad``): one
    picture cannot tell which of them is flown. Any other direction, also that of a corridor far aside, is wrong.
    """
    flown = half_turn(flown_rad)
    others = [half_turn(h) for h in others_rad]
    return (flown, *(h for h in others if abs(h) <= abs(flown) + tie_rad))


def constant_rad(results: Sequence[Result]) -> float:
    """Median of measured minus known heading over accepted frames: what a yaw's zero is off the axis.

    Headings of a corridor repeat after half a turn, so the median is taken about the circular mean.
    """
    differences = np.array([r.error_rad for r in results if r.accepted])
    if not len(differences):
        return nan
    middle = 0.5 * float(np.angle(np.exp(2j * differences).mean()))
    return middle + float(np.median([half_turn(d - middle) for d in differences]))


def less_constant(cases: Sequence[Case], offset_rad: float) -> list[Case]:
    """Shift the known headings of a stretch by its constant."""
    return [replace(c, headings_rad=tuple(h + offset_rad for h in c.headings_rad)) for c in cases]


def _truth_of(flight: Flight) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Headings, the camera's offsets over half the width, and where they are known; each (frames,)."""
    t_ns = flight.frames.t_ns
    if flight.truth is None:
        if flight.attitude is None:
            return np.full(len(t_ns), nan), np.full(len(t_ns), nan), np.zeros(len(t_ns), dtype=bool)
        yaw = _own_yaw(flight.attitude, t_ns)
        return yaw, np.full(len(t_ns), nan), np.ones(len(t_ns), dtype=bool)
    at = interpolate_truth(flight.truth, t_ns)
    forward_m, right_m, _ = flight.camera.p_body_camera_m
    # The truth is the body's; the camera ahead of it swings out as the body turns.
    aside_m = forward_m * np.sin(at.heading_rad) + right_m * np.cos(at.heading_rad)
    half_m = at.lateral_offset_m / at.lateral_offset_norm
    return at.heading_rad, at.lateral_offset_norm + aside_m / half_m, at.known & ~at.in_junction


def _own_yaw(stream: AttitudeStream, t_ns: npt.NDArray[np.int64]) -> FloatArray:
    """Yaw (n,) at times (n,), positive to the right."""
    yaw = np.unwrap(yaw_of(stream.q_world_body))
    at, known_at = (t_ns - t_ns[0]).astype(float), (stream.t_ns - t_ns[0]).astype(float)
    return np.asarray(np.interp(at, known_at, yaw), dtype=float)


def attitudes_at(stream: AttitudeStream | None, t_ns: npt.NDArray[np.int64]) -> list[Attitude | None]:
    """Interpolate roll and pitch at times (n,); None where the log has no attitude."""
    if stream is None or not len(stream.t_ns):
        return [None] * len(t_ns)
    samples = [Attitude.from_quaternion(q) for q in stream.q_world_body]
    at = (t_ns - t_ns[0]).astype(float)
    known_at = (stream.t_ns - t_ns[0]).astype(float)
    roll = np.interp(at, known_at, np.unwrap([a.roll_rad for a in samples]))
    pitch = np.interp(at, known_at, [a.pitch_rad for a in samples])
    return [Attitude(float(r), float(p)) for r, p in zip(roll, pitch, strict=True)]


def scaled(image: GreyImage, size: Size) -> GreyImage:
    """Resize a picture by averaging areas."""
    if image.shape[::-1] == size:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def simulated_cases(size: Size, n: int, seed: int) -> Iterator[Case]:
    """Yield views of random corridors with the attitude that a log would have."""
    camera = Camera.from_fov(*size, SIMULATED_FOV_RAD)
    for index, view in enumerate(office_views(camera, n, seed)):
        yield case_of_view(view, f"simulated {size_name(size)}", index, camera)


def case_of_view(view: RandomView, source: str, index: int, camera: Camera) -> Case:
    """Take a simulated view as a case.

    ``camera`` may be mounted otherwise than the one that took it: the body is then the one it is straight on, and
    has another heading, roll and pitch. So a camera mounted askew shows what a turned vehicle would see.
    """
    R = rotation_of(view.heading_rad, Attitude(view.roll_rad, view.pitch_rad))
    heading, roll, pitch = angles_of(R @ view.camera.R_body_camera @ camera.R_body_camera.T)
    rng = np.random.default_rng((view.scene_seed, index, 11))
    d_roll, d_pitch = rng.normal(0.0, TILT_STD_RAD, 2).tolist()
    return Case(
        source=source,
        index=index,
        image=view.image,
        camera=camera,
        attitude=Attitude(roll + d_roll, pitch + d_pitch, TILT_STD_RAD),
        headings_rad=(half_turn(heading),),
        # Seen backwards, left and right change places.
        offset_norm=view.lateral_offset_norm * (1.0 if abs(heading) <= pi / 2 else -1.0),
    )


def rotation_of(heading_rad: float, attitude: Attitude) -> FloatArray:
    """Rotation (3, 3) from the body to axes along the corridor."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    R_corridor_level = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(R_corridor_level @ attitude.R_level_body(), dtype=float)


def angles_of(R: FloatArray) -> tuple[float, float, float]:
    """Heading, roll and pitch of a rotation (3, 3) as `rotation_of` makes them."""
    heading = atan2(R[1, 0], R[0, 0])
    return heading, atan2(R[2, 1], R[2, 2]), atan2(-R[2, 0], hypot(R[2, 1], R[2, 2]))


def describe(result: Result) -> str:
    """One line for a person who looks at the picture."""
    return (
        f"{result.source} {result.index}, {result.perturbation}: {degrees(result.heading_rad):.2f} for"
        f" {degrees(result.truth_rad):.2f}, sigma {degrees(result.std_rad):.2f}"
    )
