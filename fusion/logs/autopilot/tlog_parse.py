"""Find the messages in a MAVLink telemetry log with compiled code, including checksums.

Each record is eight bytes of time, most significant first, microseconds since 1970 by the recording computer, and
then a MAVLink packet of version 1 or 2. https://mavlink.io/en/guide/serialization.html
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled, compiled_inner

ByteArray = npt.NDArray[np.uint8]
IndexArray = npt.NDArray[np.int64]

MAX_ID = 1 << 16
TIME_BYTES = 8
_COLUMNS = 5  # of a packet: identifier, payload's position and length, sender, position of the record
_FOUND, _DAMAGED, _UNKNOWN, _LOST = range(4)  # indices of the tally


@dataclass(frozen=True, slots=True, eq=False)
class Packets:
    """Packets of requested kinds, in the order of the file; every array is (n,).

    Parameters
    ----------
    identifier
        Message number.
    payload, length
        Position and length of its payload; trailing zeros are not sent.
    sender
        System times 256 plus component.
    record
        Position of the record.
    damaged, unknown, lost
        Number of packets with a wrong checksum, of packets of unknown messages, and of bytes outside records.
    """

    identifier: IndexArray
    payload: IndexArray
    length: IndexArray
    sender: IndexArray
    record: IndexArray
    damaged: int
    unknown: int
    lost: int


def find_packets(data: ByteArray, seeds: dict[int, int], wanted: Iterable[int]) -> Packets:
    """Find the requested packets; ``seeds`` are the checksum seeds of all known messages."""
    seed_of = np.full(MAX_ID, -1, dtype=np.int64)
    for identifier, seed in seeds.items():
        if identifier < MAX_ID:
            seed_of[identifier] = seed
    is_wanted = np.zeros(MAX_ID, dtype=np.bool_)
    is_wanted[list(wanted)] = True
    tally = np.zeros(4, dtype=np.int64)
    _scan(data, seed_of, is_wanted, tally, np.empty((0, _COLUMNS), dtype=np.int64))
    found = np.empty((int(tally[_FOUND]), _COLUMNS), dtype=np.int64)
    if len(found):
        _scan(data, seed_of, is_wanted, np.zeros(4, dtype=np.int64), found)
    kinds, payloads_at, sizes, senders, records = found.T.copy()
    damaged, unknown, lost = (int(tally[k]) for k in (_DAMAGED, _UNKNOWN, _LOST))
    return Packets(kinds, payloads_at, sizes, senders, records, damaged, unknown, lost)


@compiled_inner
def _checksum(data: ByteArray, start: int, end: int, seed: int) -> int:
    """CRC-16/MCRF4XX of some bytes and the message's seed."""
    crc = 0xFFFF
    for at in range(start, end + 1):
        byte = data[at] if at < end else seed
        low = (byte ^ crc) & 0xFF
        low = (low ^ (low << 4)) & 0xFF
        crc = ((crc >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)) & 0xFFFF
    return crc


@compiled
def _scan(
    data: ByteArray,
    seed_of: IndexArray,
    is_wanted: npt.NDArray[np.bool_],
    tally: IndexArray,
    found: IndexArray,
) -> None:
    """Count found, damaged, unknown and lost packets; store the requested ones if there is room."""
    size = data.size
    at = 0
    while at + 16 <= size:
        magic = int(data[at + 8])
        length = int(data[at + 9])
        header = 0
        signature = 0
        identifier = 0
        sender = 0
        if magic == 0xFE:
            header = 6
            identifier = int(data[at + 13])
            sender = int(data[at + 11]) * 256 + int(data[at + 12])
        elif magic == 0xFD and at + 18 <= size:
            header = 10
            signature = 13 if data[at + 10] & 1 else 0
            identifier = int(data[at + 15]) + 256 * int(data[at + 16]) + 65536 * int(data[at + 17])
            sender = int(data[at + 13]) * 256 + int(data[at + 14])
        payload = at + 8 + header
        end = payload + length + 2 + signature
        if header == 0 or data[at] != 0 or end > size:
            at += 1
            tally[3] += 1
            continue
        seed = int(seed_of[identifier]) if identifier < seed_of.size else -1
        sound = False
        if seed >= 0:
            crc = int(data[payload + length]) + 256 * int(data[payload + length + 1])
            sound = _checksum(data, at + 9, payload + length, seed) == crc
        if not sound:
            if end + 8 < size and data[end + 8] != 0xFE and data[end + 8] != 0xFD:
                at += 1  # no packet follows, so this was not one
                tally[3] += 1
                continue
            tally[2 if seed < 0 else 1] += 1
        elif is_wanted[identifier]:
            if found.shape[0]:
                k = tally[0]
                found[k, 0] = identifier
                found[k, 1] = payload
                found[k, 2] = length
                found[k, 3] = sender
                found[k, 4] = at
            tally[0] += 1
        at = end
    tally[3] += size - at


@compiled
def _copy(data: ByteArray, starts: IndexArray, lengths: IndexArray, rows: ByteArray) -> None:
    for i in range(rows.shape[0]):
        for j in range(min(rows.shape[1], lengths[i])):
            rows[i, j] = data[starts[i] + j]


def payloads(
    data: ByteArray, starts: IndexArray, lengths: IndexArray, dtype: np.dtype[np.void]
) -> npt.NDArray[np.void]:
    """Read payloads as records; missing trailing bytes are zero.

    Parameters
    ----------
    data
        Bytes of the log.
    starts, lengths
        Positions and lengths of the payloads (n,).
    dtype
        Layout of the message.

    Returns
    -------
    array
        Records (n,).
    """
    rows = np.zeros((len(starts), dtype.itemsize), dtype=np.uint8)
    _copy(data, starts, lengths, rows)
    return rows.view(dtype)[:, 0] if len(starts) else np.empty(0, dtype)


def received_us(data: ByteArray, records: IndexArray) -> npt.NDArray[np.uint64]:
    """Time of receipt of each record (n,) by the recording computer, microseconds since 1970."""
    rows = np.zeros((len(records), TIME_BYTES), dtype=np.uint8)
    _copy(data, records, np.full(len(records), TIME_BYTES, dtype=np.int64), rows)
    return rows.view(">u8")[:, 0].astype(np.uint64) if len(records) else np.empty(0, np.uint64)
