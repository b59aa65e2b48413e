"""What a host says to the device: read, checked, answered, and kept until the shots can follow it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from lidar_emu.device.commands import OUT_OF_RANGE, Order, Value
from lidar_emu.device.state import DeviceState
from lidar_emu.device.timeline import DeviceTimeline
from lidar_emu.errors import InputError
from lidar_emu.runtime.change_queue import Change, Changes
from lidar_emu.runtime.device_link.encoder import DownlinkEncoder
from lidar_emu.runtime.device_link.rate_limiter import RateLimiter
from lidar_emu.runtime.device_link.received_command import ReceivedCommand
from lidar_emu.runtime.lateness import LatenessHistogram
from lidar_emu.transports.frames import unpack_frames
from lidar_protocol import (
    BadCommand,
    CanCommandReader,
    Command,
    CommandReader,
    EncodeError,
)

_UNKNOWN = 255
_VERDICTS = ("accepted", "unknown", "malformed", "bad_sequence", "out_of_state", "out_of_range")


class CommandHandler:
    """The device's ears and mouth on a link.

    Args:
        voice: by which it answers, and the interface of which has commands.
        device: that is commanded.
        can_date: whether packets can tell a time that the clock may be set to, in nanoseconds since the epoch.
        changes: where shots find what they are to follow.
        tell: told of every command, with the number of the first shot that follows it, if one does.
        answered: told of every answer, and of the scenario time of the command.

    Raises:
        InputError: the interface's acknowledgement cannot be filled.
    """

    def __init__(
        self,
        voice: DownlinkEncoder,
        device: DeviceTimeline,
        can_date: Callable[[int], bool],
        changes: Changes,
        tell: Callable[[ReceivedCommand, int | None], None],
        answered: Callable[[bytes, int], None],
    ) -> None:
        self._voice, self._interface = voice, voice.interface
        self._bytes = None if voice.can else CommandReader(voice.interface, voice.unit)
        self._frames = CanCommandReader(voice.interface, voice.unit) if voice.can else None
        self._device, self._can_date = device, can_date
        self._changes, self._tell, self._answered = changes, tell, answered
        assert voice.interface.commands is not None
        self._commands = voice.interface.commands
        self._sequence: int | None = None
        self._life = 0
        self._verdicts: Counter[str] = Counter()
        self._delay = LatenessHistogram()
        self._intake = RateLimiter()
        self._unanswerable = self._ignored_bytes = 0
        for verdict in _VERDICTS:  # an interface that cannot say them is refused before the run
            self._check_answer(verdict)

    def hear(self, data: bytes, arrived_ns: int, time_ns: int, pulse_ns: int | None = None) -> None:
        """Obey and answer the commands that are complete with these bytes (CAN: frame records).

        Args:
            arrived_ns: when they came, on the monotonic clock.
            time_ns: scenario time.
            pulse_ns: scenario time of the last synchronisation pulse before them; None: there was none.
        """
        before = self._device.at(time_ns)
        if not before.answers:
            self._ignored_bytes += len(data)
            return
        for command in self._read(data, arrived_ns):
            if before.restarts != self._life:  # a device that has restarted knows of no command before
                self._life, self._sequence = before.restarts, None
            heard, after = self._obey(command, time_ns, pulse_ns)
            if after is not None:
                self._changes.add(self._change(after, heard, arrived_ns))
            else:
                self._tell(heard, None)
            self._verdicts[heard.verdict] += 1
            self._reply(heard)
            before = self._device.at(time_ns)
            if not before.answers:  # it has restarted
                break

    @property
    def counts(self) -> dict[str, int]:
        """Under the names of housekeeping."""
        accepted = self._verdicts["accepted"]
        return {
            "commands_accepted": accepted,
            "commands_rejected": self._verdicts.total() - accepted,
            "bad_bytes": self._reader.counters.skipped_bytes,
        }

    def to_json(self) -> dict[str, Any]:
        """The counts under the names of the summary file."""
        return {
            "accepted": self._verdicts["accepted"],
            "rejected": {word: n for word, n in sorted(self._verdicts.items()) if word != "accepted"},
            "unanswerable": self._unanswerable,
            "skipped_bytes": self._reader.counters.skipped_bytes,
            "ignored_bytes": self._ignored_bytes + self._intake.refused_bytes,
            "delay": self._delay.summary(),
        }

    @property
    def _reader(self) -> CommandReader | CanCommandReader:
        reader = self._bytes or self._frames
        assert reader is not None
        return reader

    def _read(self, data: bytes, arrived_ns: int) -> list[Command | BadCommand]:
        if self._bytes is not None:
            return self._bytes.feed(data[: self._intake.take(len(data), arrived_ns)])
        assert self._frames is not None
        commands = []
        for frame in unpack_frames(data):
            heard = [] if frame.is_extended else self._frames.feed(frame.can_id, frame.data, frame.is_fd)
            # What others say to each other on the bus takes no room.
            if heard and self._intake.take(len(frame.data), arrived_ns) == len(frame.data):
                commands += heard
        return commands

    def _obey(
        self, command: Command | BadCommand, time_ns: int, pulse_ns: int | None
    ) -> tuple[ReceivedCommand, DeviceState | None]:
        """The command as it was heard, and the state that it leads to; None where it changes nothing."""
        in_turn = self._in_turn(command)
        if in_turn:
            self._sequence = command.sequence
        if isinstance(command, BadCommand):
            return ReceivedCommand(
                time_ns, command.code, {}, command.sequence, command.verdict, pulse_ns
            ), None
        values = self._words(command)
        heard = ReceivedCommand(time_ns, command.name, values, command.sequence, "bad_sequence", pulse_ns)
        if not in_turn:
            return heard, None
        tone_ns = values.get("tone_ns")
        if isinstance(tone_ns, int) and not self._can_date(tone_ns):
            return heard._replace(verdict=OUT_OF_RANGE), None
        order = Order(command.name, values, time_ns, time_ns if pulse_ns is None else pulse_ns)
        state, verdict = self._device.obey(order)
        return heard._replace(verdict=verdict), state

    def _change(self, after: DeviceState, heard: ReceivedCommand, arrived_ns: int) -> Change:
        return Change(
            lambda session: session.use_device(after), arrived_ns, partial(self._settled, heard, arrived_ns)
        )

    def _settled(
        self, heard: ReceivedCommand, arrived_ns: int, shot: int | None, begins_ns: int | None
    ) -> None:
        self._tell(heard, shot)
        if begins_ns is not None:
            self._delay.add(max(0, begins_ns - arrived_ns))

    def _in_turn(self, command: Command | BadCommand) -> bool:
        """Whether it has the number after the last; `no_op` may have any but the last: the count goes on from it."""
        if self._sequence is None:
            return command.sequence is not None
        if isinstance(command, Command) and command.name == "no_op":
            return command.sequence != self._sequence
        return command.sequence == (self._sequence + 1) % self._commands.sequence_steps

    def _words(self, command: Command) -> Mapping[str, Value]:
        """The arguments, with the words of enumerations."""
        words = {
            placed.field.name: placed.field.enumeration
            for placed in (self._commands.by_name[command.name].packet.placed)
        }
        return {
            name: value
            if value is None or not (enumeration := words.get(name))
            else self._interface.word(enumeration, int(value))
            for name, value in command.values.items()
        }

    def _reply(self, heard: ReceivedCommand) -> None:
        shown_ns = self._device.at(heard.time_ns).clock.reads_ns(heard.time_ns)
        try:
            answer = self._answer(heard, shown_ns)
        except EncodeError:  # a time or a number that the interface's field does not hold
            self._unanswerable += 1
            return
        if answer is not None:
            self._voice.say(answer)
            self._answered(answer, heard.time_ns)

    def _answer(self, heard: ReceivedCommand, shown_ns: int) -> bytes | None:
        command = _UNKNOWN if heard.command is None else heard.command
        values = {
            "sequence": heard.sequence or 0,
            "verdict": heard.verdict,
            "time_ns": shown_ns,
            "time_s": shown_ns * 1e-9,
        }
        return self._voice.acknowledgement(self._verdicts.total() - 1, command, values)

    def _check_answer(self, verdict: str) -> None:
        try:
            self._answer(ReceivedCommand(0, None, {}, None, verdict), 0)
        except EncodeError as error:
            raise InputError(
                "wire.interface", "acknowledge", verdict, f"it cannot be sent: {error}"
            ) from None
