"""Receiver for a lidar on a serial line: a line of JSON for every message, and commands at chosen shots.

    python receiver.py /dev/ttyUSB0 921600
    python receiver.py /dev/ttyUSB0 921600 2000:set_pattern=1 3000:set_pattern=0

Written from INTERFACE.md alone, with only the standard library, so that parts of it can be copied. The port may be "-",
the standard input, to read a capture. receiver.c prints the same lines.
"""

from __future__ import annotations

import binascii
import os
import re
import select
import struct
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import suppress

UNIT = 0
TIMEOUT_S = 1.0  # Timeout after which an unacknowledged command is repeated.
LONGEST_FRAME = 1830  # section 4

# Section 2. The APID's upper bits are the kind, its lowest four the unit.
HEADER = struct.Struct(">HHH")
MEASUREMENT, ACKNOWLEDGE, HOUSEKEEPING, COMMAND = 0x0AA0, 0x0AC0, 0x0AB0, 0x12A0
INTERFACE_VERSION = 3

SHOT = struct.Struct(">7s7sBBBBIB")
BEAM = struct.Struct(">BBhIiIHHhHIHB")
BEAM_NUMBERS = (  # name, lowest and highest raw value, steps per unit
    ("snr_db", -0x7FFF, 0x7FFF, 100),
    ("range_m", 0, 0xFFFFFFFE, 1000),
    ("closing_speed_mps", -0x7FFFFFFF, 0x7FFFFFFF, 10_000),
    ("second_range_m", 0, 0xFFFFFFFE, 1000),
    ("sigma_range_m", 0, 0xFFFE, 10_000),
    ("sigma_speed_mps", 0, 0xFFFE, 100_000),
    ("residual_mps", -0x7FFF, 0x7FFF, 10_000),
    ("beam_angle_deg", 0, 9000, 100),
    ("time_offset_s", 0, 0xFFFFFFFE, 1_000_000),
    ("second_sigma_range_m", 0, 0xFFFE, 10_000),
)

# Section 6.
OUT_OF_STATE = 4
ANSWER = struct.Struct(">7sBBB")
HEALTH = struct.Struct(">7sBBBBBBhHIIIHHII")
COMMANDS = {  # name: code, argument, steps per unit
    "no_op": (0, "", 0),
    "set_mode": (1, "B", 1),
    "set_pattern": (2, "B", 1),
    "set_rate_hz": (3, "I", 1000),
    "enable_beams": (4, "I", 1),
    "reset": (7, "B", 1),
}


# ---------------------------------------------------------------------------------------------------- bytes to packets
def unstuffed(frame: bytes) -> bytes | None:
    """The packet in a frame; None if the frame ends inside a run (section 4)."""
    packet, place = bytearray(), 0
    while place < len(frame):
        code = frame[place]
        if place + code > len(frame):
            return None
        packet += frame[place + 1 : place + code]
        place += code
        if code < 255 and place < len(frame):
            packet.append(0)
    return bytes(packet)


def checked(packet: bytes | None) -> bytes | None:
    """The packet, if its length and its CRC are right. The CRC of a packet with its CRC is zero."""
    if packet is None or len(packet) <= 8:
        return None
    stated = HEADER.unpack_from(packet)[2] + 7
    return packet if stated == len(packet) and binascii.crc_hqx(packet, 0xFFFF) == 0 else None


class Frames:
    """Divides a stream at its zeros, with a bounded buffer."""

    def __init__(self) -> None:
        self.bad = 0
        self._rest = b""
        self._is_too_long = False

    def packets(self, data: bytes) -> Iterator[bytes]:
        """Good packets that are complete with `data`."""
        *frames, self._rest = (self._rest + data).split(b"\0")
        for frame in frames:
            packet = None if self._is_too_long else checked(unstuffed(frame))
            if packet is not None:
                yield packet
            elif frame or self._is_too_long:
                self.bad += 1
            self._is_too_long = False
        if len(self._rest) > LONGEST_FRAME:
            self._rest, self._is_too_long = b"", True


# --------------------------------------------------------------------------------------------------- messages as lines
def nanoseconds(code: bytes) -> int:
    """A time code as nanoseconds from the epoch, half a unit rounded up (section 1)."""
    return (int.from_bytes(code, "big") * 10**9 + (1 << 23)) >> 24


def flag(bit: int) -> str:
    """JSON boolean of a bit."""
    return "true" if bit else "false"


def number(raw: int, lowest: int, highest: int, steps: int) -> str:
    """A value with as many decimals as its resolution; a raw value outside the range is none."""
    return f"{raw / steps:.{len(str(steps)) - 1}f}" if lowest <= raw <= highest else "null"


def json_object(entries: dict[str, object]) -> str:
    """JSON object of values that are JSON already."""
    return "{" + ",".join(f'"{name}":{value}' for name, value in entries.items()) + "}"


