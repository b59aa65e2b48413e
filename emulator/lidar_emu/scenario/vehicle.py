"""The vehicle of a powered descent: masses, engine, attitude control and gear."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

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

    @model_validator(mode="after")
    def _throttle_range(self) -> Self:
        if self.minimum_thrust_n > self.maximum_thrust_n:
            expected = f"at most {self.maximum_thrust_n:g}, maximum_thrust_n"
            raise unusable("minimum_thrust_n", self.minimum_thrust_n, expected)
        return self


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

    @model_validator(mode="after")
    def _masses_fit(self) -> Self:
        if self.dry_mass_kg >= self.mass_kg:
            raise unusable("dry_mass_kg", self.dry_mass_kg, f"less than {self.mass_kg:g}, mass_kg")
        return self
