"""Find the messages in a MAVLink telemetry log: compiled, checksum and all.

Each record is eight bytes of time, most significant first, microseconds since 1970 by the recording computer, and
then a MAVLink packet of version 1 or 2. https://mavlink.io/en/guide/serialization.html
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.compiled import compiled

ByteArray = npt.NDArray[np.uint8]
IndexArray = npt.NDArray[np.int64]

MAX_ID = 1024
PACKET = 8  # bytes of time before it
_COLUMNS = 5  # of a packet found: identifier, payload's place and length, sender, place of the record


@dataclass(frozen=True, slots=True, eq=False)
class Packets:
    """Packets of wanted kinds, in the order of the file; every array is (n,).

    Parameters
    ----------
    identifier
        Which message.
    payload, length
        Where its payload stands and how long it is; trailing zeros are not sent.
    sender
        System times 256 plus component.
    record
        Where the record begins.
    damaged, lost
        How many packets failed their checksum, and how many bytes belong to no record.
    """

    identifier: IndexArray
    payload: IndexArray
    length: IndexArray
    sender: IndexArray
    record: IndexArray
    damaged: int
    lost: int


def find_packets(data: ByteArray, checksum_seeds: dict[int, int]) -> Packets:
    """Find the packets whose identifiers have a seed for their checksum."""
    seeds = np.full(MAX_ID, -1, dtype=np.int64)
    for identifier, seed in checksum_seeds.items():
        seeds[identifier] = seed
    tally = np.zeros(3, dtype=np.int64)
    _walk(data, seeds, tally, np.empty((0, _COLUMNS), dtype=np.int64))
    found = np.empty((int(tally[0]), _COLUMNS), dtype=np.int64)
    if len(found):
        _walk(data, seeds, np.zeros(3, dtype=np.int64), found)
    return Packets(*(found[:, k].copy() for k in range(_COLUMNS)), damaged=int(tally[1]), lost=int(tally[2]))


@compiled
def _checksum(data: ByteArray, start: int, end: int, seed: int) -> int:
    """CRC-16/MCRF4XX of some bytes and of the message's own seed."""
    crc = 0xFFFF
    for at in range(start, end + 1):
        byte = data[at] if at < end else seed
        low = (byte ^ crc) & 0xFF
        low = (low ^ (low << 4)) & 0xFF
        crc = ((crc >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)) & 0xFFFF
    return crc


@compiled
def _walk(data: ByteArray, seeds: IndexArray, tally: IndexArray, found: IndexArray) -> None:
    """Tally packets found, damaged, and bytes lost; note the found ones where there is room."""
    size = data.size
    at = 0
    while at + 16 <= size:
        magic = data[at + 8]
        length = np.int64(data[at + 9])
        signature = 0
        if magic == 0xFE:
            header = 6
            identifier = np.int64(data[at + 13])
            sender = np.int64(data[at + 11]) * 256 + data[at + 12]
        elif magic == 0xFD and at + 18 <= size:
            header = 10
            signature = 13 if data[at + 10] & 1 else 0
            identifier = (
                np.int64(data[at + 15]) + 256 * np.int64(data[at + 16]) + 65536 * np.int64(data[at + 17])
            )
            sender = np.int64(data[at + 13]) * 256 + data[at + 14]
        else:
            header = 0
            identifier = np.int64(0)
            sender = np.int64(0)
        payload = at + 8 + header
        end = payload + length + 2 + signature
        if header == 0 or data[at] != 0 or end > size:
            at += 1
            tally[2] += 1
            continue
        seed = seeds[identifier] if identifier < seeds.size else -1
        followed = end + 8 >= size or data[end + 8] == 0xFE or data[end + 8] == 0xFD
        if seed >= 0:
            crc = np.int64(data[payload + length]) + 256 * np.int64(data[payload + length + 1])
            if _checksum(data, at + 9, payload + length, seed) == crc:
                if found.shape[0]:
                    k = tally[0]
                    found[k, 0] = identifier
                    found[k, 1] = payload
                    found[k, 2] = length
                    found[k, 3] = sender
                    found[k, 4] = at
                tally[0] += 1
                at = end
                continue
            if followed:
                tally[1] += 1
        if followed:
            at = end
        else:
            at += 1
            tally[2] += 1
    tally[2] += size - at


@compiled
def _copy(data: ByteArray, starts: IndexArray, lengths: IndexArray, rows: ByteArray) -> None:
    for i in range(rows.shape[0]):
        for j in range(min(rows.shape[1], lengths[i])):
            rows[i, j] = data[starts[i] + j]


def payloads(
    data: ByteArray, starts: IndexArray, lengths: IndexArray, dtype: np.dtype[np.void]
) -> npt.NDArray[np.void]:
    """Payloads (n,) as records; what was not sent is zero."""
    rows = np.zeros((len(starts), dtype.itemsize), dtype=np.uint8)
    _copy(data, starts, lengths, rows)
    return rows.view(dtype)[:, 0] if len(starts) else np.empty(0, dtype)


def received_us(data: ByteArray, records: IndexArray) -> npt.NDArray[np.uint64]:
    """When the recording computer received each record (n,), microseconds since 1970."""
    rows = np.zeros((len(records), PACKET), dtype=np.uint8)
    _copy(data, records, np.full(len(records), PACKET, dtype=np.int64), rows)
    return rows.view(">u8")[:, 0].astype(np.uint64) if len(records) else np.empty(0, np.uint64)
