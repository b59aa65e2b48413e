"""The true flight of a scenario, for the simulated inertial unit and for comparison."""

from typing import NamedTuple

import numpy as np
from beams import Array, DataSheet

from lidar_emu.beams.flight import Flight
from lidar_emu.errors import InputError
from lidar_emu.scenario.load import require_known_flight
from lidar_emu.scenario.schema import BenchScenario, FlightScenario
from lidar_emu.trajectory.profile import VehicleState

LIGHT_MPS = 299_792_458.0


class TrueState(NamedTuple):
    """True state at one instant; site frame: east, north, up."""

    position_site_m: Array
    """(3,) East and north, and height above the ground straight below."""
    velocity_site_mps: Array
    site_from_body: Array


class Truth:
    """A scenario's flight over its ground.

    Raises:
        InputError: the scenario has no flight that is known in advance, or its lidar is not mounted upright at the
            vehicle's reference point, which the filter assumes.
    """

    def __init__(self, scenario: FlightScenario | BenchScenario) -> None:
        if not isinstance(scenario, FlightScenario):
            raise InputError(scenario.name, "bench_pattern", "given", "allowed here: a flight")
        require_known_flight(scenario)
        if scenario.mounting != type(scenario.mounting)():
            raise InputError(scenario.name, "mounting", "given", "allowed here: none, at the reference point")
        self.scenario = scenario
        self._flight = Flight(scenario)
        published, waveform = self._flight.scanner.published_sensor[0], scenario.instrument.waveform
        self.sheet = DataSheet(
            np.degrees(np.arctan2(published[:, 1], published[:, 0])),
            self._flight.scanner.angle_deg[0],
            LIGHT_MPS * waveform.segment_time_s / (waveform.wavelength_m * waveform.chirp_slope_hz_per_s),
        )
        """Data sheet of the scenario's lidar."""

    @property
    def duration_s(self) -> float:
        """Duration of the flight, or of the part that the scenario flies."""
        limit_s = self.scenario.duration_s
        return self._flight.trajectory.duration_s if limit_s is None else limit_s

    def states(self, time_s: Array) -> VehicleState:
        """True motion at instants (n,)."""
        return self._flight.trajectory.state(time_s)

    def at(self, time_ns: int) -> TrueState:
        """True state at one instant."""
        state = self.states(np.array([time_ns * 1e-9]))
        east_m, north_m, up_m = state.position_site_m[0]
        height_m = up_m - self._flight.scene.height_m(np.array([east_m]), np.array([north_m]))[0]
        position_m = np.array([east_m, north_m, height_m])
        return TrueState(position_m, state.velocity_site_mps[0], state.site_from_body[0])

    def slope(self, time_ns: int, reach_m: float) -> Array:
        """Slope (2,) of the ground to the east and to the north, over a distance of `reach_m` on either side."""
        east_m, north_m, _ = self.states(np.array([time_ns * 1e-9])).position_site_m[0]
        around = reach_m * np.array([[1, -1, 0, 0], [0, 0, 1, -1]])
        up_m = self._flight.scene.height_m(east_m + around[0], north_m + around[1])
        return (up_m[0::2] - up_m[1::2]) / (2 * reach_m)
