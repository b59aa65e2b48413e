"""A run: a scenario flown over a port, from its first shot to its summary."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from datetime import datetime, timedelta
from functools import partial
from typing import TYPE_CHECKING, Any

from lidar_emu.device.machine import initial
from lidar_emu.device.now import DeviceNow
from lidar_emu.device.rules import Event, device_rules
from lidar_emu.flight import Flight
from lidar_emu.runtime.changes import Changes
from lidar_emu.runtime.child import PortDiedError
from lidar_emu.runtime.clock import Clock
from lidar_emu.runtime.events import EventLog, told
from lidar_emu.runtime.feed import Desk, Feed
from lidar_emu.runtime.feed_live import LiveFeed
from lidar_emu.runtime.feed_lockstep import LockstepFeed
from lidar_emu.runtime.feed_on_command import OnCommandFeed, waiting_device
from lidar_emu.runtime.front import Front, open_front
from lidar_emu.runtime.last_words import LastWords, unsayable
from lidar_emu.runtime.late_ends import LateEnds
from lidar_emu.runtime.lateness import steal_ticks
from lidar_emu.runtime.observer import Observer
from lidar_emu.runtime.on_order import packets_on_order, port_on_order
from lidar_emu.runtime.outbox import Outbox, payload_of
from lidar_emu.runtime.outcome import Outcome
from lidar_emu.runtime.pacing import Pace, WhenLate
from lidar_emu.runtime.realtime import awake_share
from lidar_emu.runtime.run import PortRunner
from lidar_emu.runtime.run_options import RunOptions, live_part, port_of, start_instant_ns
from lidar_emu.runtime.shots_ahead import ShotsAhead
from lidar_emu.runtime.signals import on_signals
from lidar_emu.runtime.summary import Tally, of_scenario
from lidar_emu.runtime.truth_socket import TruthSocket
from lidar_emu.runtime.truth_source import TruthSource
from lidar_emu.runtime.voice import Voice
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.session import Session
from lidar_emu.shots import FlightModel, Model
from lidar_emu.trajectory.live import LiveTrajectory
from lidar_emu.transports.spec import Kind
from lidar_emu.transports.wire_load import check_wire_load, wire_load
from lidar_emu.wire import Encoder

if TYPE_CHECKING:
    from lidar_emu.runtime.injector import Injector

LOOK_AHEAD_S = 2.0
_BLOCK_S = 0.25
_PACKET_ROOM_BYTES = 8192
_STUFFING_BYTES = 256


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
        self._scenario = scenario
        self._model = model
        self._options = options
        self._observers = observers
        self._clock = clock or Clock()
        self._live = live_part(scenario, options)
        rate_hz = scenario.timing.rate_hz
        block_shots = max(1, min(128, round(rate_hz * _BLOCK_S)))
        port = options.port
        self._encoder = encoder = Encoder(scenario.wire, port.kind is Kind.CAN, port.fd, model.beam_count)
        self._slots = max(2 * block_shots, round(rate_hz * LOOK_AHEAD_S))
        faulty = packets_on_order(scenario, encoder, options)
        beams, patterns = model.beam_count, model.pattern_count
        rules = device_rules(
            scenario.device, rate_hz, beams, patterns, scenario.laser_power_w, scenario.faults, scenario.seed
        )
        self._device = waiting_device(rules) if options.on_command else DeviceNow(rules, initial(rules))
        self._session = Session(model, encoder, self._slots + 1, faulty, rules)
        self._port_faults = port_on_order(scenario, model, options)
        # The first block is computed before the run: kernels are compiled, and the packets' length is known.
        known = self._live is None and not options.on_command
        self._ahead = ShotsAhead(self._session, model, encoder, block_shots, options.pace, known)
        longest = max(
            (payload_of(packet) for packet in encoder.packets(self._ahead.first.measurement)), key=len
        )
        faulty_bytes = len(longest) if faulty is None else faulty.longest(len(longest))
        self._packet_room_bytes = max(_PACKET_ROOM_BYTES, faulty_bytes + _STUFFING_BYTES)
        self._packet_bytes = len(longest), self._packet_room_bytes - _STUFFING_BYTES
        self._changes = Changes()
        self._injector: Injector | None = None
        self._wire_load = wire_load(port, longest, rate_hz)
        self._opening = True
        self._interrupted = False
        self._description = ""
        self._start_utc: datetime | None = None
        self.start_ns: int | None = None
        """Instant of the monotonic clock from which due times count; known once observers hear `opened`."""
        self._error: str | None = None
        self.tally = Tally(options.pace)
        self._known = of_scenario(scenario, model)
        self._process_events = EventLog()
        self._says_last_words = scenario.timing.when_process_dies == "safe"
        self._last_words: LastWords | None = None
        wordless = unsayable(encoder.interface, port.kind is Kind.CAN) if self._says_last_words else None
        warnings = check_wire_load(port, longest, rate_hz), wordless
        self.warnings = [warning for warning in warnings if warning]
        """What the user should know before the run."""

    def fly(self) -> Outcome:
        """Run to the end, or until SIGINT (Ctrl-C), SIGTERM or SIGHUP, which end the run as cleanly.

        Raises:
            InputError: the port or the truth's address cannot be opened, or the start lies in the past.
            RunError: the port's process did not start. If it dies later, the run ends with its summary.
        """
        stolen = steal_ticks()
        gc.freeze()  # a collection in mid-flight need not look at all that was built for it
        truth_address = TruthSocket(self._live.listen, self._clock) if self._live else nullcontext()
        with (
            truth_address as socket,
            on_signals(self._interrupt),
            PortRunner(2 * self._slots, self._packet_room_bytes, self._noticed) as port,
            self._open_injector(port) as self._injector,
        ):
            watching = list(self._observers)
            source = self._source(socket, watching)
            front, outbox = self._front(port, source, watching)
            with suppress(KeyboardInterrupt):
                self._description = port.start(port_of(self._scenario, self._options), self._port_faults)
                self._opening = False
                with self._outliving_the_port():
                    self._feed(port, outbox, source, front).fly()
            port.close()
            outbox.close()
            self._changes.close()
        return Outcome(self.tally, self._details(port, source, front, stolen), self._error)

    def _open_injector(self, port: PortRunner) -> AbstractContextManager[Injector | None]:
        """Where faults are ordered in flight."""
        if self._options.control is None:
            return nullcontext()
        from lidar_emu.runtime.injector import Injector

        return Injector(
            self._options.control,
            self._scenario,
            self._model,
            self._encoder,
            self._options,
            self._packet_bytes,
            port.order_fault,
            self._expect,
            self._changes,
            self._observers,
        )

    def _front(
        self, port: PortRunner, source: TruthSource | None, watching: list[Observer]
    ) -> tuple[Front, Outbox]:
        """What the device hears and says, and the shots' way out; whoever is to know of them watches from now on."""
        outbox, can = Outbox(port, watching, self.tally, self._slots), self._options.port.kind is Kind.CAN
        voice = Voice(self._encoder.interface, self._scenario.wire.unit, can, outbox.send_now)
        front = open_front(voice, self._device, self._can_date, self.tally, self._changes, watching)
        if self._says_last_words:
            self._last_words = LastWords(voice, front.housekeeper, port.prepare)
        judge = LateEnds(self._fail) if self._scenario.timing.when_late == "abort" else None
        ours = source, judge, front.housekeeper, self._last_words
        watching += [each for each in ours if each is not None]
        return front, outbox

    def _can_date(self, shown_ns: int) -> bool:
        """Whether packets can tell the time to the end of the run, once the clock has been set to this."""
        run_ns = self._model.shot_count * self._model.period_ns
        return self._encoder.can_date(self._ahead.first.measurement, shown_ns + run_ns)

    def _expect(self, events: tuple[Event, ...]) -> None:
        """Of a flight to come, nothing is known to the device before."""
        if self.start_ns is not None:
            self._device.expect(events)

    @contextmanager
    def _outliving_the_port(self) -> Iterator[None]:
        try:
            yield
        except PortDiedError as death:
            self._fail(str(death))
            if self._last_words is not None:
                self._last_words.say(self._options.port, self._clock)

    def _noticed(self, time_ns: int, what: str) -> None:
        self._process_events.add(self._process_events.count + 1, time_ns, what)
        for observer in self._observers:
            observer.noticed(time_ns, what)

    def _source(self, socket: TruthSocket | None, watching: list[Observer]) -> TruthSource | None:
        if socket is None or self._live is None:
            return None
        stale_after_ns = round(self._live.stale_after_s * 1e9)
        trajectory = self._flight.trajectory
        assert isinstance(trajectory, LiveTrajectory)
        return TruthSource(socket, trajectory, stale_after_ns, watching)

    def _feed(self, port: PortRunner, outbox: Outbox, source: TruthSource | None, front: Front) -> Feed:
        desk = Desk(
            self._session,
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
        if source is not None and self._live is not None:
            self._announce(f"truth on {self._live.listen}")
            if self._options.pace is Pace.LOCKSTEP:
                return LockstepFeed(desk, source, self._flight)
            late_after_ns = self._scenario.timing.late_after_ns
            return LiveFeed(desk, source, self._flight, self._live, start_ns, late_after_ns, awake_share())
        fly_from = partial(self._ahead.feed, desk)
        if not self._options.on_command:
            return fly_from(start_ns)
        self._announce("set_mode acquire or track")
        return OnCommandFeed(desk, self._device, front.housekeeper, fly_from)

    def _announce(self, what: str) -> None:
        for observer in self._observers:
            observer.awaiting(self._description, what)

    @property
    def _flight(self) -> Flight:
        assert isinstance(self._model, FlightModel)
        return self._model.flight

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
            observer.opened(self._description, self._start_utc)
        timing = self._scenario.timing
        port.begin(start_ns, timing.late_after_ns, self._options.pace, WhenLate(timing.when_late))
        if self._last_words is not None:
            self._last_words.begin()

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
            **port.told.to_json(self._wire_load),
            **told("process", self._process_events.count, self._process_events.since(0)),
            "last_words": None if self._last_words is None else self._last_words.told,
            **front.to_json(),
            "faults_in_flight": None if self._injector is None else self._injector.to_json(),
            "truth": None if source is None else source.to_json(),
        }
