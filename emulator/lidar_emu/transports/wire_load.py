"""Share of a link's capacity that a stream of packets takes, known before the run."""

from __future__ import annotations

from lidar_emu.errors import InputError
from lidar_emu.transports.frames import Frame, unpack_frames
from lidar_emu.transports.spec import Kind, PortSpec

_WARN_ABOVE = 0.7
_ROUNDING = 1e-9
SERIAL_BITS_PER_BYTE = 10  # start, eight data bits, stop; no parity
_FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


def wire_load(spec: PortSpec, payload: bytes, rate_hz: float) -> float:
    """Share of the link's capacity that `rate_hz` packets a second take; above 1 they do not fit.

    Args:
        spec: the port. A pty has no bit rate: its `baud` is the rate of the line that it represents.
        payload: the longest packet of the run, framed for the port (CAN: frame records).
        rate_hz: packets per second.
    """
    return time_on_link_s(spec, payload) * rate_hz


def time_on_link_s(spec: PortSpec, payload: bytes) -> float:
    """Transmission time of a packet; 0 if bits take no time. Arguments as for `wire_load`."""
    if not spec.has_bit_rate:
        return 0.0
    if spec.kind is Kind.CAN:
        return sum(frame_time_s(frame, spec) for frame in unpack_frames(payload))
    return SERIAL_BITS_PER_BYTE * len(payload) / spec.baud


def check_wire_load(spec: PortSpec, payload: bytes, rate_hz: float) -> str | None:
    """A warning if the link will be nearly full, otherwise None. Arguments as for `wire_load`.

    Raises:
        InputError: the packets do not fit.
    """
    load = wire_load(spec, payload, rate_hz)
    if load <= _WARN_ABOVE:
        return None
    option, rate = ("--bitrate", spec.bitrate) if spec.kind is Kind.CAN else ("--baud", spec.baud)
    what = f"{rate_hz:g} packets of {len(payload)} bytes per second"
    if spec.kind is Kind.CAN:
        what = f"{rate_hz:g} packets of {len(unpack_frames(payload))} frames per second"
    if load > 1 + _ROUNDING:
        remedy = f"must be faster, or rate_hz lower: {what} need {100 * load:.0f} % of the wire"
        raise InputError(option, None, rate, remedy)
    return f"{what} take {100 * load:.0f} % of {option} {rate}"


def drain_time_s(spec: PortSpec, unread: int) -> float:
    """Time in which the port sends the bytes that have not left it; 0 if the bit rate is unknown."""
    if spec.kind is not Kind.SERIAL or not spec.has_bit_rate:
        return 0.0
    return SERIAL_BITS_PER_BYTE * unread / spec.baud


def frame_time_s(frame: Frame, spec: PortSpec) -> float:
    """Longest time that one frame and the space behind it take on the bus."""
    arbitration_bits, data_bits = frame_bits(frame)
    return arbitration_bits / spec.bitrate + data_bits / spec.data_bitrate


def frame_bits(frame: Frame) -> tuple[int, int]:
    """Bits of a frame, with worst-case stuffing and the intermission: (at bit rate, at data bit rate).

    Classic frames (ISO 11898-1): 47 bits and the data, of which all but CRC delimiter, acknowledgement,
    end of frame and intermission (13 bits) can be stuffed, at worst one bit in four after the first:
    47 + 8n + floor((34 + 8n - 1) / 4) with an 11-bit identifier; 20 more bits with 29.

    CAN FD frames (ISO 11898-1:2015): from start of frame to BRS 17 bits (36 with a 29-bit identifier) and 12
    from the acknowledgement on; between them, at the data rate where BRS is set, ESI, 4 of DLC, the data, 4
    of stuff count, a CRC of 17 bits (21 above 16 bytes), one fixed stuff bit before and after each four bits
    of the last two, and the CRC delimiter. Dynamic stuffing ends with the data.
    """
    if not frame.is_fd:
        stuffable = 34 + 20 * frame.is_extended + 8 * len(frame.data)
        return stuffable + 13 + (stuffable - 1) // 4, 0
    length = next(allowed for allowed in _FD_LENGTHS if allowed >= len(frame.data))
    head = 36 if frame.is_extended else 17
    body = 1 + 4 + 8 * length
    crc = 4 + (17 if length <= 16 else 21)
    fixed_stuffing = 1 + crc // 4
    head_stuffing = (head - 1) // 4
    body_stuffing = (head + body - 1) // 4 - head_stuffing
    slow = head + head_stuffing + 12
    fast = body + body_stuffing + crc + fixed_stuffing + 1
    return (slow, fast) if frame.bitrate_switch else (slow + fast, 0)
