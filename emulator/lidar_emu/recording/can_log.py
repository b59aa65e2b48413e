"""Logs of a CAN bus in the formats of python-can: candump, Vector ASC and BLF, PEAK TRC."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lidar_emu.errors import Finding, InputError, one_line
from lidar_emu.files import MOST_BYTES_IN_MEMORY, check_file
from lidar_emu.transports.can_messages import frame_of, message_of
from lidar_emu.transports.frames import pack_frames, unpack_frames

LOG_SUFFIXES = (".log", ".asc", ".blf", ".trc")


def read_log(path: Path) -> tuple[list[tuple[int, bytes]], dict[str, int], int]:
    """Read the data frames of a log.

    Returns:
        Data frames as (nanoseconds, frame record), number of data frames by bus, number of error and remote frames.

    Raises:
        InputError: python-can cannot read the file.
    """
    from can.io import MESSAGE_READERS

    check_file(path, f"must be a log in the format of {path.suffix}", MOST_BYTES_IN_MEMORY)
    logging.getLogger("can").setLevel(logging.CRITICAL)
    frames: list[tuple[int, bytes]] = []
    buses: Counter[str] = Counter()
    others, suffix = 0, path.suffix.lower()
    reader_of: Any = MESSAGE_READERS[suffix]
    try:
        # Opened here because a reader that rejects the header of a file leaves the file open.
        with path.open("rb" if suffix == ".blf" else "r") as file, reader_of(file) as reader:
            for message in reader:
                if message.is_error_frame or message.is_remote_frame:
                    others += 1
                    continue
                buses[str(message.channel)] += 1
                frames.append((round(message.timestamp * 1e9), pack_frames([frame_of(message)])))
    # The readers raise various exceptions for malformed lines and objects.
    except Exception as error:
        found = Finding(
            f"not readable after {len(frames)} frames: {one_line(str(error)) or type(error).__name__}"
        )
        raise InputError(str(path), None, found, f"must be a log in the format of {path.suffix}") from None
    return frames, dict(buses), others


def write_log(path: Path, packets: Iterable[tuple[int, bytes]]) -> None:
    """Write frame records, with times in nanoseconds since 1970, in the format that the suffix names."""
    from can import Logger

    with Logger(path) as logger:
        for time_ns, payload in packets:
            for frame in unpack_frames(payload):
                logger(message_of(frame, time_ns * 1e-9, channel="can0"))
