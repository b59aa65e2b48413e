"""Logs of a CAN bus as python-can reads and writes them: candump's, Vector's, PEAK's."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from lidar_emu.errors import Finding, InputError, one_line
from lidar_emu.transports.can_messages import frame_of, message_of
from lidar_emu.transports.frames import pack_frames, unpack_frames

LOG_SUFFIXES = (".log", ".asc", ".blf", ".trc")


def read_log(path: Path) -> tuple[list[tuple[int, bytes]], dict[str, int], int]:
    """Data frames with their times in nanoseconds, how many there are of each bus, and how many others.

    Raises:
        InputError: the library cannot read the file.
    """
    from can.io import MESSAGE_READERS

    logging.getLogger("can").setLevel(logging.CRITICAL)
    frames: list[tuple[int, bytes]] = []
    buses: Counter[str] = Counter()
    others, suffix = 0, path.suffix.lower()
    reader_of: Any = MESSAGE_READERS[suffix]
    try:
        # Opened here: a reader that does not like a file's head leaves it open.
        with path.open("rb" if suffix == ".blf" else "r") as file, reader_of(file) as reader:
            for message in reader:
                if message.is_error_frame or message.is_remote_frame:
                    others += 1
                    continue
                buses[str(message.channel)] += 1
                frames.append((round(message.timestamp * 1e9), pack_frames([frame_of(message)])))
    # A line or an object that makes no sense to the library: it raises what it likes.
    except Exception as error:
        found = Finding(
            f"not readable after {len(frames)} frames: {one_line(str(error)) or type(error).__name__}"
        )
        raise InputError(str(path), None, found, f"allowed: a log in the format of {path.suffix}") from None
    return frames, dict(buses), others


def write_log(path: Path, packets: Iterable[tuple[int, bytes]]) -> None:
    """Write frame records, with times in nanoseconds since 1970, in the format of the file's suffix."""
    from can import Logger

    with Logger(path) as logger:
        for time_ns, payload in packets:
            for frame in unpack_frames(payload):
                logger(message_of(frame, time_ns * 1e-9, channel="can0"))
