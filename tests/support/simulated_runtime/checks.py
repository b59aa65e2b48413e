"""The invariants of a run that has ended: summary, line, device, host, answers and recording agree with the ledger."""

from __future__ import annotations

from collections import Counter, deque
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

from lidar_emu.recording import channels
from lidar_emu.recording.read import Recording
from lidar_emu.recording.recompute import recompute
from lidar_emu.runtime.change_queue import ReceivedCommand
from lidar_emu.runtime.port.packets import DeliveryStatus
from lidar_emu.scenario.schema import Scenario
from lidar_emu.shots.model import Model
from lidar_emu.transports.frames import unpack_frames
from lidar_protocol import Acknowledge, Message, SerialReceiver, cobs, default_interface
from simulated_runtime.can_bus import SimulatedBus
from simulated_runtime.expected_modes import ExpectedDevice, events_of_faults
from simulated_runtime.host import SimulatedHost
from simulated_runtime.ledger import Ledger, match_wire, require
from simulated_runtime.line import Connection, SimulatedLine
from simulated_runtime.plan import CLOCK_ERROR_S, Plan
from simulated_runtime.truth import SimulatedSimulator

_FIRST_RETRY_NS = 100_000_000
_SLACK_NS = 50_000_000
"""For a process that loses its processor several times."""

_COMMAND_BYTES = 256
"""More than a command has, and than may be left of one that is not whole."""


