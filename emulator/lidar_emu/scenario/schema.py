"""The scenario: one file that states what is flown, over which ground, with which instrument."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Tag

from lidar_emu.errors import Finding
from lidar_emu.scenario.device import DeviceBehaviour
from lidar_emu.scenario.effects_by_level import refused
from lidar_emu.scenario.faults import Fault
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.parts import changed_keys, checked
from lidar_emu.scenario.scanner import Mounting, Scanner
from lidar_emu.scenario.section import Part, Switch, unusable
from lidar_emu.scenario.site import Plume, Site
from lidar_emu.scenario.trajectory import Live, Trajectory
from lidar_emu.scenario.vibration import Vibration


class Ramp(Part):
    """Sawtooth from `start` to `stop`, repeated."""

    start: float
    """Value at the start of each period."""
    stop: float
    """Value that it approaches at the end of each period."""
    period_s: Annotated[float, Field(ge=1e-6, le=1e7)]
    """Length of a period."""


def _kind_of_level(value: object) -> str:
    return "ramp" if isinstance(value, dict | Ramp) else "constant"


Level = Annotated[
    Annotated[float, Tag("constant")] | Annotated[Ramp, Tag("ramp")],
    Discriminator(_kind_of_level),
]


class BenchBeam(Part):
    """What one beam reports."""

    range_m: Level
    """Constant or ramp; never negative."""
    closing_speed_mps: Level
    """Constant or ramp; positive toward the ground."""
    snr_db: float = 20.0
    """Reported signal-to-noise ratio."""
    valid: Switch = True
    """`off`: the beam reports that it found no surface."""

    def _check(self) -> None:
        level = self.range_m
        if isinstance(level, Ramp):
            stated = {"range_m.start": level.start, "range_m.stop": level.stop}
        else:
            stated = {"range_m": level}
        for key, value in stated.items():
            if value < 0:
                raise unusable(key, value, "greater than or equal to 0")


class BenchPattern(Part):
    """Constants and ramps of each beam, in place of instrument, site, trajectory and scanner."""

    beams: Annotated[list[BenchBeam], Field(min_length=1, max_length=64)]
    """The beams, from 0."""
    duration_s: Annotated[float, Field(gt=0, le=1e7)]
    """Length of the pattern."""


def _in_utc(instant: datetime) -> datetime:
    return instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant


Epoch = Annotated[datetime, AfterValidator(_in_utc)]


LONGEST_S = 1e7
"""Longest run; the time code of the wire holds four hundred times that."""


class Timing(Part):
    """When shots are fired and when their packets are due."""

    rate_hz: Annotated[float, Field(ge=1e-3, le=10_000)] = 20.0
    """Shots per second."""
    epoch: Epoch = datetime(2030, 1, 1, tzinfo=UTC)
    """Instant of scenario time 0 on the instrument's clock; UTC if it names no zone (for a flight whose packets must
    bear its date)."""
    processing_latency_s: Annotated[float, Field(ge=0, le=3600)] = 2e-3
    """Time from the end of the cycle to the packet (for an instrument whose processing takes longer)."""
    late_after_s: Annotated[float, Field(ge=1e-6, le=3600)] | None = None
    """A packet later than this is late: not sent, but counted. Left out: one period. For a flight computer that
    needs a packet earlier."""
    when_late: Literal["skip", "abort"] = "skip"
    """After a late packet: `skip` continues with the next packet when it is due; `abort` ends the run (exit code 1)."""
    when_process_dies: Literal["end", "safe"] = "end"
    """If the process of the model or of the port dies, the other one ends the run; `safe`: its last packet is
    housekeeping with mode safe and laser off, if the interface has that message."""

    @property
    def period_ns(self) -> int:
        """Time from shot to shot."""
        return round(1e9 / self.rate_hz)

    @property
    def late_after_ns(self) -> int:
        """`late_after_s` with its default, in nanoseconds."""
        return self.period_ns if self.late_after_s is None else round(self.late_after_s * 1e9)

    def shots_within(self, duration_s: float) -> int:
        """Shots that start before `duration_s` has passed; at least the one at 0."""
        return max(1, -(-round(duration_s * 1e9) // self.period_ns))


LEFT_OUT_SHARE = 0.05
"""Default of `FlightScenario.left_out_share`."""


class Wire(Part):
    """Messages and unit number on the wire."""

    interface: str = "default"
    """Message definitions: `default`, `altimeter`, or your own TOML file (`.toml`)."""
    unit: Annotated[int, Field(ge=0, le=15)] = 0
    """Offsets the APID and the CAN identifiers, so that several units can share a bus."""
    polled: bool = False
    """Whether the device sends nothing unasked, for several devices on one pair of wires (RS-485): each `no_op` is
    answered with the acknowledgement, housekeeping if it is due, and the last measurement, once."""
    pty_uart: bool = False
    """Whether a pty behaves as a UART: bytes at the bit rate, 4 kB of buffer in front of them, and 4 kB behind them
    that the reader has not fetched. What does not fit is dropped, and counted."""
    can_messages: Literal["core", "full"] = "full"
    """On classic CAN: a header and one message per beam, or the second set as well. CAN FD carries everything."""


class Scenario(Part):
    """Keys of every scenario."""

    name: str
    """Shown in plans and summaries."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Seed of every random number."""
    duration_s: Annotated[float, Field(gt=0, le=LONGEST_S)] | None = None
    """Length of the run. Left out: the length of the trajectory or the pattern."""
    timing: Timing = Timing()
    """Rate and latency."""
    wire: Wire = Wire()
    """Identity on the wire."""
    device: DeviceBehaviour = DeviceBehaviour()
    """The device around the lidar: modes, clock, housekeeping."""
    faults: Annotated[list[Fault], Field(min_length=0, max_length=256)] = []
    """Injected faults, applied in this order."""

    def with_(self, overrides: Mapping[str, Any] | None = None, **keys: Any) -> Self:
        """A copy with other values, checked as by `load`; `model_copy` checks nothing.

        Args:
            overrides: dotted keys and values, e.g. `{"timing.rate_hz": 100}`; text is read as YAML.
            keys: the same for keys without a dot.

        Raises:
            InputError: one line that names the key, what it must be, and the value.
        """
        tree = self.model_dump(mode="json", exclude_unset=True)
        return checked(tree, changed_keys(overrides, keys), type(self), Path(), self.name)

    @property
    def live(self) -> Live | None:
        """Source of live truth; None if the scenario defines its trajectory or pattern."""
        return None

    @property
    def laser_power_w(self) -> float | None:
        """Power of the laser while it is on; None if there is no laser."""
        return None