def beam_line(beam: int, packet: bytes) -> str:
    """JSON object of one beam of a measurement packet (section 2)."""
    flags, why, *raws, second_why = BEAM.unpack_from(packet, 29 + 31 * beam)
    values: dict[str, object] = {
        "beam": beam,
        "fired": flag(flags & 0x80),
        "range_valid": flag(flags & 0x40),
        "speed_valid": flag(flags & 0x20),
        "sign_resolved": flag(flags & 0x10),
        "segments": flags & 7,
        "reason": why >> 4,
        "returns": why & 15,
    }
    for raw, (name, lowest, highest, steps) in zip(raws, BEAM_NUMBERS, strict=True):
        values[name] = number(raw, lowest, highest, steps)
    values["second_reason"] = second_why & 15
    return json_object(values)


def measurement_line(unit: int, packet: bytes) -> tuple[int, str] | None:
    """Shot number and line of a measurement; None if length or version are wrong."""
    if len(packet) < 31:
        return None
    time_code, due, version, mode, flags, beams, shot, pattern = SHOT.unpack_from(packet, 6)
    if version != INTERFACE_VERSION or not 1 <= beams <= 64 or len(packet) != 31 + 31 * beams:
        return None
    return shot, json_object(
        {
            "kind": '"measurement"',
            "unit": unit,
            "shot": shot,
            "pattern": pattern,
            "time_ns": nanoseconds(time_code),
            "due_ns": nanoseconds(due),
            "mode": mode,
            "laser_on": flag(flags & 2),
            "clock_locked": flag(flags & 1),
            "beams": "[" + ",".join(beam_line(k, packet) for k in range(beams)) + "]",
        }
    )


def acknowledge_line(unit: int, packet: bytes) -> tuple[int, int, str] | None:
    """Sequence number of the acknowledged command, its verdict, and the line."""
    if len(packet) != HEADER.size + ANSWER.size + 2:
        return None
    time_code, command, sequence, verdict = ANSWER.unpack_from(packet, 6)
    values = {"time_ns": nanoseconds(time_code), "command": command, "sequence": sequence, "verdict": verdict}
    return sequence, verdict, json_object({"kind": '"acknowledge"', "unit": unit, **values})


def housekeeping_line(unit: int, packet: bytes) -> str | None:
    """Line of a housekeeping packet; None if length or version are wrong."""
    if len(packet) != HEADER.size + HEALTH.size + 2:
        return None
    time_code, version, _, _, _, mode, flags, temperature, power, uptime, *counters, _ = HEALTH.unpack_from(
        packet, 6
    )
    dropped, late, accepted, rejected, bad_bytes = counters
    if version != INTERFACE_VERSION:
        return None
    return json_object(
        {
            "kind": '"housekeeping"',
            "unit": unit,
            "time_ns": nanoseconds(time_code),
            "mode": mode,
            "interlock_closed": flag(flags & 4),
            "laser_on": flag(flags & 2),
            "clock_locked": flag(flags & 1),
            "temperature_c": number(temperature, -0x7FFF, 0x7FFF, 100),
            "laser_power_w": number(power, 0, 0xFFFE, 1000),
            "uptime_s": number(uptime, 0, 0xFFFFFFFE, 1),
            "shots_dropped": dropped,
            "shots_late": late,
            "commands_accepted": accepted,
            "commands_rejected": rejected,
            "bad_bytes": bad_bytes,
        }
    )


# ------------------------------------------------------------------------------------------------------------ commands
def stuffed(packet: bytes) -> bytes:
    """Frame of a packet of less than 254 bytes, with a delimiter before it as well: each run with its length."""
    return b"\0" + b"".join(bytes((len(run) + 1,)) + run for run in packet.split(b"\0")) + b"\0"


def encoded(name: str, sequence: int, value: float) -> bytes:
    """Bytes of a command. Raises KeyError or struct.error if name or value are invalid."""
    code, kind, steps = COMMANDS[name]
    argument = struct.pack(f">{kind}", round(value * steps)) if kind else b""
    body = bytes((code, sequence)) + argument
    packet = HEADER.pack(COMMAND + UNIT, 0xC000 | sequence, len(body) + 2 - 1) + body
    return stuffed(packet + binascii.crc_hqx(packet, 0xFFFF).to_bytes(2, "big"))


