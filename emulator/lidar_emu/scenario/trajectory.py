"""The trajectory: a constant-deceleration profile, a table, live truth, or a simulated powered descent."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field

from lidar_emu.errors import Finding
from lidar_emu.ip_addresses import endpoint, is_address, is_this_machine
from lidar_emu.scenario.section import NonNegative, Part, Positive, unusable

Lag = Annotated[float, Field(ge=0, le=10)]


class Engine(Part):
    """A throttled engine through the centre of mass; it pushes along body -z."""

    maximum_thrust_n: Positive
    """Thrust at full throttle."""
    minimum_thrust_n: NonNegative = 0.0
    """Thrust at the lowest throttle; the engine cannot burn between this and 0."""
    specific_impulse_s: Positive = 310.0
    """Thrust per weight of propellant a second, in standard gravity."""
    valve_lag_s: Lag = 0.02
    """Time constant of the thrust's response to its command. The response is computed in closed form, for any lag."""

    def _check(self) -> None:
        if self.minimum_thrust_n > self.maximum_thrust_n:
            expected = f"at most {self.maximum_thrust_n:g}, maximum_thrust_n"
            raise unusable("minimum_thrust_n", self.minimum_thrust_n, expected)


class AttitudeControl(Part):
    """Critically damped control of all three axes by thrusters or wheels."""

    bandwidth_radps: Annotated[float, Field(gt=0, le=50)] = 1.5
    """Natural frequency of the closed loop."""
    maximum_torque_nm: Positive = 400.0
    """Largest torque about each body axis."""
    maximum_rate_degps: Positive = 15.0
    """Largest rate of rotation."""
    lag_s: Lag = 0.02
    """Time constant of the torque's response to its command."""


class Gear(Part):
    """Feet in a circle below the vehicle, each a damped spring along the vertical, with friction: for the motion of a
    lander after touchdown, while the lidar still measures."""

    feet: Annotated[int, Field(ge=3, le=16)] = 4
    """Number of feet."""
    radius_m: Positive = 1.5
    """Radius of the circle of the feet."""
    below_m: NonNegative = 1.2
    """Distance of the feet below the vehicle's reference point, along body z."""
    stiffness_npm: Positive = 40_000.0
    """Stiffness of one foot."""
    damping_spm: NonNegative = 3.0
    """The spring's force is multiplied by 1 + damping · speed of compression, never below 0 (Hunt and Crossley)."""
    friction: NonNegative = 0.5
    """Coefficient of Coulomb friction; below 2 cm/s friction is proportional to the speed."""


class Vehicle(Part):
    """A rigid lander. Its reference point is its centre of mass."""

    mass_kg: Positive
    """Mass at the start."""
    dry_mass_kg: Positive
    """Mass with empty tanks; a flight that needs more propellant is refused."""
    inertia_kgm2: tuple[Positive, Positive, Positive]
    """Moments of inertia about body x, y and z at the start; they decrease with the mass."""
    engine: Engine
    """The main engine."""
    attitude_control: AttitudeControl = AttitudeControl()
    """Attitude control."""
    gear: Gear = Gear()
    """Landing gear."""

    def _check(self) -> None:
        if self.dry_mass_kg >= self.mass_kg:
            raise unusable("dry_mass_kg", self.dry_mass_kg, f"less than {self.mass_kg:g}, mass_kg")


class Waypoint(Part):
    """A point of a profile."""

    altitude_m: Annotated[float, Field(ge=0, le=1e7)]
    """Height above the origin of the site frame."""
    speed_mps: Annotated[float, Field(ge=0, le=1e5)]
    """Speed along the path, downward."""


BodyRate = Annotated[float, Field(ge=-1000, le=1000)]


class Attitude(Part):
    """Body attitude at the start, turning at constant body rates."""

    roll_deg: float = 0.0
    """About body x, after pitch and yaw (aerospace order yaw, pitch, roll from north-east-down)."""
    pitch_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0
    """About body y; nose up is positive. At zero roll and pitch the body's z axis points straight down."""
    yaw_deg: float = 0.0
    """Heading of body x, clockwise from north."""
    body_rate_radps: tuple[BodyRate, BodyRate, BodyRate] = (0.0, 0.0, 0.0)
    """Constant angular rate about body x, y and z (for a vehicle that spins or tumbles)."""


class Profile(Part):
    """Straight path with constant acceleration between waypoints."""

    kind: Literal["profile"]
    waypoints: Annotated[list[Waypoint], Field(min_length=2)]
    """Waypoints from high to low; the deceleration of each leg follows from its ends."""
    path_angle_deg: Annotated[float, Field(ge=0.1, le=90)] = 90.0
    """Angle of the path below the horizontal: 90 straight down, 45 a slant path."""
    heading_deg: float = 0.0
    """Horizontal direction of flight, clockwise from north."""
    target_east_m: float = 0.0
    """East coordinate at which the path's line meets altitude 0 (for a landing beside the origin)."""
    target_north_m: float = 0.0
    """North coordinate at which the path's line meets altitude 0."""
    attitude: Attitude = Attitude()
    """Body attitude and rates."""

    def _check(self) -> None:
        for place, (upper, lower) in enumerate(pairwise(self.waypoints), start=1):
            if lower.altitude_m >= upper.altitude_m:
                expected = f"below {upper.altitude_m:g}, the waypoint before it"
                raise unusable(f"waypoints.{place}.altitude_m", lower.altitude_m, expected)
            if upper.speed_mps + lower.speed_mps <= 0:
                expected = "greater than 0 here or at the waypoint before it"
                raise unusable(f"waypoints.{place}.speed_mps", lower.speed_mps, expected)


