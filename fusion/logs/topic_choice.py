"""Choice of a flight's topics in a log, if the manifest does not name them.

A log may contain several topics of a kind. If one is clearly the vehicle's own, it is used; otherwise the user must
decide: for pictures and IMU an error is raised, other streams are left out with a problem.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from fusion.logs.contents import Kind, LogContents, Topic
from fusion.logs.samples import WithProblems
from vision import InputError

# Their readers list an autopilot's streams in its estimator's order of preference.
RANKED_FORMATS = frozenset({"PX4 ULog", "ArduPilot DataFlash log", "MAVLink tlog"})

# Patterns of the vehicle's own streams in other logs, the clearest first; matched against the whole name.
_PREFERRED: dict[Kind, tuple[str, ...]] = {
    Kind.FRAMES: (r"cam0",),
    Kind.IMU: (
        r"imu0",
        r"(/mavros)?/imu/data",
        r"(.*/)?imu/data",
        r"(/mavros)?/imu/data_raw",
        r"(.*/)?imu(_raw|/data_raw|/raw)?",
    ),
    Kind.ATTITUDE: (
        r"attitude0",
        r"(/mavros)?/imu/data",
        r"(.*/)?imu/data",
        r"(.*/)?imu(_raw|/raw)?",
        r"(.*/)?odometry/filtered",
        r"(.*/)?odom(etry)?",
    ),
    Kind.POSITION: (
        r"position0",
        r"(.*/)?local_position/(pose|odom)",
        r"(.*/)?odometry/filtered",
        r"(.*/)?odom(etry)?",
    ),
    Kind.VELOCITY: (
        r"velocity0",
        r"(.*/)?local_position/velocity_body",
        r"(.*/)?local_position/(velocity|odom)",
        r"(.*/)?odometry/filtered",
        r"(.*/)?odom(etry)?",
    ),
    Kind.RANGE: (
        r"range0",
        r"(/mavros)?/rangefinder/rangefinder",
        r"(/mavros)?/distance_sensor/[^/]*",
        r".*(down|bottom|height).*",
    ),
}
_SAME_PICTURES = re.compile(r"(/compressed|/image_raw|/image_rect|/image_mono|/image_color|/image)+$")

WORDS = {
    Kind.FRAMES: "pictures",
    Kind.IMU: "IMU data",
    Kind.ATTITUDE: "attitude",
    Kind.POSITION: "position",
    Kind.VELOCITY: "velocity",
    Kind.RANGE: "distances to the floor",
}
TABLES = {
    Kind.FRAMES: "camera",
    Kind.IMU: "imu",
    Kind.ATTITUDE: "attitude",
    Kind.POSITION: "position",
    Kind.VELOCITY: "velocity",
    Kind.RANGE: "range",
}


def choose_topic(log: LogContents, kind: Kind, wanted: str | None = None) -> WithProblems[str | None]:
    """Choose the topic to read as a kind; None if the log has none, or no clear one.

    Parameters
    ----------
    log
        An opened log.
    kind
        Kind of stream.
    wanted
        The topic in the manifest, if any.

    Returns
    -------
    WithProblems
        The topic, with a sentence if an ambiguous stream is left out.

    Raises
    ------
    InputError
        If the wanted topic does not exist, or there are several cameras or IMUs.
    """
    names = _in_use(log, kind)
    if wanted is not None:
        return WithProblems(_wanted(log, kind, wanted))
    if len(names) <= 1 or log.format in RANKED_FORMATS:
        return WithProblems(names[0] if names else None)
    best = _best(names, kind)
    if len(best) == 1:
        return WithProblems(best[0])
    listed, table = _listed(names), TABLES[kind]
    if kind not in (Kind.FRAMES, Kind.IMU):
        problem = (
            f"{log.path.name}: {len(names)} topics of {WORDS[kind]} ({listed}), none used: name one in flight.toml, "
            f'[{table}] topic = "{best[0]}"'
        )
        return WithProblems(None, (problem,))
    what = f"{len(names)} cameras" if kind is Kind.FRAMES else f"{len(names)} IMUs"
    raise InputError(
        f"holds {what}: {listed}",
        file=log.path,
        remedy=f'choose one in a flight.toml: log = "{log.path.name}", then [{table}] topic = "{best[0]}"',
    )


def _wanted(log: LogContents, kind: Kind, wanted: str) -> str:
    there = [topic.name for topic in log.topics if topic.kind is kind]
    if wanted in there:
        return wanted
    raise InputError(
        f"has no {WORDS[kind]} under {wanted!r}",
        file=log.path,
        remedy=f"choose one of {_listed(there)}" if there else f"it contains {contents_in_words(log)}",
    )


def _in_use(log: LogContents, kind: Kind) -> list[str]:
    """Names of the topics of a kind; those without samples only if there is no other."""
    topics = [topic for topic in log.topics if topic.kind is kind]
    return [topic.name for topic in topics if len(topic.t_ns)] or [topic.name for topic in topics]


def _best(names: Sequence[str], kind: Kind) -> list[str]:
    """Return the most preferred names."""
    if kind is Kind.FRAMES:
        names = _one_per_camera(names)
    ranks = [_rank(name, kind) for name in names]
    return [name for name, rank in zip(names, ranks, strict=True) if rank == min(ranks)]


def _one_per_camera(names: Sequence[str]) -> list[str]:
    """Keep one name per camera: a raw picture and its compressed copy are the same, and depth is left out."""
    cameras: dict[str, str] = {}
    for name in sorted(names, key=len):
        if not re.search(r"depth|disparity", name, re.IGNORECASE):
            cameras.setdefault(_SAME_PICTURES.sub("", name), name)
    return list(cameras.values()) or list(names)


def _rank(name: str, kind: Kind) -> int:
    patterns = _PREFERRED[kind]
    return next((i for i, pattern in enumerate(patterns) if re.fullmatch(pattern, name)), len(patterns))


def _listed(names: Sequence[str], limit: int = 8) -> str:
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more


def contents_in_words(log: LogContents) -> str:
    """Describe a log's contents in words."""
    topics: dict[Kind, list[Topic]] = {}
    for topic in log.topics:
        topics.setdefault(topic.kind, []).append(topic)
    parts = [f"{WORDS[kind]} ({_listed([t.name for t in found], 3)})" for kind, found in topics.items()]
    return ", ".join(parts) or "nothing that a flight is made of"
