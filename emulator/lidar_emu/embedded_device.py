"""The device without clock or port, for a simulator of one's own: bytes in, packets due out."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, SupportsIndex

from lidar_emu.errors import Finding, InputError
from lidar_emu.measurement import Measurement
from lidar_emu.runtime.change_queue import Change
from lidar_emu.runtime.command_handler import CommandHandler
from lidar_emu.runtime.housekeeping import HousekeepingSender
from lidar_emu.runtime.options import RunOptions
from lidar_emu.runtime.port.packets import Pace
from lidar_emu.runtime.prepare import prepare
from lidar_emu.runtime.summary import Tally
from lidar_emu.scenario.load import ScenarioSource, load
from lidar_emu.shots.model import build_model
from lidar_emu.trajectory.live_datagram import Truth, Verdict
from lidar_emu.transports.spec import Kind, PortSpec

if TYPE_CHECKING:
    from lidar_emu.trajectory.live import LiveTrajectory


class DuePacket(NamedTuple):
    """A packet that the device sends."""

    due_ns: int
    """Scenario time at which its transmission begins."""
    payload: bytes
    """Framed bytes, as on a serial line."""
    kind: Literal["shot", "housekeeping", "acknowledgement"]
    measurement: Measurement | None = None
    """The measurement of a shot, (1, beams), with its ground truth."""


class EmbeddedDevice:
    """The emulated device, driven by the caller's clock: time goes forward with `advance`, and nothing waits.

    It sends the packets of `lidar-emu run` for the same scenario, seed, commands and truth. Times are scenario times
    in nanoseconds. Faults of the link (a port that disappears) do not apply, since there is none.

    Args:
        scenario: path of a YAML file, name of a shipped scenario, mapping with the keys of a file, or a scenario.
        overrides: dotted keys and values that replace the scenario's, e.g. `{"timing.rate_hz": 100}`.
        keys: the same for keys without a dot, e.g. `duration_s=5`.

    Raises:
        InputError: a key or a file cannot be used, or the flight leaves the ground.
    """

    def __init__(
        self, scenario: ScenarioSource, overrides: Mapping[str, Any] | None = None, **keys: Any
    ) -> None:
        self.scenario = load(scenario, overrides, **keys)
        """The scenario."""
        model = build_model(self.scenario)
        pace = Pace.MAX if self.scenario.live is None else Pace.LOCKSTEP
        prepared = prepare(self.scenario, model, RunOptions(PortSpec(Kind.LOOPBACK), pace))
        self._session, self._live = prepared.session, prepared.live
        self._flight, self._shot_count = model.flight, model.shot_count
        if self._session.next_shot:  # preparation has computed the first block
            self._session.rewind(0)
        self._now_ns = 0
        self._changes: deque[tuple[int, Change]] = deque()
        self._queued: deque[DuePacket] = deque()
        self._answers: list[bytes] = []
        downlink, device = prepared.downlink, prepared.device
        self._commands = self._housekeeping = None
        if downlink.has_commands:
            self._commands = CommandHandler(
                downlink, device, prepared.can_encode_time, self._answers.append, ()
            )
        if downlink.has_housekeeping:
            self._housekeeping = HousekeepingSender(
                downlink, device, Tally(pace), self._commands, self._answers.append, ()
            )

    @property
    def is_over(self) -> bool:
        """Whether the flight has ended and `advance` has returned its last packet."""
        return self._session.is_over and not self._queued

    @property
    def next_ns(self) -> int | None:
        """Time to which `advance` should go next: a packet is due, or a shot can be computed; None after the flight.

        With live truth, give the truth up to this time first.
        """
        times_ns = [packet.due_ns for packet in self._queued][:1]
        if not self._session.is_over:
            times_ns.append(self._seen_ns())
        return min(times_ns, default=None)

    def receive(self, data: bytes, time_ns: int) -> list[DuePacket]:
        """Receive bytes of the host, and return the acknowledgements of the commands that they complete.

        A command affects the shots that begin at `time_ns` or later. Bytes of a command may come in several calls.

        Raises:
            InputError: no bytes, or a time before an earlier call.
        """
        if not isinstance(data, bytes | bytearray | memoryview):
            raise InputError("receive", "data", data, "must be bytes")
        self._go_to(time_ns, "receive")
        if self._commands is not None:
            changes = self._commands.receive(bytes(data), time_ns, time_ns)
            self._changes.extend((time_ns, change) for change in changes)
        return self._taken(time_ns, "acknowledgement")

    def set_truth(
        self,
        time_ns: int,
        position_site_m: Sequence[float],
        velocity_site_mps: Sequence[float],
        site_from_body: Sequence[float],
        body_rate_radps: Sequence[float] = (0.0, 0.0, 0.0),
        acceleration_site_mps2: Sequence[float] | None = None,
    ) -> None:
        """Give the true motion of the vehicle's reference point, for a scenario with `trajectory.kind: live`.

        The motion is interpolated between truths, and extrapolated for a shot beyond the newest.

        Args:
            time_ns: scenario time, after the last truth.
            position_site_m: (3,) east, north, up.
            velocity_site_mps: (3,)
            site_from_body: (4,) unit quaternion w, x, y, z; body axes are x forward, y right, z down.
            body_rate_radps: (3,) angular rate against the site, about body x, y, z.
            acceleration_site_mps2: (3,); None: unknown.

        Raises:
            InputError: the scenario has a trajectory of its own, or the truth is not usable.
        """
        trajectory = self._trajectory()
        position_m = _numbers("position_site_m", position_site_m, 3)
        velocity_mps = _numbers("velocity_site_mps", velocity_site_mps, 3)
        acceleration_mps2 = acceleration_site_mps2
        if acceleration_mps2 is not None:
            acceleration_mps2 = _numbers("acceleration_site_mps2", acceleration_mps2, 3)
        attitude = _numbers("site_from_body", site_from_body, 4)
        rate_radps = _numbers("body_rate_radps", body_rate_radps, 3)
        truth = Truth(0, time_ns, position_m, velocity_mps, acceleration_mps2, attitude, rate_radps)
        verdict = trajectory.accept(truth, None)
        if verdict is not Verdict.ACCEPTED:
            found = Finding(verdict.name.lower().replace("_", " "))
            raise InputError("set_truth", "time_ns", found, f"pass {_EXPECTED[verdict]}")

    def advance(self, to_ns: int) -> list[DuePacket]:
        """Let time pass, and return the packets that are due up to and including `to_ns`, in order of transmission.

        A packet that a fault delays keeps those behind it waiting, as on a line.

        Raises:
            InputError: a time before an earlier call, or no truth was given yet.
        """
        self._go_to(to_ns, "advance")
        while not self._session.is_over and self._seen_ns() <= to_ns:
            self._shoot()
        due: list[DuePacket] = []
        while self._queued and self._queued[0].due_ns <= to_ns:
            packet = self._queued.popleft()
            if packet.payload:
                due.append(packet)
            if self._housekeeping is not None:
                self._housekeeping.send_due(packet.due_ns)
                due += self._taken(packet.due_ns, "housekeeping")
        return due

    def _shoot(self) -> None:
        session = self._session
        begins_ns = session.next_shot * session.period_ns
        while self._changes and self._changes[0][0] <= begins_ns:
            self._changes.popleft()[1].apply(session)
        block = session.shoot(1, fired=self._has_fresh_truth())
        assert block is not None
        for packet, due_ns in zip(block.packets, block.due_ns, strict=True):
            assert isinstance(packet, bytes)
            self._queued.append(DuePacket(due_ns, packet, "shot", block.measurement))

    def _has_fresh_truth(self) -> bool:
        """Whether the beams fire: always, unless truth is live and stale."""
        live = self._live
        if live is None:
            return True
        newest = self._trajectory().newest
        if newest is None:
            remedy = "call set_truth first"
            raise InputError("advance", None, Finding("no truth was given yet"), remedy)
        age_ns = self._seen_ns() - newest.time_ns
        return age_ns <= round(live.stale_after_s * 1e9) or live.when_stale == "coast"

    def _seen_ns(self) -> int:
        """Scenario time up to which the next shot depends on the vehicle's motion."""
        shot = self._session.next_shot
        return shot * self._session.period_ns if self._flight is None else self._flight.seen_ns(shot)

    def _trajectory(self) -> LiveTrajectory:
        from lidar_emu.trajectory.live import LiveTrajectory

        if self._flight is None or not isinstance(self._flight.trajectory, LiveTrajectory):
            found = Finding("the scenario has its own trajectory")
            raise InputError("set_truth", None, found, "use a scenario with trajectory.kind: live")
        return self._flight.trajectory

    def _go_to(self, time_ns: int, where: str) -> None:
        if isinstance(time_ns, bool) or not isinstance(time_ns, SupportsIndex) or time_ns < self._now_ns:
            remedy = f"must be a whole number of nanoseconds, {self._now_ns} or later"
            raise InputError(where, "time_ns", time_ns, remedy)
        self._now_ns = time_ns

    def _taken(self, due_ns: int, kind: Literal["housekeeping", "acknowledgement"]) -> list[DuePacket]:
        packets = [DuePacket(due_ns, payload, kind) for payload in self._answers]
        self._answers.clear()
        return packets


_EXPECTED = {
    Verdict.NOT_FINITE: "finite numbers",
    Verdict.BAD_ATTITUDE: "a unit quaternion w, x, y, z",
    Verdict.DUPLICATE: "a time after the last truth",
    Verdict.OUT_OF_ORDER: "a time after the last truth",
    Verdict.IMPLAUSIBLE_TIME: "a time from 0 on, at most 10 s after the last truth",
}


def _numbers(key: str, values: Sequence[float], count: int) -> Any:
    try:
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != count:
        raise InputError("set_truth", key, values, f"must be {count} numbers")
    return numbers