TimeUnit = Literal["s", "ms", "us", "ns", "min"]
LengthUnit = Literal["m", "km", "ft"]
SpeedUnit = Literal["m/s", "km/s", "km/h", "ft/s"]
AngleUnit = Literal["deg", "rad"]
RateUnit = Literal["deg/s", "rad/s"]


class TimeColumn(Part):
    """The column of time."""

    column: str
    """Name in the file's header."""
    unit: TimeUnit
    """Unit of the file."""


class LengthColumn(Part):
    """A column of positions, with its rate where the file has one."""

    column: str
    """Name in the file's header."""
    unit: LengthUnit
    """Unit of the file."""
    rate_column: str | None = None
    """Column of its time derivative; left out, derived from the rows."""
    rate_unit: SpeedUnit | None = None
    """Unit of the rate column."""

    def _check(self) -> None:
        missing = [key for key in ("rate_column", "rate_unit") if getattr(self, key) is None]
        if len(missing) == 1:
            raise unusable(missing[0], Finding("missing"), "state rate_column and rate_unit, or neither")


class AngleColumn(Part):
    """A column of Euler angles."""

    column: str
    """Name in the file's header."""
    unit: AngleUnit
    """Unit of the file."""
    sign: Literal[1, -1] = 1
    """-1 if the file counts the angle in the opposite direction (for a log that counts pitch nose down)."""


class QuaternionColumns(Part):
    """Attitude as a unit quaternion `site_from_body`, scalar first."""

    columns: tuple[str, str, str, str]
    """Names of the w, x, y and z columns."""


class RateColumns(Part):
    """Measured body rates."""

    columns: tuple[str, str, str]
    """Names of the columns about body x, y and z."""
    unit: RateUnit
    """Unit of the file."""


class Table(Part):
    """A CSV file with a header; cubic Hermite interpolation between its rows. Empty cells are skipped, column by
    column."""

    kind: Literal["table"]
    file: str
    """Path of the CSV file, relative to the file that names it."""
    time: TimeColumn
    """Time column; scenario time 0 is the first row flown."""
    up: LengthColumn
    """Height above the origin of the site frame."""
    east: LengthColumn | None = None
    """Left out: 0."""
    north: LengthColumn | None = None
    """Left out: 0."""
    roll: AngleColumn | None = None
    """Left out: 0."""
    pitch: AngleColumn | None = None
    """Left out: 0."""
    yaw: AngleColumn | None = None
    """Left out: 0."""
    quaternion: QuaternionColumns | None = None
    """Instead of roll, pitch and yaw."""
    body_rates: RateColumns | None = None
    """Left out: the derivative of the interpolated attitude (for a table whose rows are too far apart for that)."""
    from_time: float | None = None
    """First instant flown, in the file's own time and unit; left out: the first row."""
    to_time: float | None = None
    """Last instant flown; left out: the last row."""
    maximum_gap_s: Positive = 10.0
    """A longer gap between filled cells of a column that is used, inside the part flown, is refused or bridged."""
    longer_gaps: Literal["refuse", "bridge"] = "refuse"
    """`bridge`: the curve continues across such a gap; plans, tables and figures show where."""

    def _check(self) -> None:
        if self.quaternion is not None and (self.roll or self.pitch or self.yaw):
            raise unusable(
                "quaternion", Finding("two attitudes"), "use quaternion, or roll, pitch and yaw, not both"
            )


_ADDRESS = r"^(udp:.+:\d{1,5}|unix:.+)$"


WhenStale = Literal["coast", "invalid", "abort"]