class Commander:
    """Sends commands, one at a time.

    A command is repeated until it is acknowledged, since command or acknowledgement may be lost; and with the next
    sequence number while the device rejects it in its present mode.
    """

    def __init__(self, port: int, commands: list[str]) -> None:
        self._port = port
        self._pending = [self._parse(text) for text in commands]
        self._sequence = 0
        self._sent_s: float | None = None

    @property
    def is_waiting(self) -> bool:
        """Whether a command has not been acknowledged yet."""
        return self._sent_s is not None

    def command(self, newest_shot: int) -> None:
        """Send what is due. Commands of shot 0 are due at once."""
        if not self._pending or newest_shot < self._pending[0][0]:
            return
        if self._sent_s is None or time.monotonic() - self._sent_s >= TIMEOUT_S:
            _, name, value = self._pending[0]
            self._sent_s = time.monotonic()
            os.write(self._port, encoded(name, self._sequence, value))

    def process_acknowledgement(self, sequence: int, verdict: int) -> None:
        """Process an acknowledgement: go on to the next command, or repeat the rejected one later."""
        if self._sent_s is None or sequence != self._sequence:
            return
        self._sequence = (self._sequence + 1) % 256
        if verdict == OUT_OF_STATE:
            return  # Repeated after the timeout.
        self._sent_s = None
        del self._pending[0]

    @staticmethod
    def _parse(text: str) -> tuple[int, str, float]:
        """Parse `2000:set_pattern=1`: shot, command, value."""
        match = re.fullmatch(r"(\d+):([a-z_]+)(?:=(.+))?", text)
        try:
            assert match is not None
            command = int(match[1]), match[2], float(match[3] or 0)
            encoded(match[2], 0, command[2])
        except (AssertionError, KeyError, ValueError, struct.error):
            sys.exit(f"{text}: not a command such as 2000:set_pattern=1")
        return command


# -------------------------------------------------------------------------------------------------------- main program
class Follower:
    """Prints messages, and counts frames and shots."""

    def __init__(self, commander: Commander) -> None:
        self.newest_shot = 0
        self._commander = commander
        self._frames = Frames()
        self._counts = dict.fromkeys(("measurements", "acknowledges", "housekeeping"), 0)
        self._gaps = self._lost = self._repeats = self._foreign = 0

    def follow(self, data: bytes) -> None:
        """Print the messages that are complete with `data`, and send the commands that are due."""
        for packet in self._frames.packets(data):
            if not self._take(packet):
                self._foreign += 1  # Not a known packet, or another version of the interface.
            self._commander.command(self.newest_shot)

    def _take(self, packet: bytes) -> bool:
        first, sequence, _ = HEADER.unpack_from(packet)
        kind, unit = first & ~15, first & 15
        if sequence < 0xC000:
            return False
        if kind == MEASUREMENT and (shot := measurement_line(unit, packet)) is not None:
            self._count(shot[0])
            return self._print("measurements", shot[1])
        if kind == ACKNOWLEDGE and (answer := acknowledge_line(unit, packet)) is not None:
            sequence, verdict, line = answer
            self._commander.process_acknowledgement(sequence, verdict)
            return self._print("acknowledges", line)
        if kind == HOUSEKEEPING and (health := housekeeping_line(unit, packet)) is not None:
            return self._print("housekeeping", health)
        return False

    def _print(self, kind: str, line: str) -> bool:
        self._counts[kind] += 1
        print(line)
        return True

    def _count(self, shot: int) -> None:
        """Count gaps: shots are numbered in 32 bits; an increment other than 1 means lost or repeated shots, or a
        restart."""
        missing = (shot - self.newest_shot - 1) % 2**32
        if self._counts["measurements"] and missing >= 2**31 - 1:
            self._repeats += 1
        elif self._counts["measurements"] and missing:
            self._gaps += 1
            self._lost += missing
        self.newest_shot = shot

    def end(self) -> None:
        """Print the counts."""
        bad = self._frames.bad + self._foreign
        gaps = {"gaps": self._gaps, "lost_shots": self._lost, "repeats": self._repeats}
        print(json_object({"kind": '"end"', **self._counts, "bad_frames": bad, **gaps}))


def open_port(path: str, baud: str) -> int:
    """Open the port in raw mode, in which a terminal passes every byte unchanged."""
    if path == "-":
        return sys.stdin.fileno()
    port = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(port)
    settings = termios.tcgetattr(port)
    settings[2] |= termios.CLOCAL | termios.CREAD
    settings[4] = settings[5] = getattr(termios, f"B{baud}")
    termios.tcsetattr(port, termios.TCSANOW, settings)
    return port


def main() -> None:
    """Follow the port until the other side closes it."""
    if len(sys.argv) < 3 or not hasattr(termios, f"B{sys.argv[2]}"):
        sys.exit("usage: receiver.py PORT BAUD [SHOT:COMMAND[=VALUE]]...")
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    try:
        port = open_port(*sys.argv[1:3])
    except (OSError, termios.error) as error:
        sys.exit(f"{sys.argv[1]}: {error.args[-1]}")
    commander = Commander(port, sys.argv[3:])
    follower = Follower(commander)
    with suppress(KeyboardInterrupt):  # Ctrl-C ends with the counts too.
        while True:
            commander.command(follower.newest_shot)
            if not select.select([port], [], [], TIMEOUT_S / 10 if commander.is_waiting else None)[0]:
                continue
            try:
                data = os.read(port, 4096)
            except OSError:  # The other side has closed the line.
                break
            if not data:
                break
            follower.follow(data)
    follower.end()


if __name__ == "__main__":
    main()
