"""What a host says to the device: read, checked, answered, and kept until the shots can follow it."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from typing import Any, NamedTuple

from lidar_emu.errors import InputError
from lidar_emu.runtime.lateness import LatenessHistogram
from lidar_emu.runtime.outbox import payload_of
from lidar_emu.session import Session
from lidar_emu.transports.frames import unpack_frames
from lidar_protocol import (
    BadCommand,
    CanCommandReader,
    Command,
    CommandReader,
    Device,
    EncodeError,
    Interface,
)

_UNKNOWN = 255
_VERDICTS = ("accepted", "unknown", "malformed", "bad_sequence", "out_of_state", "out_of_range")


class Change(NamedTuple):
    """Something that shots are to follow."""

    apply: Callable[[Session], None]
    """Lets the session's next shot be the first to follow it."""
    arrived_ns: int
    """When the command came, on the monotonic clock."""


def has_commands_on_can(interface: Interface) -> bool:
    """Whether a host can command the device on a CAN bus."""
    return interface.commands is not None and all(c.can is not None for c in interface.commands.commands)


class CommandPost:
    """The device's ears and mouth on a link.

    Args:
        interface: that has commands.
        unit: of this device.
        can: whether the link is a CAN bus.
        has_pattern: whether the scanner has a pattern of this number.
        say: sends an answer at once.

    Raises:
        InputError: the interface's acknowledgement cannot be filled.
    """

    def __init__(
        self,
        interface: Interface,
        unit: int,
        can: bool,
        has_pattern: Callable[[int], bool],
        say: Callable[[bytes], None],
    ) -> None:
        self._interface, self._device = interface, Device(interface, unit)
        self._bytes = None if can else CommandReader(interface, unit)
        self._frames = CanCommandReader(interface, unit) if can else None
        self._has_pattern = has_pattern
        self._say = say
        assert interface.commands is not None
        self._steps = interface.commands.sequence_steps
        self._sequence: int | None = None
        self._verdicts: Counter[str] = Counter()
        self._changes: deque[Change] = deque()
        self._delay = LatenessHistogram()
        self._unanswerable = 0
        for verdict in _VERDICTS:  # an interface that cannot say them is refused before the run
            self._check_answer(verdict)

    def hear(self, data: bytes, arrived_ns: int, time_ns: int) -> None:
        """Obey and answer the commands that are complete with these bytes (CAN: frame records).

        Args:
            arrived_ns: when they came, on the monotonic clock.
            time_ns: scenario time.
        """
        for command in self._read(data):
            verdict = self._obey(command, arrived_ns)
            self._verdicts[verdict] += 1
            code = command.code if isinstance(command, BadCommand) else command.name
            try:
                answers = self._answer(
                    _UNKNOWN if code is None else code, command.sequence or 0, verdict, time_ns
                )
            except EncodeError:  # a time or a number that the interface's field does not hold
                self._unanswerable += 1
                continue
            for answer in answers:
                self._say(answer)

    def next_change(self) -> Change | None:
        """The oldest change that has not been taken."""
        return self._changes.popleft() if self._changes else None

    def followed(self, change: Change, begins_ns: int) -> None:
        """The first shot that follows a change begins at this instant of the monotonic clock."""
        self._delay.add(max(0, begins_ns - change.arrived_ns))

    def to_json(self) -> dict[str, Any]:
        """The counts under the names of the summary file."""
        reader = self._bytes or self._frames
        assert reader is not None
        return {
            "accepted": self._verdicts["accepted"],
            "rejected": {word: n for word, n in sorted(self._verdicts.items()) if word != "accepted"},
            "unanswerable": self._unanswerable,
            "skipped_bytes": reader.counters.skipped_bytes,
            "delay": self._delay.summary(),
        }

    def _read(self, data: bytes) -> list[Command | BadCommand]:
        if self._bytes is not None:
            return self._bytes.feed(data)
        assert self._frames is not None
        frames = (frame for frame in unpack_frames(data) if not frame.is_extended)
        return [command for f in frames for command in self._frames.feed(f.can_id, f.data, f.is_fd)]

    def _obey(self, command: Command | BadCommand, arrived_ns: int) -> str:
        if isinstance(command, BadCommand):
            return command.verdict
        if self._sequence is not None and command.sequence != (self._sequence + 1) % self._steps:
            return "bad_sequence"
        self._sequence = command.sequence
        if command.name == "no_op":
            return "accepted"
        if command.name != "set_pattern" or "pattern" not in command.values:
            return "out_of_state"
        pattern = int(command.values["pattern"] or 0)
        if pattern < 0 or not self._has_pattern(pattern):
            return "out_of_range"
        self._changes.append(Change(lambda session: session.use_pattern(pattern), arrived_ns))
        return "accepted"

    def _answer(self, command: int | str, sequence: int, verdict: str, time_ns: int) -> list[bytes]:
        """The acknowledgement, where the interface has one."""
        values: dict[str, Any] = {
            "sequence": sequence, "verdict": verdict, "time_ns": max(0, time_ns), "time_s": max(0, time_ns) * 1e-9
        }  # fmt: skip
        if self._bytes is not None:
            if self._interface.acknowledge is None:
                return []
            return [self._device.acknowledge(self._verdicts.total() - 1, command, **values)]
        if self._interface.can is None or self._interface.can.acknowledge is None:
            return []
        return [payload_of([self._device.acknowledge_frame(command, **values)])]

    def _check_answer(self, verdict: str) -> None:
        try:
            self._answer(_UNKNOWN, 0, verdict, 0)
        except EncodeError as error:
            raise InputError(
                "wire.interface", "acknowledge", verdict, f"it cannot be sent: {error}"
            ) from None