class Live(Part):
    """Truth from a dynamics simulator, datagram by datagram; see docs/live-truth.md."""

    kind: Literal["live"]
    listen: Annotated[str, Field(json_schema_extra={"pattern": _ADDRESS})] = "udp:127.0.0.1:5600"
    """Where truth arrives: `udp:HOST:PORT` or `unix:PATH`, a datagram socket. A host beyond this machine needs
    `allow`."""
    allow: list[str] = []
    """Simulators that are believed: an IP address or `ADDRESS:PORT` each, `[ADDRESS]:PORT` for IPv6. Left out: the
    sender of the first truth, for the whole run."""
    lead_s: Annotated[float, Field(ge=0, le=10)] = 1e-3
    """Latest start of a shot's computation, as a time before its packet is due. It uses the newest truth at that
    instant. For a simulator whose truth comes just in time."""
    stale_after_s: Annotated[float, Field(gt=0, le=3600)] = 0.1
    """Truth is stale if the newest sample is older than the shot by more than this; in real time it may be as far
    ahead."""
    when_stale: WhenStale = "coast"
    """`coast` extrapolates the motion, `invalid` sends beams that did not fire, `abort` ends the run with an error.
    Each is counted."""

    def _check(self) -> None:
        if not re.search(_ADDRESS, self.listen):
            expected = "udp:HOST:PORT, e.g. udp:127.0.0.1:5600 for this machine alone, or unix:PATH"
            raise unusable("listen", self.listen, expected)
        for number, sender in enumerate(self.allow):
            if not is_address(sender):
                expected = "an IP address or ADDRESS:PORT, e.g. 192.168.1.20"
                raise unusable(f"allow[{number}]", sender, expected)
        if self.allow and self.listen.startswith("unix:"):
            raise unusable(
                "allow", self.allow, "left out with unix:; who may write to a path is up to the file system"
            )
        if self.is_open and not self.allow:
            expected = "an address of this machine, unless `allow` names the simulators"
            raise unusable("listen", self.listen, expected)

    @property
    def is_open(self) -> bool:
        """Whether other machines can send truth."""
        address = self.listen.removeprefix("udp:")
        return address != self.listen and not is_this_machine(endpoint(address).host)


Coordinate = Annotated[float, Field(ge=-1e7, le=1e7)]
Velocity = Annotated[float, Field(ge=-1e5, le=1e5)]


class Start(Part):
    """State at the start of a powered descent; the engine is burning."""

    position_site_m: tuple[Coordinate, Coordinate, Coordinate]
    """East, north and up from the origin of the site frame."""
    velocity_site_mps: tuple[Velocity, Velocity, Velocity]
    """Velocity relative to the ground: east, north and up."""
    attitude: Attitude | None = None
    """Left out: thrust along the first command of guidance, and no rotation."""


class Target(Part):
    """Landing point; the ground there is taken as level."""

    east_m: Coordinate = 0.0
    """East coordinate, from the origin of the site frame. A gravity turn does not steer towards it."""
    north_m: Coordinate = 0.0
    """North coordinate, from the origin of the site frame."""
    up_m: Coordinate = 0.0
    """Height of the ground at touchdown."""


class GravityTurn(Part):
    """Thrust against the velocity, just enough to reach the descent speed at the gate; gravity turns the path
    downward."""

    kind: Literal["gravity_turn"]


class Polynomial(Part):
    """Acceleration as a quadratic polynomial of the time to go, to arrive above the target, upright and at the
    descent speed."""

    kind: Literal["polynomial"]
    time_to_gate_s: Annotated[float, Field(gt=0, le=3600)] | None = None
    """Left out: the time of a constant deceleration to the gate."""


class PoweredDescent(Part):
    """A descent with six degrees of freedom, from guidance to touchdown; see docs/flights.md."""

    kind: Literal["powered_descent"]
    vehicle: Vehicle
    """The lander."""
    start: Start
    """Initial state."""
    target: Target = Target()
    """Landing target."""
    guidance: Annotated[GravityTurn | Polynomial, Field(discriminator="kind")]
    """Guidance to the gate, the point from which the descent is vertical."""
    gate_height_m: NonNegative = 30.0
    """Height of the gate above the ground at the target, counted from the feet."""
    descent_speed_mps: Positive = 1.5
    """Downward speed from the gate on."""
    cut_off_height_m: NonNegative = 0.5
    """Height of the lowest foot above the ground at engine cut-off; 0: at touchdown."""
    maximum_tilt_deg: Annotated[float, Field(ge=0, le=85)] = 45.0
    """Largest angle of the commanded thrust from the vertical."""
    heading_deg: float = 0.0
    """Heading of body x, clockwise from north."""
    gravity_mps2: Annotated[float, Field(ge=1e-6)] = 1.62
    """Gravity at the origin of the site frame. It points to the centre of the site's body and falls with the square
    of the distance."""
    control_rate_hz: Annotated[float, Field(ge=1, le=1000)] = 20.0
    """Rate of the commands of guidance and attitude control."""
    step_s: Annotated[float, Field(ge=1e-5, le=0.1)] = 0.01
    """Longest step of the integration; a control period, spin or stiff feet shorten it."""
    after_touchdown_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Length of the flight after touchdown, with engine and control off."""
    longest_s: Annotated[float, Field(gt=0, le=7200)] = 900.0
    """A flight that has not landed by then is refused."""

    def _check(self) -> None:
        gate_m = self.target.up_m + self.gate_height_m + self.vehicle.gear.below_m
        if self.start.position_site_m[2] <= gate_m:
            expected = f"a position above the gate, at {gate_m:g}"
            raise unusable("start.position_site_m", self.start.position_site_m, expected)
        if 0 < self.cut_off_height_m < 1e-3:  # cut-off and touchdown would be one step of no length
            raise unusable("cut_off_height_m", self.cut_off_height_m, "0, or at least 0.001")
        if self.cut_off_height_m > self.gate_height_m:
            expected = f"at most {self.gate_height_m:g}, gate_height_m"
            raise unusable("cut_off_height_m", self.cut_off_height_m, expected)


Trajectory = Annotated[Profile | Table | Live | PoweredDescent, Field(discriminator="kind")]
