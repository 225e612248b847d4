"""Replay a recording of `corridor live` through the same core: the packets must be the same, bit for bit."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fusion.estimator.config import FusionConfig
from fusion.estimator.tables import ESTIMATE_COLUMNS, ESTIMATE_DTYPE, Table, estimate_row
from fusion.live.core import LiveCore
from fusion.live.recording import ESTIMATE, PICTURE, RECEIVED, SENT, TYPES, UNREADABLE, typestore
from fusion.live.settings import LiveSettings
from fusion.logs.rosbag.attachments import CONFIG, SETTINGS, attached_camera, attachments
from fusion.settings.toml import build
from vision import InputError, extract_lines


class _Event(NamedTuple):
    topic: str
    now_ns: int
    message: Any


@dataclass(slots=True)
class Replay:
    """Result of a replay.

    Parameters
    ----------
    estimates
        Of `ESTIMATE_DTYPE`, a row per tick, as computed again.
    packets_sent, packets_equal
        Number of packets sent in flight, and of those reproduced bit for bit.
    estimates_equal
        Number of estimates reproduced bit for bit.
    """

    estimates: Table
    packets_sent: int = 0
    packets_equal: int = 0
    estimates_equal: int = 0
    problems: list[str] = field(default_factory=list)

    @property
    def is_exact(self) -> bool:
        """Whether everything that was sent was reproduced."""
        return self.packets_equal == self.packets_sent and self.estimates_equal == len(self.estimates)

    def text(self) -> str:
        """Return the result in words."""
        n = len(self.estimates)
        sentence = f"sent in flight: {n} estimates, {self.packets_sent} packets; computed again: "
        if self.is_exact:
            sentence += "the same to the bit"
        else:
            sentence += (
                f"{self.estimates_equal} estimates and {self.packets_equal} packets the same; the versions or the "
                "processor differ, or the recording has gaps"
            )
        return "\n".join([sentence, *self.problems])


def recorded_config(path: Path) -> FusionConfig | None:
    """Return the estimator's settings in flight; None if the file is not a recording of `corridor live`."""
    import tomllib

    text = attachments(path).get(CONFIG)
    return None if text is None else build(FusionConfig, tomllib.loads(text), path)


def replay(path: Path) -> Replay:
    """Run the core over a recording.

    Raises
    ------
    InputError
        If the file is not a recording of `corridor live`, or nothing but its beginning can be read.
    """
    attached = attachments(path)
    config, camera = recorded_config(path), attached_camera(path)
    if config is None or camera is None:
        raise InputError("is not a recording of corridor live", file=path, remedy="give its .mcap file")
    settings = build(LiveSettings, json.loads(attached[SETTINGS]), path)
    core = LiveCore(config, camera, settings)
    result = Replay(np.empty(0, ESTIMATE_DTYPE))
    rows: list[tuple[Any, ...]] = []
    expected: list[bytes] = []  # computed, but not yet found among the sent packets
    for event in _events(path, result.problems):
        if event.topic == SENT:
            result.packets_sent += 1
            if expected and expected.pop(0) == event.message.data.tobytes():
                result.packets_equal += 1
        elif event.topic == RECEIVED:
            expected = core.on_bytes(event.now_ns, event.message.data.tobytes())
        elif event.topic == ESTIMATE:
            expected = core.on_tick(event.now_ns)
            row = estimate_row(core.estimate)
            rows.append(row)
            recorded = tuple(getattr(event.message, c.name) for c in ESTIMATE_COLUMNS)
            result.estimates_equal += all(
                a == b or (a != a and b != b) for a, b in zip(row, recorded, strict=True)
            )
        elif event.topic == PICTURE:
            m = event.message
            lines = extract_lines(m.data.reshape(m.height, m.width), camera)
            core.on_frame(_stamp_ns(m.header), lines)
        else:
            core.on_frame(_stamp_ns(event.message), None)
    result.estimates = np.array(rows, dtype=ESTIMATE_DTYPE)
    return result


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _events(path: Path, problems: list[str]) -> Iterator[_Event]:
    """Messages in the order of processing, up to the end of a truncated file."""
    from mcap.records import Channel, Message
    from mcap.stream_reader import StreamReader

    store = typestore()
    wanted = {RECEIVED, SENT, ESTIMATE, PICTURE, UNREADABLE}
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        records = StreamReader(file, record_size_limit=2**30).records
        while True:
            try:
                record = next(records, None)
            except Exception as error:  # a truncated file may end anywhere
                problems.append(f"the recording ends early: {error or type(error).__name__}")
                return
            if record is None:
                return
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message) and (topic := topics.get(record.channel_id, "")) in wanted:
                message = store.deserialize_cdr(record.data, TYPES[topic])
                yield _Event(topic, record.log_time, message)