class FlightScenario(Scenario):
    """A flight over ground, measured by the model of the instrument."""

    instrument: Instrument
    """The lidar."""
    site: Site
    """The ground."""
    trajectory: Trajectory
    """The flight."""
    scanner: Scanner
    """The beams."""
    mounting: Mounting = Mounting()
    """The sensor on the vehicle (for a sensor beside or oblique to the vehicle's axes)."""
    vibration: Vibration | None = None
    """Random vibration of the vehicle at the sensor, beside the motion of the trajectory. Left out: none."""
    plume: Plume | None = None
    """Dust that the engine raises near the ground. Left out: none."""
    level: Literal["geometric", "spectral", "reference"] = "spectral"
    """How the receiver is computed: `geometric` reports the truth; `spectral` computes the bins of the spectra that
    matter; `reference` has the light of scatterers that are fixed to the surface, each with the two-way amplitude and
    phase of the Gaussian mode, and judges the other levels (tens of milliseconds a beam)."""
    reference_samples: Literal["narrowband", "full_rate"] = "narrowband"
    """Samples at level `reference`: `narrowband`, an envelope around the frequencies of the scatterers, with the
    digitiser as noise; `full_rate`, every sample, through the receiver's poles and a digitiser that clips (seconds a
    beam)."""
    left_out_share: Annotated[float, Field(ge=0, le=0.5)] = LEFT_OUT_SHARE
    """Share of the expected sigma of range and closing speed by which all stages that are left out may change the
    errors together. 0 computes every stage of the model, as a judge of faster settings does."""

    @property
    def live(self) -> Live | None:
        return self.trajectory if isinstance(self.trajectory, Live) else None

    @property
    def laser_power_w(self) -> float | None:
        return self.instrument.optics.laser_power_w

    @property
    def cycle_time_s(self) -> float:
        """Time from the start of a shot to the end of its last segment: each beam in turn takes all of its looks."""
        cycles = 1 if self.scanner.firing == "together" else self.scanner.beam_count
        return self.instrument.waveform.cycle_time_s * self.instrument.detection.looks * cycles

    def _check(self) -> None:
        limit_hz = 1 / self.cycle_time_s
        if self.timing.rate_hz > limit_hz * (1 + 1e-9):
            raise unusable(
                "timing.rate_hz",
                self.timing.rate_hz,
                f"at most {limit_hz:.6g}, what the waveform reaches with beams fired "
                f"{self.scanner.firing.replace('_', ' ')} and detection.looks {self.instrument.detection.looks}",
            )
        given = len(self.scanner.misalignment_mrad)
        needed = self.scanner.beam_count
        if given not in (0, needed):
            found = Finding(f"a list of {given}")
            raise unusable(
                "scanner.misalignment_mrad", found, f"state {needed} entries, one per beam, or none"
            )
        if self.reference_samples != "narrowband" and self.level != "reference":
            raise unusable(
                "reference_samples", self.reference_samples, "narrowband, or level reference with it"
            )
        refusal = refused(self)
        if refusal is not None:
            raise unusable(*refusal)
        if self.vibration is not None and self.instrument.detection.looks > 1:
            raise unusable("instrument.detection.looks", self.instrument.detection.looks, "1 with vibration")
        leakage_db = self.instrument.optics.leakage_db
        if leakage_db is not None and not self.instrument.optics.speckle:
            raise unusable("instrument.optics.leakage_db", leakage_db, "null with optics.speckle: off")


class BenchScenario(Scenario):
    """Constants and ramps instead of physics, to check a driver."""

    bench_pattern: BenchPattern
    """What the beams report."""
