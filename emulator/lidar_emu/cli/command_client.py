"""The host's side of a command: send it, wait for its acknowledgement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from lidar_emu.cli.messages import Decoder, device_time_s
from lidar_emu.runtime.clock import Clock
from lidar_emu.transports.frames import Frame, pack_frames
from lidar_emu.transports.opening import ByteHost, CanHost
from lidar_protocol import Acknowledge, Host, Interface
from lidar_protocol.commands import Argument

_READ_S = 0.05
_REPEAT_S = 0.5
NO_ACKNOWLEDGEMENT = "no acknowledgement"
SENT = "sent"


class CommandResult(NamedTuple):
    """The result of a command."""

    verdict: str
    """Verdict of the device, or `NO_ACKNOWLEDGEMENT`; `SENT` where the interface has no acknowledgements."""
    time_s: float | None = None
    """Time of the acknowledgement, by the device's clock."""


class CommandClient:
    """Commands one unit over an open link.

    Args:
        host: the link.
        interface: message definitions.
        unit: number of the commanded device.
        timeout_s: longest wait for an acknowledgement.
    """

    def __init__(self, host: ByteHost | CanHost, interface: Interface, unit: int, timeout_s: float) -> None:
        self._host, self._unit, self._timeout_s = host, unit, timeout_s
        self._encoder = Host(interface, unit)
        self._decoder = Decoder(interface)
        self._is_can = isinstance(host, CanHost)
        self._clock = Clock()
        can_acknowledge = interface.can.acknowledge if interface.can else None
        self._has_acknowledgements = bool(can_acknowledge if self._is_can else interface.acknowledge)
        assert interface.commands is not None
        self._steps = interface.commands.sequence_steps
        self._has_no_op = "no_op" in interface.commands.by_name
        self._next = 0

    def set_sequence(self, sequence: int) -> None:
        """Set the sequence number of the next command."""
        self._next = sequence

    def synchronise(self) -> CommandResult | None:
        """Synchronise the sequence number with the device; None if the interface has no `no_op`.

        The device accepts a `no_op` with any number but the last command's: whether it is accepted or,
        having that number, rejected, the next number is the one after it. It is repeated, because a device that boots
        receives nothing.
        """
        if not self._has_no_op:
            return None
        self._next = 1
        ends_ns = self._clock.now_ns() + round(self._timeout_s * 1e9)
        result = CommandResult(NO_ACKNOWLEDGEMENT)
        while result.verdict == NO_ACKNOWLEDGEMENT and self._clock.now_ns() < ends_ns:
            result = self._exchange("no_op", {"sequence": 0}, min(_REPEAT_S, self._timeout_s))
        return result

    def send(self, name: str, values: Mapping[str, Argument]) -> CommandResult:
        """Send a command and wait for its acknowledgement.

        Raises:
            EncodeError: unknown command, or an argument is missing, unknown or cannot be encoded.
        """
        sequence, self._next = self._next, (self._next + 1) % self._steps
        return self._exchange(name, {**values, "sequence": sequence}, self._timeout_s)

    def _exchange(self, name: str, values: Mapping[str, Argument], timeout_s: float) -> CommandResult:
        payload = self._encoded(name, values)
        ends_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        is_out = self._host.write(payload)
        while self._clock.now_ns() < ends_ns:
            if is_out and not self._has_acknowledgements:
                return CommandResult(SENT)
            for message in self._decoder.receive(self._host.read(_READ_S)):
                if isinstance(message, Acknowledge) and self._matches(message, name, values["sequence"]):
                    return CommandResult(message.verdict, device_time_s(message))
            is_out = is_out or self._host.write(payload)
        return CommandResult(NO_ACKNOWLEDGEMENT)

    def _encoded(self, name: str, values: Mapping[str, Argument]) -> bytes:
        if not self._is_can:
            return self._encoder.encode_command(name, **values)
        frame = self._encoder.encode_command_frame(name, **values)
        return pack_frames([Frame(frame.can_id, frame.data)])

    def _matches(self, message: Acknowledge, name: str, sequence: Argument) -> bool:
        """Whether it acknowledges this command; some interfaces omit command or sequence."""
        return (
            message.unit == self._unit
            and message.sequence in (sequence, None)
            and message.command in (name, None)
        )
