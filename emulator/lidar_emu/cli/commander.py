"""Whoever commands a device from the host's end: a command out, its acknowledgement in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from lidar_emu.cli.far_end import Decoder, told_at_s
from lidar_emu.runtime.clock import Clock
from lidar_emu.transports.frames import Frame, pack_frames
from lidar_emu.transports.host import ByteHost, CanHost
from lidar_protocol import Acknowledge, Host, Interface
from lidar_protocol.commands import Argument

_READ_S = 0.05
UNANSWERED = "no answer"
SENT = "sent"


class Reply(NamedTuple):
    """What became of a command."""

    verdict: str
    """The device's, or `UNANSWERED`; `SENT` where the interface has no acknowledgements."""
    time_s: float | None = None
    """When it was answered, by the device's clock."""


class Commander:
    """Commands one unit over an open link.

    Args:
        host: the link.
        interface: by which it is spoken.
        unit: that is commanded.
        timeout_s: how long an answer may take.
    """

    def __init__(self, host: ByteHost | CanHost, interface: Interface, unit: int, timeout_s: float) -> None:
        self._host, self._unit, self._timeout_s = host, unit, timeout_s
        self._voice = Host(interface, unit)
        self._decoder = Decoder(interface)
        self._is_can = isinstance(host, CanHost)
        self._clock = Clock()
        can_acknowledge = interface.can.acknowledge if interface.can else None
        self._is_answered = bool(can_acknowledge if self._is_can else interface.acknowledge)
        assert interface.commands is not None
        self._steps = interface.commands.sequence_steps
        self._can_begin_anew = "no_op" in interface.commands.by_name
        self._next = 0

    def begin_at(self, sequence: int) -> None:
        """Number the next command so."""
        self._next = sequence

    def begin_anew(self) -> Reply | None:
        """Agree with the device on the next number; None where the interface has nothing to do so with.

        A `no_op` may have any number but that of the device's last command: whether it is accepted or is that very
        one, the number after it is the next.
        """
        if not self._can_begin_anew:
            return None
        self._next = 0
        return self.ask("no_op", {})

    def ask(self, name: str, values: Mapping[str, Argument]) -> Reply:
        """Send a command and wait for its answer.

        Raises:
            EncodeError: there is no such command, or an argument is missing, unknown or cannot be sent.
        """
        sequence, self._next = self._next, (self._next + 1) % self._steps
        payload = self._encoded(name, {**values, "sequence": sequence})
        ends_ns = self._clock.now_ns() + round(self._timeout_s * 1e9)
        is_out = self._host.write(payload)
        while self._clock.now_ns() < ends_ns:
            if is_out and not self._is_answered:
                return Reply(SENT)
            for message in self._decoder.receive(self._host.read(_READ_S)):
                if isinstance(message, Acknowledge) and self._is_for(message, name, sequence):
                    return Reply(message.verdict, told_at_s(message))
            is_out = is_out or self._host.write(payload)
        return Reply(UNANSWERED)

    def _encoded(self, name: str, values: Mapping[str, Argument]) -> bytes:
        if not self._is_can:
            return self._voice.encode_command(name, **values)
        frame = self._voice.encode_command_frame(name, **values)
        return pack_frames([Frame(frame.can_id, frame.data)])

    def _is_for(self, message: Acknowledge, name: str, sequence: int) -> bool:
        """Some interfaces do not say to which command they answer."""
        return (
            message.unit == self._unit
            and message.sequence in (sequence, None)
            and message.command in (name, None)
        )
