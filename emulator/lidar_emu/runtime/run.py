"""A run: a scenario flown over a port, from its first shot to its summary."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from datetime import datetime, timedelta
from functools import partial
from typing import TYPE_CHECKING, Any

from lidar_emu.device.rules import Event
from lidar_emu.runtime.abort_on_late import AbortOnLate
from lidar_emu.runtime.change_queue import Changes
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.device_link.build import Front, open_device_link
from lidar_emu.runtime.device_link.encoder import DownlinkEncoder
from lidar_emu.runtime.device_link.final_message import FinalMessage
from lidar_emu.runtime.feed.base import Desk, Feed
from lidar_emu.runtime.feed.datagram_socket import DatagramSocket
from lidar_emu.runtime.feed.live import LiveFeed
from lidar_emu.runtime.feed.lockstep import LockstepFeed
from lidar_emu.runtime.feed.on_command import OnCommandFeed
from lidar_emu.runtime.feed.packet_queue import PacketQueue
from lidar_emu.runtime.feed.truth_source import TruthSource, truth_socket
from lidar_emu.runtime.lateness import steal_ticks
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.options import RunOptions, port_of, start_instant_ns
from lidar_emu.runtime.outcome import Outcome
from lidar_emu.runtime.port.child import PortDiedError
from lidar_emu.runtime.port.events import EventLog, told
from lidar_emu.runtime.port.pacing import Pace, WhenLate
from lidar_emu.runtime.port.runner import PortRunner
from lidar_emu.runtime.prepare import prepared
from lidar_emu.runtime.realtime import busy_wait_share
from lidar_emu.runtime.signals import on_signals
from lidar_emu.runtime.summary import Tally, of_scenario
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.shots.model import Model

if TYPE_CHECKING:
    from lidar_emu.runtime.fault_injector import FaultInjector


class Run:
    """One flight of a scenario over a port.

    Args:
        scenario: what is flown.
        model: of the scenario.
        options: port, pace and start.
        observers: told of everything, in the loop: they must be quick.

    Raises:
        InputError: the wire is too slow for the rate, the interface too small for the beams, or the pace is none for
            this scenario.
    """

    def __init__(
        self,
        scenario: FlightScenario | BenchScenario,
        model: Model,
        options: RunOptions,
        observers: list[Observer],
        clock: Clock | None = None,
    ) -> None:
        self._ready = prepared(scenario, model, options)
        self._options, self._timing = options, scenario.timing
        self._observers = observers
        self._clock = clock or Clock()
        self._changes = Changes()
        self._injector: FaultInjector | None = None
        self._opening = True
        self._interrupted = False
        self._error: str | None = None
        self._description = ""
        self._start_utc: datetime | None = None
        self.start_ns: int | None = None
        """Instant of the monotonic clock from which due times count; known once observers hear `opened`."""
        self.tally = Tally(options.pace)
        self._known = of_scenario(scenario, model)
        self._process_events = EventLog()
        self._final_message: FinalMessage | None = None

    @property
    def warnings(self) -> list[str]:
        """What the user should know before the run."""
        return self._ready.warnings

    def fly(self) -> Outcome:
        """Run to the end, or until SIGINT (Ctrl-C), SIGTERM or SIGHUP, which end the run as cleanly.

        Raises:
            InputError: the port or the truth's address cannot be opened, or the start lies in the past.
            RunError: the port's process did not start. If it dies later, the run ends with its summary.
        """
        stolen = steal_ticks()
        gc.freeze()  # a collection in mid-flight need not look at all that was built for it
        ready, live = self._ready, self._ready.live
        truth_address = truth_socket(live.listen, self._clock) if live else nullcontext()
        with (
            truth_address as socket,
            on_signals(self._interrupt),
            PortRunner(2 * ready.slots, ready.room_bytes, self._noticed) as port,
            self._open_injector(port) as self._injector,
        ):
            watching = list(self._observers)
            source = self._source(socket, watching)
            front, outbox = self._front(port, source, watching)
            with suppress(KeyboardInterrupt):
                self._description = port.start(port_of(ready.scenario, self._options), ready.port_faults)
                self._opening = False
                with self._outliving_the_port():
                    self._feed(port, outbox, source, front).fly()
            port.close()
            outbox.close()
            self._changes.close()
        return Outcome(self.tally, self._details(port, source, front, stolen), self._error)

    def _open_injector(self, port: PortRunner) -> AbstractContextManager[FaultInjector | None]:
        """Where faults are ordered in flight."""
        if self._options.control is None:
            return nullcontext()
        from lidar_emu.runtime.fault_injector import FaultInjector

        return FaultInjector(
            self._options.control,
            self._ready.scenario,
            self._ready.model,
            self._ready.encoder,
            self._options,
            (self._ready.packet_bytes, self._ready.faulty_packet_bytes),
            port.order_fault,
            self._expect,
            self._changes,
            self._observers,
        )

    def _front(
        self, port: PortRunner, source: TruthSource | None, watching: list[Observer]
    ) -> tuple[Front, PacketQueue]:
        """What the device hears and says, and the shots' way out; whoever is to know of them watches from now on."""
        ready, outbox = self._ready, PacketQueue(port, watching, self.tally, self._ready.slots)
        voice = DownlinkEncoder(
            ready.encoder.interface, ready.scenario.wire.unit, ready.is_can, outbox.send_now
        )
        front = open_device_link(voice, ready.device, ready.can_date, self.tally, self._changes, watching)
        if self._timing.when_process_dies == "safe":
            self._final_message = FinalMessage(voice, front.housekeeper, port.prepare)
        judge = AbortOnLate(self._fail) if self._timing.when_late == "abort" else None
        ours = source, judge, front.housekeeper, self._final_message
        watching += [each for each in ours if each is not None]
        return front, outbox

    def _expect(self, events: tuple[Event, ...]) -> None:
        """Of a flight to come, nothing is known to the device before."""
        if self.start_ns is not None:
            self._ready.device.expect(events)

    @contextmanager
    def _outliving_the_port(self) -> Iterator[None]:
        try:
            yield
        except PortDiedError as death:
            self._fail(str(death))
            if self._final_message is not None:
                self._final_message.say(self._options.port, self._clock)

    def _noticed(self, time_ns: int, what: str) -> None:
        self._process_events.add(self._process_events.count + 1, time_ns, what)
        for observer in self._observers:
            observer.on_process_event(time_ns, what)

    def _source(self, socket: DatagramSocket | None, watching: list[Observer]) -> TruthSource | None:
        live = self._ready.live
        if socket is None or live is None:
            return None
        from lidar_emu.trajectory.live import LiveTrajectory

        trajectory = self._ready.flight.trajectory
        assert isinstance(trajectory, LiveTrajectory)
        return TruthSource(socket, trajectory, round(live.stale_after_s * 1e9), watching)

    def _feed(self, port: PortRunner, outbox: PacketQueue, source: TruthSource | None, front: Front) -> Feed:
        ready = self._ready
        desk = Desk(
            ready.session,
            outbox,
            self._clock,
            self._cut_short,
            self._fail,
            lambda start_ns: self._begin(port, start_ns),
            self._changes,
            front.commands,
            self._injector,
        )
        start_ns = start_instant_ns(self._options, self._clock)
        if source is not None and ready.live is not None:
            self._announce(f"truth on {ready.live.listen}")
            if self._options.pace is Pace.LOCKSTEP:
                return LockstepFeed(desk, source, ready.flight)
            late_after_ns = self._timing.late_after_ns
            return LiveFeed(
                desk, source, ready.flight, ready.live, start_ns, late_after_ns, busy_wait_share()
            )
        fly_from = partial(ready.ahead.feed, desk)
        if not self._options.on_command:
            return fly_from(start_ns)
        self._announce("set_mode acquire or track")
        return OnCommandFeed(desk, ready.device, front.housekeeper, fly_from, self._began_flight)

    def _announce(self, what: str) -> None:
        for observer in self._observers:
            observer.on_waiting(self._description, what)

    def _began_flight(self, waited_ns: int) -> None:
        for observer in self._observers:
            observer.on_flight_started(waited_ns)

    def _interrupt(self, *_: object) -> None:
        """Noted, and acted on between packets: an exception anywhere could lose reports that were just fetched.
        While the port is being opened there is nothing to lose, and no loop that would look."""
        self._interrupted = True
        if self._opening:
            raise KeyboardInterrupt

    def _cut_short(self) -> bool:
        return self._interrupted or self._error is not None

    def _fail(self, error: str) -> None:
        self._error = self._error or error

    def _begin(self, port: PortRunner, start_ns: int) -> None:
        now_ns, now = self._clock.now_ns(), self._clock.utc_now()
        self.start_ns, self._start_utc = start_ns, now + timedelta(microseconds=(start_ns - now_ns) / 1000)
        for observer in self._observers:
            observer.on_opened(self._description, self._start_utc)
        timing = self._timing
        port.begin(start_ns, timing.late_after_ns, self._options.pace, WhenLate(timing.when_late))
        if self._final_message is not None:
            self._final_message.begin()

    def _details(
        self, port: PortRunner, source: TruthSource | None, front: Front, stolen: int | None
    ) -> dict[str, Any]:
        stolen_now = steal_ticks()
        return {
            **self._known,
            "started_utc": None if self._start_utc is None else self._start_utc.isoformat(),
            "interrupted": self._interrupted,
            "error": self._error,
            "port": port.told.description or str(self._options.port),
            "pace": str(self._options.pace),
            "steal_ticks": None if stolen is None or stolen_now is None else stolen_now - stolen,
            **port.told.to_json(self._ready.wire_load),
            **told("process", self._process_events.count, self._process_events.since(0)),
            "final_message": None if self._final_message is None else self._final_message.told,
            **front.to_json(),
            "faults_in_flight": None if self._injector is None else self._injector.to_json(),
            "truth": None if source is None else source.to_json(),
        }
