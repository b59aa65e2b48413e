"""Conversion of frames to python-can messages and back."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lidar_emu.transports.frames import Frame

if TYPE_CHECKING:
    import can


def message_of(frame: Frame, time_s: float = 0.0, channel: str | None = None) -> can.Message:
    """A frame as python-can sends and logs it.

    Args:
        frame: a data frame.
        time_s: since 1970, for a log.
        channel: name of the bus, for a log.
    """
    from can import Message

    return Message(
        timestamp=time_s,
        arbitration_id=frame.can_id,
        data=frame.data,
        is_fd=frame.is_fd,
        bitrate_switch=frame.bitrate_switch,
        is_extended_id=frame.is_extended,
        channel=channel,
    )


def frame_of(message: can.Message) -> Frame:
    """A data frame that python-can has received or read."""
    return Frame(
        message.arbitration_id,
        bytes(message.data),
        message.is_fd,
        message.bitrate_switch,
        message.is_extended_id,
    )
