"""Beam directions of every pattern, and which pattern is active."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lidar_emu.numerics.arrays import BoolArray, FloatArray, IntArray
from lidar_emu.numerics.kernels import kernel, with_fields
from lidar_emu.numerics.vector_arrays import from_rotation_vector, from_yaw_pitch_roll, rotate
from lidar_emu.scenario.scanner import AltitudeSwitch, Mounting, Pattern, Scan, Scanner, TimeSwitch


@dataclass(frozen=True)
class ScannerState:
    """State of the pattern selection that passes from shot to shot."""

    active: tuple[bool, ...]
    """Whether each switch is active."""
    commanded: int | None = None
    """Pattern chosen by a command, which overrides the switches."""


THRESHOLD = np.dtype([("by_time", bool), ("from_ground", bool), ("on", float)], align=True)
"""A switch in the kernel: active from time `on`, or once below altitude `on`.

`from_ground`: whether altitude is measured from the ground, or from the origin.
"""


@dataclass(frozen=True)
class ScannerModel:
    """The patterns of a scanner: pattern 0 at the start, pattern k + 1 of switch k.

    Arrays are (rows, beams), with a row for each pattern, or for each scan step of each pattern, one pattern after
    another. Patterns with fewer beams than the largest are padded with NaN.
    """

    published_sensor: FloatArray
    """(rows, beams, 3) Unit vectors in the sensor frame along the published beam axes."""
    true_sensor: FloatArray
    """(rows, beams, 3) Unit vectors along the true beam axes."""
    angle_deg: FloatArray
    """(rows, beams) Published off-boresight angle."""
    steps: int
    """Steps of a scan; 1 without a scan."""
    firing_cycle: NDArray[np.int64]
    """(beams,) Cycle of the shot in which a beam fires."""
    switches: tuple[AltitudeSwitch | TimeSwitch, ...]
    thresholds: NDArray[np.void]
    """(switches,) `switches` as `THRESHOLD` records."""
    initial: ScannerState

    @property
    def beam_count(self) -> int:
        """Number of beams of the largest pattern."""
        return len(self.firing_cycle)

    @property
    def set_count(self) -> int:
        """Number of beam patterns."""
        return len(self.angle_deg) // self.steps

    def row(self, chosen: IntArray | int, shot: NDArray[np.int64]) -> IntArray:
        """Rows (n,) of the arrays for the patterns of shots (n,), or for one pattern in all of them."""
        return chosen * self.steps + shot % self.steps

    @property
    def needs_ground_altitude(self) -> bool:
        return any(
            isinstance(switch, AltitudeSwitch) and switch.datum == "ground" for switch in self.switches
        )

    def choose(
        self,
        state: ScannerState,
        time_s: FloatArray,
        up_m: FloatArray,
        ground_m: FloatArray,
        chosen: IntArray,
    ) -> ScannerState:
        """Choose the patterns of consecutive shots (n,); returns the state to pass with the next ones.

        Args:
            state: of the shot before; `initial` for the first.
            time_s: (n,) scenario time of each shot's start.
            up_m: (n,) height of the sensor above the origin of the site frame.
            ground_m: (n,) height of the ground straight below; NaN where there is none, which leaves a switch as it is.
            chosen: (n,) set to the patterns.
        """
        active = np.array(state.active, dtype=np.bool_)
        commanded = -1 if state.commanded is None else state.commanded
        choose_patterns(self.thresholds, time_s, up_m, ground_m, commanded, active, chosen)
        return replace(state, active=tuple(active.tolist()))


@kernel(outermost=True)
def choose_patterns(
    thresholds: Any,
    time_s: FloatArray,
    up_m: FloatArray,
    ground_m: FloatArray,
    commanded: int,
    active: BoolArray,
    chosen: IntArray,
) -> None:
    """Update `active` (switches,) from shot to shot, and fill `chosen` (shots,) with the pattern that a command chose,
    or by the switches (-1).

    Comparisons with NaN are false, so that a switch without an altitude keeps its state.
    """
    for s in range(len(chosen)):
        chosen[s] = 0
        for k in range(len(active)):
            switch = thresholds[k]
            altitude_m = up_m[s] - ground_m[s] if switch.from_ground else up_m[s]
            if switch.by_time:
                active[k] = time_s[s] >= switch.on
            elif altitude_m < switch.on:
                active[k] = True
            if active[k]:
                chosen[s] = k + 1
        if commanded >= 0:
            chosen[s] = commanded


def _thresholds(switches: Sequence[AltitudeSwitch | TimeSwitch]) -> NDArray[np.void]:
    rows = [
        (True, False, switch.at_s)
        if isinstance(switch, TimeSwitch)
        else (False, switch.datum == "ground", switch.below_m)
        for switch in switches
    ]
    thresholds: NDArray[np.void] = with_fields(np.array(rows, dtype=THRESHOLD))
    return thresholds


def build_scanner(part: Scanner) -> ScannerModel:
    """Build the directions of all patterns."""
    beam_count = part.beam_count
    misaligned = _misalignment(part, beam_count)
    published = [_directions(pattern, beam_count) for pattern in part.patterns]
    angle_deg, published_sensor = (np.stack(arrays) for arrays in zip(*published, strict=True))
    true_sensor = rotate(misaligned, published_sensor)
    steps = 1
    if part.scan is not None:
        steps = part.scan.steps
        published_sensor, true_sensor = (
            _scan_steps(part.scan, beams) for beams in (published_sensor, true_sensor)
        )
        angle_deg = np.degrees(off_axis_rad(published_sensor))
    return ScannerModel(
        published_sensor=published_sensor,
        true_sensor=true_sensor,
        angle_deg=angle_deg,
        steps=steps,
        firing_cycle=np.arange(beam_count) * (part.firing == "in_turn"),
        switches=tuple(part.switches),
        thresholds=_thresholds(part.switches),
        initial=ScannerState((False,) * len(part.switches)),
    )


def mounting_rotation(part: Mounting) -> FloatArray:
    """Rotation body_from_sensor (3, 3)."""
    yaw, pitch, roll = (np.radians(angle) for angle in (part.yaw_deg, part.pitch_deg, part.roll_deg))
    return from_yaw_pitch_roll(yaw, pitch, roll)


def _directions(pattern: Pattern, beam_count: int) -> tuple[FloatArray, FloatArray]:
    """Off-boresight angles in degrees (beams,) and unit vectors (beams, 3); NaN for absent beams."""
    beams_deg = np.full((beam_count, 2), np.nan)
    beams_deg[: len(pattern.beams_deg)] = pattern.beams_deg
    angle, azimuth = np.radians(beams_deg).T
    unit = np.stack(
        [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1
    )
    return beams_deg[:, 0], unit


def off_axis_rad(direction: FloatArray) -> FloatArray:
    """Angles (...) of vectors (..., 3) from the z axis of their frame, accurate for small angles."""
    return np.asarray(np.arctan2(np.hypot(direction[..., 0], direction[..., 1]), direction[..., 2]))


def _scan_steps(part: Scan, beams: FloatArray) -> FloatArray:
    """Beams (patterns, beams, 3) at every step of a scan, one pattern after another: (patterns * steps, beams, 3)."""
    azimuth = np.radians(part.azimuth_deg)
    turn_rad = np.radians(np.linspace(-part.half_angle_deg, part.half_angle_deg, part.steps))
    # The axis is 90 degrees ahead of the azimuth, so that z turns towards the azimuth.
    turn = from_rotation_vector(turn_rad[:, None] * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0]))
    return rotate(turn[:, None], beams[:, None]).reshape(-1, *beams.shape[1:])


def _misalignment(part: Scanner, beam_count: int) -> FloatArray:
    given = part.misalignment_mrad or [(0.0, 0.0)] * beam_count
    vector_rad = np.zeros((beam_count, 3))
    vector_rad[:, :2] = np.array(given) * 1e-3
    return from_rotation_vector(vector_rad)
