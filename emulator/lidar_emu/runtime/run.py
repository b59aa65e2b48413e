"""A run: a scenario flown over a port, from its first shot to its summary."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import TYPE_CHECKING, Any

from lidar_emu.device.state import TimedEvent
from lidar_emu.errors import InputError
from lidar_emu.runtime.change_queue import ChangeQueue, SystemClockFollower
from lidar_emu.runtime.command_handler import CommandHandler
from lidar_emu.runtime.feed.base import Feed, PacketQueue
from lidar_emu.runtime.feed.live import LiveFeed, LiveTiming, LockstepFeed
from lidar_emu.runtime.feed.live_truth_source import TruthSource, truth_socket
from lidar_emu.runtime.feed.planned import PlannedFeed
from lidar_emu.runtime.housekeeping import FinalMessage, HousekeepingSender
from lidar_emu.runtime.machine import Machine
from lidar_emu.runtime.observer import AbortOnLate, Observer, PulseSchedule
from lidar_emu.runtime.options import RunOptions, StartEvent, start_instant_ns, wait_limit_s
from lidar_emu.runtime.port.child import PortDiedError
from lidar_emu.runtime.port.packets import Pace, Pacing, WhenLate
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.prepare import prepare
from lidar_emu.runtime.run_status import POLL_NS, RunStatus, wait_for_host
from lidar_emu.runtime.summary import Outcome, Tally, planned_summary
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.shots.model import Model
from lidar_emu.transports.sockets import DatagramSocket

if TYPE_CHECKING:
    from lidar_emu.runtime.fault_injector import FaultInjector

_LEAD_NS = 100_000_000
"""From the command that starts a flight to scenario time 0."""


class Run:
    """A run of a scenario over a port.

    Args:
        options: port, pace and start.
        observers: called in the loop of the run: they must be quick. More may be added until the run begins.
        machine: where it runs; None: the real one.

    Raises:
        InputError: the wire is too slow for the rate, the interface too small for the beams, or the pace or the start
            does not suit the scenario.
    """

    def __init__(
        self,
        scenario: FlightScenario | BenchScenario,
        model: Model,
        options: RunOptions,
        observers: list[Observer],
        machine: Machine | None = None,
    ) -> None:
        self._machine = machine or Machine()
        self._prepared = prepare(scenario, model, options)
        self.warnings = self._prepared.warnings
        """Warnings for the user."""
        self._options, timing = options, scenario.timing
        self._port: PortRunner
        self._injector: FaultInjector | None = None
        self._commands: CommandHandler | None = None
        self._housekeeping: HousekeepingSender | None = None
        self._final_message: FinalMessage | None = None
        self._truth: TruthSource | None = None
        polled = scenario.wire.polled
        pacing = Pacing(
            options.pace, timing.late_after_ns, WhenLate(timing.when_late), timing.period_ns if polled else 0
        )
        self._status = RunStatus(observers, pacing, self._machine.clock)
        self.tally = Tally(options.pace, polled)
        # Computed at the end: the first packet need not wait for it.
        self._planned = partial(planned_summary, scenario, model)

    @property
    def start_ns(self) -> int | None:
        """Instant of the monotonic clock from which due times count; known once observers receive `on_opened`."""
        return self._status.start_ns

    def fly(self) -> Outcome:
        """Run to the end, or until SIGINT (Ctrl-C), SIGTERM or SIGHUP, which end the run cleanly too.

        Raises:
            InputError: the port or the truth's address cannot be opened, or the start lies in the past.
            RunError: opening the port took too long. If its process dies, the run ends with its summary.
        """
        gc.freeze()  # garbage collections in flight then skip everything that was built before it
        prepared, live = self._prepared, self._prepared.live
        truth_address = truth_socket(live.listen, self._machine) if live else nullcontext()
        with (
            truth_address as socket,
            self._status.interruptible(),
            PortRunner(
                2 * prepared.slots,
                prepared.room_bytes,
                self._status.on_stall,
                prepared.downlink.has_commands,
                self._machine,
            ) as self._port,
            self._open_injector() as self._injector,
        ):
            self._connect(socket)
            packets = PacketQueue(self._port, self._status.observers, self.tally, prepared.slots)
            changes = ChangeQueue(self._port, self._commands, self._injector, self._system_clock())
            with suppress(KeyboardInterrupt), self._record_port_death():
                waits = prepared.start is StartEvent.ON_CONNECT
                self._port.start(prepared.port, prepared.port_faults, may_be_absent=waits)
                self._status.ready(self._port)
                if (feed := self._feed(packets, changes)) is not None:
                    feed.run()
            for sender in (self._housekeeping, self._final_message):
                if sender is not None:
                    sender.end()
            self._port.close()
            packets.close()
            changes.close()
        return Outcome(self.tally, self._details(), self._status.error)

    def _open_injector(self) -> AbstractContextManager[FaultInjector | None]:
        if self._options.control is None:
            return nullcontext()
        from lidar_emu.runtime.fault_injector import FaultInjector

        prepared = self._prepared
        return FaultInjector(
            self._options.control,
            prepared.scenario,
            prepared.model,
            prepared.encoder,
            self._options,
            (prepared.packet_bytes, prepared.faulty_packet_bytes),
            self._port.inject_fault,
            self._inject_into_device,
            self._status.observers,
            self._machine,
        )

    def _inject_into_device(self, events: tuple[TimedEvent, ...]) -> None:
        """Pass events to the device; before a flight on command begins, they do not apply yet."""
        if self.start_ns is not None:
            self._prepared.device.use_events(events)

    def _connect(self, socket: DatagramSocket | None) -> None:
        prepared, port = self._prepared, self._port
        self._status.observers = observers = list(self._status.observers)
        downlink, device = prepared.downlink, prepared.device
        self._truth = self._truth_source(socket, observers)
        poll = self._poll if prepared.scenario.wire.polled else None
        if downlink.has_commands:
            self._commands = CommandHandler(
                downlink, device, prepared.can_encode_time, port.send_now, observers, poll
            )
        if downlink.has_housekeeping:
            self._housekeeping = HousekeepingSender(
                downlink, device, self.tally, self._commands, port.send_now, observers, poll is not None
            )
        timing = prepared.scenario.timing
        if timing.when_process_dies == "safe":
            self._final_message = FinalMessage(downlink, self._housekeeping, port.set_final_message)
        abort = AbortOnLate(self._status.fail) if timing.when_late == "abort" else None
        inner = self._truth, abort, self._housekeeping, self._final_message, self._pulse_schedule()
        observers += [observer for observer in inner if observer is not None]

    def _poll(self, time_ns: int) -> None:
        """Send what the host asks for: housekeeping, if it is due, and the last measurement."""
        if self._housekeeping is not None:
            self._housekeeping.send_due(max(0, time_ns))  # commands before the flight count from its start
        self._port.poll()

    def _system_clock(self) -> SystemClockFollower | None:
        prepared, clock, scenario = self._prepared, self._status.clock, self._prepared.scenario
        if scenario.device.clock.source is None:
            return None
        epoch = scenario.timing.epoch
        epoch_utc_ns = (epoch - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
        shown_ns = clock.now_ns() + clock.utc_ahead_ns() - epoch_utc_ns
        if shown_ns < 0 or not prepared.can_encode_time(shown_ns):
            remedy = "must be an instant in the past, from which packets can count, beside device.clock.source: system"
            raise InputError(scenario.name, "timing.epoch", epoch.isoformat(), remedy)
        return SystemClockFollower(prepared.device, epoch_utc_ns, clock)

    def _pulse_schedule(self) -> PulseSchedule | None:
        prepared, model = self._prepared, self._prepared.model
        if prepared.scenario.device.clock.pulse_out is None or self._options.pace is not Pace.WALL:
            return None
        first = prepared.shots.sample.measurement
        valid_ns = int(first.time_ns[0, 0] - first.shot[0] * model.period_ns)
        send, start_ns = self._port.set_pulses, lambda: self.start_ns
        return PulseSchedule(prepared.device, valid_ns, model.period_ns, model.shot_count, start_ns, send)

    def _truth_source(self, socket: DatagramSocket | None, observers: list[Observer]) -> TruthSource | None:
        live = self._prepared.live
        if socket is None or live is None:
            return None
        from lidar_emu.trajectory.live import LiveTrajectory

        trajectory = self._prepared.session.flight.trajectory
        assert isinstance(trajectory, LiveTrajectory)
        return TruthSource(socket, trajectory, round(live.stale_after_s * 1e9), live.allow, observers)

    def _feed(self, packets: PacketQueue, changes: ChangeQueue) -> Feed | None:
        """Wait for what starts a planned flight; return the feed of its shots, None if the wait was ended."""
        prepared, status = self._prepared, self._status
        start_ns = start_instant_ns(prepared.start, status.clock)
        shared = status, prepared.session, packets, changes
        if self._truth is not None and (live := prepared.live) is not None:
            self._wait_for(f"truth on {live.listen}")
            if self._options.pace is Pace.LOCKSTEP:
                return LockstepFeed(*shared, self._truth)
            timing = LiveTiming(
                start_ns,
                round(live.lead_s * 1e9),
                prepared.scenario.timing.late_after_ns,
                round(self._machine.busy_wait_share() * prepared.session.period_ns),
            )
            return LiveFeed(*shared, self._truth, timing, live.when_stale, self._machine)

        if prepared.start is StartEvent.ON_CONNECT:
            self._wait_for("a host to open it")
            if not wait_for_host(status, self._port, changes):
                return None
        elif prepared.start is StartEvent.ON_COMMAND:
            self._wait_for("set_mode acquire or track")
            start_ns = self._wait_for_command(packets, changes)
            if start_ns is None:
                return None
        shots = prepared.shots
        return PlannedFeed(*shared, shots.first(), shots.block_shots, start_ns, self._options.pace)

    def _wait_for_command(self, packets: PacketQueue, changes: ChangeQueue) -> int | None:
        """The instant of the monotonic clock at scenario time 0, once a command has made the device acquire; None: the
        wait was ended. Until then the device boots, acknowledges and sends housekeeping."""
        status, clock, session = self._status, self._status.clock, self._prepared.session
        device, housekeeping = self._prepared.device, self._housekeeping
        powered_ns = clock.now_ns()
        packets.port.status.start_ns = powered_ns  # from which times count until the flight begins
        while status.may_wait():
            now_ns = clock.now_ns() - powered_ns
            changes.receive(now_ns, powered_ns)
            while changes.first is not None:
                changes.apply_first(session, None)
            if device.at(now_ns).measures:
                break
            if housekeeping is not None and not self._prepared.scenario.wire.polled:
                housekeeping.send_due(now_ns)
            packets.port.wait(clock.now_ns() + POLL_NS)
            packets.collect_reports()
        else:
            return None
        start_ns = clock.now_ns() + _LEAD_NS
        session.use_device(device.start_flight(session.constants, start_ns - powered_ns))
        if housekeeping is not None:
            housekeeping.start_flight()
        for observer in status.observers:
            observer.on_flight_started(start_ns - powered_ns)
        return start_ns

    @contextmanager
    def _record_port_death(self) -> Iterator[None]:
        try:
            yield
        except PortDiedError as death:
            self._status.fail(str(death))
            if self._final_message is not None:
                self._final_message.send(self._prepared.port, self._machine)

    def _wait_for(self, what: str) -> None:
        self._status.wait_for(what, wait_limit_s(self._prepared.start, self._options.wait_limit_s))

    def _details(self) -> dict[str, Any]:
        injector = self._injector
        return {
            **self._planned(),
            "pace": str(self._options.pace),
            **self._status.to_json(self._options.port, self._port.status, self._prepared.wire_load),
            "final_message": None if self._final_message is None else self._final_message.result,
            "commands": None if self._commands is None else self._commands.to_json(),
            "host_messages": None if self._commands is None else self._commands.messages_to_json(),
            "housekeeping": None if self._housekeeping is None else self._housekeeping.to_json(),
            "faults_in_flight": None if injector is None else injector.to_json(),
            "truth": None if self._truth is None else self._truth.to_json(),
        }