@dataclass
class Checks:
    """The checks of a run."""

    plan: Plan
    scenario: Scenario
    model: Model
    ledger: Ledger
    line: SimulatedLine | SimulatedBus
    host: SimulatedHost
    simulator: SimulatedSimulator | None
    port_died: bool
    errors: str
    """What the port process has said once nobody else could."""
    start_ns: int | None
    """Scenario time 0."""
    model_stalled_ns: int
    """Until when the model process was stalled."""

    def check(self, summary: dict[str, Any]) -> None:
        """All but the recording, of a run that has a summary."""
        ledger = self.ledger
        ledger.check_summary(summary["shots"])
        shots = [shot for shot, *_ in ledger.shots]
        is_whole = summary["error"] is None and not summary["interrupted"]
        if is_whole and self.simulator is None:
            require(
                shots == [*range(self.model.shot_count)],
                "shots are missing:",
                ledger.last,
                self.model.shot_count,
            )
        computed = [shot for shot in shots if shot not in ledger.missed]
        require(ledger.blocks == computed, "measurements of each reported shot, once")
        if self.plan.pace == "wall":
            self._check_sent(summary)
        else:
            full = ledger.statuses[DeliveryStatus.DROPPED_FULL]
            require(not full, "dropped although the line makes progress:", full)
        if self.plan.pace == "lockstep":
            self._check_answers(is_whole)
        self._check_commands(summary["commands"])
        self._check_periods()
        self.check_line()
        if not self.port_died:
            self._check_counts(summary["wire"])
            breaks = sum(each.lost for each in self.line.connections[:-1])
            require(summary["link_event_count"] >= 2 * breaks, "events:", summary["link_event_count"], breaks)
            if isinstance(self.line, SimulatedLine) and self.start_ns is not None:
                self._check_slow_line(self.start_ns)
                self._check_input(self.line, self.start_ns, summary)
        if shots and not self._injects("reordered"):
            numbers = self._check_device()
            if isinstance(self.line, SimulatedBus):
                self._check_frames(self.line)
            elif not (self.port_died or self._injects("slow_line")):
                self._check_host(self.line, numbers)

    def _check_periods(self) -> None:
        """Housekeeping comes once a period, if neither a command nor a restart changes that."""
        changes = any(command.command in ("set_parameter", "reset") for command, _ in self.ledger.commands)
        faults = any("brown_out" in str(fault) for fault in self.ledger.faults)
        if changes or faults or self.plan.start == "on-command":
            return
        rate_hz = self.scenario.device.housekeeping_rate_hz
        periods = [int(time_ns * rate_hz / 1e9) for time_ns, _, _ in self.ledger.housekeeping]
        require(periods == sorted(set(periods)), "housekeeping more than once a period:", periods)

    def _check_sent(self, summary: dict[str, Any]) -> None:
        statuses, commands = self.ledger.statuses, self.ledger.commands
        sent, timed = statuses[DeliveryStatus.SENT], summary["lateness"]["count"]
        if not self.scenario.wire.polled:
            require(timed == sent, "lateness of what was sent:", summary["lateness"], sent)
            require(not statuses[DeliveryStatus.NOT_POLLED], "nobody polls:", statuses)
            return
        polls = sum((each.command, each.verdict) == ("no_op", "accepted") for each, _ in commands)
        require(sent <= polls, "more was sent than polled:", sent, polls)
        require(timed == 0, "what waits for a poll is not late:", summary["lateness"])

    def check_line(self) -> None:
        """What the line took was reported as sent; of a process that died the report may be missing."""
        ledger, taken = self.ledger, [payload for each in self.line.connections for payload in each.taken]
        rest = match_wire(taken, ledger.sent, ledger.between, not self._injects("slow_line"))
        if not self.port_died:
            require(not rest, "on the line, but not reported:", len(rest), rest[:1])
        safe = [
            place
            for place, payload in enumerate(taken)
            if payload in rest and any(self.host.mode(each) == "safe" for each in self.host.decode(payload))
        ]
        made = any(self.host.mode(each) == "safe" for _, each in self._housekeeping())
        require(
            made or not safe or safe[0] == len(taken) - 1,
            "a packet after the final message:",
            safe,
            len(taken),
        )
        if "the run has ended" in self.errors:
            prepares = self.scenario.timing.when_process_dies == "safe" and bool(ledger.shots)
            require(not prepares or "final message" in self.errors, "no final message:", self.errors)
            require("message sent" not in self.errors or made or bool(safe), "not on the line:", self.errors)
        if not self.port_died:
            for before, after in pairwise(self.line.connections):
                self._check_reopening(before, after)

    def _check_reopening(self, before: Connection, after: Connection) -> None:
        """A link on which packets were sent is tried again after .1, .3, .7 s and so on: `docs/links.md`."""
        stalls_ns = sum(h.values[0] for h in self.plan.happenings if h.kind == "stall port")
        absent_ns = max(0, after.plugged_ns - before.closed_ns)
        latest_ns = before.closed_ns + 2 * absent_ns + _FIRST_RETRY_NS + stalls_ns + _SLACK_NS
        require(
            not before.taken or self._injects("disconnect") or after.opened_ns <= latest_ns,
            "reopened late:",
            absent_ns,
            after.opened_ns - before.closed_ns,
        )

    def _check_slow_line(self, start_ns: int) -> None:
        """While a fault slows the line, bytes come no faster than its rate, but for what it held before."""
        slow = [fault for fault in self.ledger.faults if fault.kind == "slow_line"]
        for fault in slow if len(slow) == 1 else []:  # a second one finds what the first has kept
            begins_ns, ends_ns = (start_ns + round(at_s * 1e9) for at_s in (fault.from_s, fault.to_s))
            times = [
                (at_ns, 10 * len(payload))
                for each in self.line.connections
                for at_ns, payload in zip(each.taken_ns, each.taken, strict=True)
                if begins_ns < at_ns < ends_ns
            ]
            # The first may have been sent before the fault, and what the line takes late comes at once.
            bits = sum(size for _, size in times[1:])
            taken_ns = times[-1][0] - begins_ns + _SLACK_NS if times else 0
            require(bits * 1e9 <= fault.bit_rate * taken_ns + 1e9, "faster than the line:", bits, taken_ns)

    def check_recording(
        self, recording: Recording, error: str | None, is_full: bool, is_killed: bool
    ) -> None:
        """The recording holds each report up to its end; and flies again, packet by packet."""
        require((error is not None) == is_full, "an error of the recording:", error)
        packets, reports = recording.packets(), self.ledger.reports
        recorded = [*zip(packets.shot.tolist(), packets.status.tolist(), packets.payload, strict=True)]
        if is_full or is_killed:
            reports = reports[: len(recorded)]
        else:
            require(
                recording.is_whole and not recording.damage,
                "the recording lacks something:",
                recording.damage,
            )
            between = [
                message.payload
                for channel in (channels.ACKNOWLEDGEMENT, channels.HOUSEKEEPING)
                for message in recording.raw_messages(channel)
            ]
            require(Counter(between) == Counter(self.ledger.between), "recorded between the shots")
        require(recorded == reports, "recorded and reported:", len(recorded), len(reports))
        if recorded and self.plan.is_recomputed:
            result = recompute(recording)
            require(result.different == 0, "recomputed:", result)

    def _injects(self, kind: str) -> bool:
        return any(h.kind == "inject" and kind in h.values[0] for h in self.plan.happenings)

    def _housekeeping(self) -> list[tuple[int, Any]]:
        return [
            (time_ns, each)
            for time_ns, payload, _ in self.ledger.housekeeping
            for each in self.host.decode(payload)
        ]

    def _check_answers(self, is_whole: bool) -> None:
        assert self.simulator is not None
        reports = self.ledger.reports
        answered = [(packet.shot, packet.status, packet.payload) for packet in self.simulator.answered]
        require(answered == reports[: len(answered)], "answered and reported:", len(answered), len(reports))
        require(
            not is_whole or len(answered) == len(reports),
            "reports without an answer:",
            len(answered),
            len(reports),
        )

    def _check_commands(self, commands: dict[str, Any]) -> None:
        verdicts = self.ledger.verdicts
        rejected = {word: count for word, count in sorted(verdicts.items()) if word != "accepted"}
        counted = commands["accepted"], commands["rejected"]
        require(counted == (verdicts["accepted"], rejected), "commands:", commands, verdicts)
        if isinstance(self.line, SimulatedLine):
            heads = (cobs.decode(payload.strip(b"\0"))[2:4] for _, payload in self.ledger.acknowledged)
            counts = [int.from_bytes(head, "big") & 0x3FFF for head in heads]
            require(counts == [*range(len(counts))], "counts of acknowledgements:", counts)
        beside = any(each.sequence is None for each, _ in self.ledger.commands)
        if not (beside or self._injects("brown_out") or self.plan.start == "on-command"):
            self._check_acknowledgements()

    def _check_acknowledgements(self) -> None:
        """Numbers in turn, as INTERFACE.md has them; a device that restarts is deaf."""
        last: int | None = None
        deaf_until_ns, device = -(1 << 62), self.scenario.device
        for time_ns, payload in self.ledger.acknowledged:
            (answer,) = self.host.decode(payload)
            assert isinstance(answer, Acknowledge)
            require(time_ns >= deaf_until_ns, "an answer from a device that restarts:", time_ns, answer)
            number, follows = answer.sequence, last is None or answer.sequence == (last + 1) % 256
            in_turn = follows or (answer.command == "no_op" and number != last)
            require((answer.verdict == "bad_sequence") is not in_turn, "numbers in turn:", last, answer)
            last = number if in_turn else last
            if (answer.command, answer.verdict) == ("reset", "accepted"):
                last = None
                deaf_until_ns = time_ns + round(min(device.boot_s, device.warm_restart_s) * 1e9)

    def _check_counts(self, wire: dict[str, Any]) -> None:
        ledger, line = self.ledger, self.line
        sent_bytes = sum(map(len, (*ledger.sent, *ledger.between)))
        require(wire["sent_bytes"] == sent_bytes, "sent_bytes:", wire["sent_bytes"], sent_bytes)
        require(wire["tx_dropped"] == ledger.between_dropped, "tx_dropped:", wire, ledger.between_dropped)
        require(not ledger.made, "no result of acknowledgements or housekeeping:", len(ledger.made))
        if not isinstance(line, SimulatedLine):
            return
        received, read = wire["received_bytes"], line.received_bytes
        # What arrives while an injected fault holds the port broken is lost.
        require(
            received == read or (self._injects("disconnect") and received < read), "received:", received, read
        )
        last = line.connections[-1]
        if not (last.lost or self._injects("slow_line")):
            undelivered = sum(map(len, last.taken)) - len(last.delivered) - last.discarded
            require(undelivered <= wire["unread_bytes"], "unread_bytes:", wire["unread_bytes"], undelivered)

    def _check_input(self, line: SimulatedLine, start_ns: int, summary: dict[str, Any]) -> None:
        """What arrived well before the end was handled, or is counted as lost or ignored."""
        calm_ns = max(line.read_ns, self.model_stalled_ns) + 2 * _SLACK_NS
        ends_ns = start_ns + self.ledger.times[-1][2] if self.ledger.times else 0
        if self.plan.pace != "wall" or calm_ns > ends_ns:
            return
        wire, commands = summary["wire"], summary["commands"]
        refused = wire["rx_overrun_bytes"] + commands["skipped_bytes"] + commands["ignored_bytes"]
        most = refused + _COMMAND_BYTES * (len(self.ledger.commands) + 1)
        require(wire["received_bytes"] <= most, "bytes that nobody counts:", wire, commands, most)

    def _check_device(self) -> list[int]:
        """Modes and numbers in the packets are those of another, plain model of the device; the numbers."""
        ledger, period_ns, numbers = self.ledger, self.model.period_ns, list[int]()
        accepted = [each for each in ledger.commands if each[0].verdict == "accepted"]
        # A command counts from its time, even where the shots after it had gone out already.
        commanded, number = self._expected_device(), 0
        device, left = deepcopy(commanded), deque(each for each in accepted if each[1] is not None)
        # Beams do not fire while the scanner settles or truth is stale; sets of frames without the flag state none.
        settles = any(command.values.get("parameter") == 1 for command, _ in accepted)
        fires_all = self.simulator is None and self.plan.link != "can" and not settles
        for skipped in range(ledger.shots[0][0]):  # before the first truth
            device.advance(skipped * period_ns)
            number += device.measures and skipped % device.divisor == 0
        for shot, silent, _, payload in ledger.shots:
            restarts = device.restarts
            while left and (left[0][1] or 0) <= shot:
                _apply(commanded, left.popleft()[0])
                device = deepcopy(commanded)
            device.advance(shot * period_ns)
            number = 0 if device.restarts != restarts else number
            expects = device.measures and shot % device.divisor == 0
            require(expects != silent, "silent or not, but the device is", device.mode, device.divisor, shot)
            if payload:
                message = self.host.decode(payload)[-1]
                assert isinstance(message, Message)
                self._check_message(message, shot, device, number, fires_all)
            numbers.append(number)
            number += not silent
        # Polled, it is sent while commands are received, of which the shots know later.
        for time_ns, payload, count in [] if self.scenario.wire.polled else ledger.housekeeping:
            (mode,) = {mode for block in self.host.decode(payload) if (mode := self.host.mode(block))}
            possible = {self._mode_at(time_ns, accepted[:n]) for n in range(count, len(accepted) + 1)}
            require(mode in possible, "housekeeping of another mode:", time_ns, mode, possible)
        return numbers

    def _check_message(
        self, message: Message, shot: int, device: ExpectedDevice, number: int, fires_all: bool
    ) -> None:
        expected = device.mode, number
        shown = self.host.mode(message) or device.mode, number if message.shot is None else message.shot
        require(shown == expected, "mode and number of shot:", shot, shown, expected)
        if message.time_ns is not None and self._clock_is_known():
            at_s = shot * self.model.period_ns * 1e-9
            ahead_s = message.time_ns * 1e-9 - at_s
            wrong = sum(fault.from_s + 0.1 < at_s < fault.to_s - 0.1 for fault in self._clock_errors())
            require(ahead_s > wrong * CLOCK_ERROR_S / 2, "clock without its error:", shot, ahead_s, wrong)
        fired = sum(1 << k for k, beam in enumerate(message.beams) if beam.get("fired"))
        may_fire = device.beams if fires_all else fired & device.beams
        require(fired == may_fire, "beams of shot:", shot, fired, device.beams)

    def _clock_errors(self) -> list[Any]:
        return [fault for fault in self.ledger.faults if fault.kind == "clock_error"]

    def _clock_is_known(self) -> bool:
        tones = any(command.command == "time_at_tone" for command, _ in self.ledger.commands)
        return bool(self._clock_errors()) and not tones

    def _expected_device(self) -> ExpectedDevice:
        timing, events = self.scenario.timing, events_of_faults(self.ledger.faults)
        return ExpectedDevice(self.scenario.device, timing.rate_hz, self.ledger.waited_ns, events)

    def _order(self, command: tuple[ReceivedCommand, int | None]) -> tuple[int, int]:
        """Time of a command, and its place among those of the port; beside the port it comes after them."""
        known = command[0].time_ns, command[0].sequence
        return known[0], self._acknowledged_as.get(known, len(self._acknowledged_as))

    @cached_property
    def _acknowledged_as(self) -> dict[tuple[int, int | None], int]:
        answers = [(time_ns, self.host.decode(payload)[0]) for time_ns, payload in self.ledger.acknowledged]
        return {
            (time_ns, answer.sequence): k
            for k, (time_ns, answer) in enumerate(answers)
            if isinstance(answer, Acknowledge)
        }

    def _mode_at(self, time_ns: int, commands: list[tuple[ReceivedCommand, int | None]]) -> str:
        device = self._expected_device()
        # Commands that change nothing are observed at once, others with their first shot: not as they came.
        for command, _ in sorted(commands, key=self._order):
            if command.time_ns <= time_ns:
                _apply(device, command)
        device.advance(time_ns)
        return device.mode

    def _check_frames(self, bus: SimulatedBus) -> None:
        """What the host has received: the frames of whole sets, in order."""
        frames = (
            frame for each in bus.connections for payload in each.taken for frame in unpack_frames(payload)
        )
        require(
            all(frame in frames for frame in bus.frames), "received by the host, but not sent in this order"
        )

    def _check_host(self, line: SimulatedLine, numbers: list[int]) -> None:
        """What the host has decoded: whole packets, in order, all that have reached it."""
        receiver, decoded = SerialReceiver(default_interface()), list[int | None]()
        for connection in line.connections:
            received = receiver.receive(bytes(connection.delivered) + b"\0")
            decoded += [each.shot for each in received if isinstance(each, Message)]
        shots = zip(self.ledger.shots, numbers, strict=True)
        expected = [number for (_, _, sent, _), number in shots if sent]
        rest = iter(expected)
        require(all(each in rest for each in decoded), "decoded by the host, but not sent in this order")
        if not any(each.lost or each.discarded or each.cut for each in line.connections):
            counters = receiver.counters
            bad = counters.bad_crc + counters.bad_stuffing + counters.bad_length + counters.skipped_bytes
            require(
                decoded == expected and bad == 0,
                "sent, but not decoded:",
                len(expected),
                len(decoded),
                counters,
            )


def _apply(device: ExpectedDevice, command: ReceivedCommand) -> None:
    device.advance(command.time_ns)
    device.command(str(command.command), command.values)
