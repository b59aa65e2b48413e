"""Commands of a host: decoded, checked, executed, acknowledged, and returned as changes; what the device sends back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from lidar_emu.device.commands import OUT_OF_RANGE, DeviceCommand, DeviceTimeline, Value
from lidar_emu.device.state import DeviceState
from lidar_emu.errors import InputError
from lidar_emu.runtime.change_queue import (
    Change,
    CommandResult,
    NamedCommand,
    ReceivedCommand,
    ReceivedMessage,
)
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.port.packets import payload_of
from lidar_emu.runtime.summary import HostMessageTally, LatenessHistogram
from lidar_emu.transports.frames import unpack_frames
from lidar_protocol import (
    BadCommand,
    CanCommandReader,
    Command,
    CommandReader,
    Device,
    EncodeError,
    HostMessage,
    Interface,
)
from lidar_protocol.commands import FromHost, encode, encode_frame
from lidar_protocol.layout import Layout

_UNKNOWN = 255
_VERDICTS = ("accepted", "unknown", "malformed", "bad_sequence", "out_of_state", "out_of_range")
_BUFFER_BYTES = 4096
_BYTES_PER_S = 16_000
"""A thousand commands a second, which take a tenth of a processor."""


class RateLimiter:
    """A token bucket over received bytes: a host that floods the device must not keep it from its shots."""

    def __init__(self) -> None:
        self._room = float(_BUFFER_BYTES)
        self._last_ns: int | None = None
        self.refused_bytes = 0

    def take(self, size: int, arrived_ns: int) -> int:
        """Admit received bytes; return how many of them.

        Args:
            arrived_ns: when they arrived, an instant of the monotonic clock.
        """
        if self._last_ns is not None:
            drained = (arrived_ns - self._last_ns) * 1e-9 * _BYTES_PER_S
            self._room = min(_BUFFER_BYTES, self._room + max(0.0, drained))
        self._last_ns = arrived_ns
        taken = min(size, int(self._room))
        self._room -= taken
        self.refused_bytes += size - taken
        return taken


class CommandHandler:
    """Handles the commands of a host.

    Args:
        encoder: encodes acknowledgements; its interface has commands.
        can_encode_time: whether packets can hold a time to which the clock may be set, in nanoseconds since the epoch.
        send: sends an acknowledgement at once.
        observers: receive every command, with the first shot that follows it, and every acknowledgement.
        poll: called with the scenario time of a `no_op` that was accepted from the link, once it is acknowledged.

    Raises:
        InputError: the interface's acknowledgement has fields that cannot be filled.
    """

    def __init__(
        self,
        encoder: DownlinkEncoder,
        device: DeviceTimeline,
        can_encode_time: Callable[[int], bool],
        send: Callable[[bytes], None],
        observers: Sequence[Observer],
        poll: Callable[[int], None] | None = None,
    ) -> None:
        self._poll = poll
        self._encoder, self._interface = encoder, encoder.interface
        kind = CanCommandReader if encoder.can else CommandReader
        self._reader: CommandReader | CanCommandReader = kind(encoder.interface, encoder.unit)
        self._device, self._can_encode_time = device, can_encode_time
        self._send, self._observers = send, observers
        assert encoder.interface.commands is not None
        self._commands = encoder.interface.commands
        steps = self._commands.sequence_steps
        self._messages = {each.name: HostMessageTally(steps) for each in self._commands.messages}
        self._message_names = {each.code: each.name for each in self._commands.messages}
        self._sequence: int | None = None
        self._restarts = self._not_sent = 0
        self._verdicts: Counter[str] = Counter()
        self._delay = LatenessHistogram()
        self._limiter = RateLimiter()
        self._unanswerable = self._ignored_bytes = 0
        for verdict in _VERDICTS:  # an interface that cannot encode them is refused before the run
            try:
                self._encode(ReceivedCommand(0, None, {}, None, verdict), 0)
            except EncodeError as error:
                remedy = f"it cannot be sent: {error}"
                raise InputError("wire.interface", "acknowledge", verdict, remedy) from None

    def receive(
        self, data: bytes, arrived_ns: int, time_ns: int, pulse_ns: int | None = None
    ) -> list[Change]:
        """Execute and acknowledge the commands that these bytes complete (CAN: frame records).

        Args:
            arrived_ns: when they arrived, on the monotonic clock.
            time_ns: scenario time.
            pulse_ns: scenario time of the last synchronisation pulse before them; None: there was none.

        Returns:
            The changes to apply to upcoming shots.
        """
        time_ns, pulse_ns = self._in_order(time_ns, pulse_ns)
        before = self._device.at(time_ns)
        if not before.answers:
            self._ignored_bytes += len(data)
            return []
        changes: list[Change] = []
        for command in self._without_messages(data, arrived_ns, time_ns):
            if before.restarts != self._restarts:  # a restart begins a new sequence
                self._restarts, self._sequence = before.restarts, None
            if in_sequence := self._is_in_sequence(command):
                self._sequence = command.sequence
            received, after = self._execute(command, time_ns, pulse_ns, in_sequence)
            changes += self._conclude(received, after, arrived_ns)
            self._acknowledge(received)
            if self._poll is not None and (received.command, received.verdict) == ("no_op", "accepted"):
                self._poll(time_ns)
            before = self._device.at(time_ns)
            if not before.answers:  # it has restarted
                break
        return changes

    def execute(
        self, commands: Sequence[NamedCommand], arrived_ns: int, time_ns: int
    ) -> tuple[list[Change], list[CommandResult]]:
        """Execute commands that came beside the port, up to the first that is not accepted.

        They are checked, counted and observed as the host's own are, but have no sequence number, and their results are
        returned rather than sent: the host receives no acknowledgement that it did not ask for.

        Args:
            arrived_ns: when they arrived, on the monotonic clock.
            time_ns: scenario time.

        Returns:
            The changes to apply to upcoming shots, and the results.

        Raises:
            InputError: the interface cannot encode one of them; none was executed.
        """
        changes: list[Change] = []
        results: list[CommandResult] = []
        time_ns, tone_ns = self._in_order(time_ns, None)
        for command in [self._encoded(*each) for each in commands]:
            before = self._device.at(time_ns)
            if not before.answers:
                return changes, [*results, {"verdict": None, "time_s": None}]
            received, after = self._execute(command, time_ns, tone_ns, in_sequence=True)
            received = received._replace(sequence=None)
            changes += self._conclude(received, after, arrived_ns)
            self._not_sent += 1
            shown_ns = self._device.at(time_ns).clock.reads_ns(time_ns)
            results.append({"verdict": received.verdict, "time_s": shown_ns * 1e-9})
            if received.verdict != "accepted":
                break
        return changes, results

    def _in_order(self, time_ns: int, pulse_ns: int | None) -> tuple[int, int | None]:
        """Time and tone of commands. One that arrives before scenario time 0 may follow others that were received while
        the run waited for its start, and count from time 0: it counts from there too, but its tone is its arrival."""
        ordered_ns = self._device.in_order(time_ns)
        return ordered_ns, time_ns if pulse_ns is None and ordered_ns > time_ns else pulse_ns

    def _encoded(self, name: str, values: Mapping[str, Any]) -> Command | BadCommand:
        """A command as the device would decode it from the link."""
        interface, unit, numbered = self._interface, self._encoder.unit, {**values, "sequence": 0}
        try:
            if self._encoder.can:
                frame = encode_frame(interface, unit, name, numbered)
                (command,) = CanCommandReader(interface, unit).feed(frame.can_id, frame.data)
            else:
                (command,) = CommandReader(interface, unit).feed(encode(interface, unit, name, numbered))
            assert not isinstance(command, HostMessage)
            return command
        except EncodeError as error:
            raise InputError("command", None, name, str(error)) from None

    @property
    def counts(self) -> dict[str, int]:
        """The counts, by the names of the housekeeping fields."""
        accepted = self._verdicts["accepted"]
        return {
            "commands_accepted": accepted,
            "commands_rejected": self._verdicts.total() - accepted,
            "bad_bytes": self._reader.counters.skipped_bytes,
        }

    def to_json(self) -> dict[str, Any]:
        """The counts, by the keys of the summary file."""
        return {
            "accepted": self._verdicts["accepted"],
            "rejected": {word: n for word, n in sorted(self._verdicts.items()) if word != "accepted"},
            "unanswerable": self._unanswerable,
            "skipped_bytes": self._reader.counters.skipped_bytes,
            "ignored_bytes": self._ignored_bytes + self._limiter.refused_bytes,
            "delay": self._delay.summary(),
        }

    def messages_to_json(self) -> dict[str, Any] | None:
        """The counts of messages that are no commands, by the keys of the summary file; None: the interface has
        none."""
        if not self._messages:
            return None
        counters = self._reader.counters
        return {
            **{name: tally.to_json() for name, tally in self._messages.items()},
            "bad_crc": counters.bad_crc,
            "bad_frames": counters.bad_stuffing + counters.bad_length,
            "incomplete_frames": counters.incomplete,
        }

    def _without_messages(self, data: bytes, arrived_ns: int, time_ns: int) -> list[Command | BadCommand]:
        """The commands that these bytes complete; other messages are counted, and notified to observers."""
        commands: list[Command | BadCommand] = []
        for each in self._decode(data, arrived_ns):
            values: Mapping[str, int | float | None] = {}
            if isinstance(each, HostMessage):
                name, verdict, values = each.name, "accepted", each.values
            elif isinstance(each, BadCommand) and each.code in self._message_names:
                name, verdict = self._message_names[each.code], each.verdict
            else:
                commands.append(each)
                continue
            self._messages[name].add(each.sequence, verdict)
            device_ns = self._device.at(time_ns).clock.reads_ns(time_ns)
            received = ReceivedMessage(time_ns, arrived_ns, device_ns, name, each.sequence, verdict, values)
            for observer in self._observers:
                observer.on_host_message(received)
        return commands

    def _decode(self, data: bytes, arrived_ns: int) -> list[FromHost]:
        if isinstance(self._reader, CommandReader):
            return self._reader.feed(data[: self._limiter.take(len(data), arrived_ns)])
        commands: list[FromHost] = []
        for frame in unpack_frames(data):
            decoded = [] if frame.is_extended else self._reader.feed(frame.can_id, frame.data, frame.is_fd)
            # Frames of other nodes on the bus do not count against the limit.
            if decoded and self._limiter.take(len(frame.data), arrived_ns) == len(frame.data):
                commands += decoded
        return commands

    def _execute(
        self, command: Command | BadCommand, time_ns: int, pulse_ns: int | None, in_sequence: bool
    ) -> tuple[ReceivedCommand, DeviceState | None]:
        """The command with its verdict, and the state of the device after it; None if nothing changes."""
        if isinstance(command, BadCommand):
            is_numbered = command.sequence is not None
            verdict = "bad_sequence" if is_numbered and not in_sequence else command.verdict
            return ReceivedCommand(time_ns, command.code, {}, command.sequence, verdict, pulse_ns), None
        values = self._with_words(command)
        received = ReceivedCommand(time_ns, command.name, values, command.sequence, "bad_sequence", pulse_ns)
        if not in_sequence:
            return received, None
        tone_ns = values.get("tone_ns")
        if isinstance(tone_ns, int) and not self._can_encode_time(tone_ns):
            return received._replace(verdict=OUT_OF_RANGE), None
        tone_at_ns = time_ns if pulse_ns is None else pulse_ns
        state, verdict = self._device.execute(DeviceCommand(command.name, values, time_ns, tone_at_ns))
        return received._replace(verdict=verdict), state

    def _conclude(
        self, received: ReceivedCommand, after: DeviceState | None, arrived_ns: int
    ) -> list[Change]:
        """Count the command; notify observers of it, or let the change that it makes do so."""
        self._verdicts[received.verdict] += 1
        if after is None:
            self._notify(received, None)
            return []
        applied = partial(self._applied, received, arrived_ns)
        return [Change(lambda session: session.use_device(after), arrived_ns, applied)]

    def _applied(
        self, received: ReceivedCommand, arrived_ns: int, shot: int | None, begins_ns: int | None
    ) -> None:
        self._notify(received, shot)
        if begins_ns is not None:
            self._delay.add(max(0, begins_ns - arrived_ns))

    def _notify(self, received: ReceivedCommand, shot: int | None) -> None:
        for observer in self._observers:
            observer.on_command(received, shot)

    def _is_in_sequence(self, command: Command | BadCommand) -> bool:
        """Whether the command's sequence number follows the last one; a `no_op` may have any number but the last one,
        and restarts the count there."""
        if self._sequence is None:
            return command.sequence is not None
        if isinstance(command, Command) and command.name == "no_op":
            return command.sequence != self._sequence
        return command.sequence == (self._sequence + 1) % self._commands.sequence_steps

    def _with_words(self, command: Command) -> Mapping[str, Value]:
        values: dict[str, Value] = dict(command.values)
        for field, _ in self._commands.by_name[command.name].packet.placed:
            if field.enumeration and (value := command.values.get(field.name)) is not None:
                values[field.name] = self._interface.word(field.enumeration, int(value))
        return values

    def _acknowledge(self, received: ReceivedCommand) -> None:
        shown_ns = self._device.at(received.time_ns).clock.reads_ns(received.time_ns)
        try:
            payload = self._encode(received, shown_ns)
        except EncodeError:  # a time or a number that the interface's field does not hold
            self._unanswerable += 1
            return
        if payload is not None:
            self._send(payload)
            for observer in self._observers:
                observer.on_acknowledgement(payload, received.time_ns)

    def _encode(self, received: ReceivedCommand, shown_ns: int) -> bytes | None:
        command = _UNKNOWN if received.command is None else received.command
        values = {
            "sequence": received.sequence or 0,
            "verdict": received.verdict,
            "time_ns": shown_ns,
            "time_s": shown_ns * 1e-9,
        }
        return self._encoder.acknowledgement(self._verdicts.total() - self._not_sent - 1, command, values)


def housekeeping_layouts(interface: Interface, can: bool) -> list[Layout]:
    """Layouts of the housekeeping on a kind of link; empty if there is none."""
    if can:
        blocks = interface.can.housekeeping if interface.can else ()
        return [block.layout for block in blocks]
    return [] if interface.housekeeping is None else [interface.housekeeping]


class DownlinkEncoder:
    """Encodes the acknowledgements and the housekeeping of one unit for one kind of link."""

    def __init__(self, interface: Interface, unit: int, can: bool) -> None:
        self.interface, self.unit, self.can = interface, unit, can
        self._device = Device(interface, unit)

    @property
    def has_commands(self) -> bool:
        """Whether the interface has commands on this link."""
        commands = self.interface.commands
        return commands is not None and (not self.can or all(each.can for each in commands.commands))

    @property
    def has_housekeeping(self) -> bool:
        """Whether the interface has housekeeping on this link."""
        return bool(housekeeping_layouts(self.interface, self.can))

    def acknowledgement(self, number: int, command: int | str, values: Mapping[str, Any]) -> bytes | None:
        """The acknowledgement of a command; None if the interface has none.

        Args:
            number: number of acknowledgements before this one.
            command: name or code of the command.
            values: `sequence`, `verdict` and other fields.

        Raises:
            EncodeError: a value does not fit its field.
        """
        if self.can:
            can = self.interface.can
            if can is None or can.acknowledge is None:
                return None
            return payload_of([self._device.acknowledge_frame(command, **values)])
        if self.interface.acknowledge is None:
            return None
        return self._device.acknowledge(number, command, **values)

    def housekeeping(self, number: int, values: Mapping[str, Any]) -> bytes:
        """A housekeeping packet.

        Args:
            number: number of housekeeping packets before this one.
            values: values by the names of the fields.

        Raises:
            EncodeError: a value is missing or does not fit its field.
        """
        if self.can:
            return payload_of(self._device.housekeeping_frames(values))
        return self._device.housekeeping(number, values)
