"""A lunar lander in Basilisk: gravity of the Moon, one throttled engine, ideal attitude control."""

from typing import NamedTuple

import numpy as np
from Basilisk.architecture import messaging
from Basilisk.simulation import extForceTorque, simSynch, spacecraft
from Basilisk.utilities import RigidBodyKinematics as Rotations
from Basilisk.utilities import SimulationBaseClass, simIncludeGravBody
from site_frame import Array

MASS_KG = 2000.0
INERTIA_KG_M2 = np.diag([2400.0, 2400.0, 1800.0])
LARGEST_THRUST_N = 9000.0
_ENGINE_BODY = np.array([0.0, 0.0, -1.0])  # The engine pushes upward; body z points down.
_NATURAL_RADPS, _DAMPING = 2.0, 0.9


class State(NamedTuple):
    """The vehicle in the inertial frame of the Moon."""

    position_m: Array
    velocity_mps: Array
    body_from_inertial: Array
    """Rotation matrix (3, 3)."""
    rate_body_radps: Array
    """Angular rate of the body in inertial space, about its own axes."""


class Vehicle:
    """A Basilisk simulation that is advanced step by step.

    Args:
        start: the state at time 0.
        step_ns: length of a step.
        with_clock: keep pace with the wall clock.
    """

    def __init__(self, start: State, step_ns: int, with_clock: bool) -> None:
        self._step_ns = step_ns
        self.time_ns = 0
        self._wanted_inertial_mps2 = np.zeros(3)
        self._bodies = simIncludeGravBody.gravBodyFactory()  # kept here: Basilisk holds no reference to it
        self._hub = _hub(start, self._bodies)
        self._force, self._torque = messaging.CmdForceBodyMsg(), messaging.CmdTorqueBodyMsg()
        self._effector = extForceTorque.ExtForceTorque()
        self._effector.cmdForceBodyInMsg.subscribeTo(self._force)
        self._effector.cmdTorqueInMsg.subscribeTo(self._torque)
        self._hub.addDynamicEffector(self._effector)
        self._simulation = SimulationBaseClass.SimBaseClass()
        self._simulation.CreateNewProcess("flight").addTask(
            self._simulation.CreateNewTask("dynamics", step_ns)
        )
        # Higher priorities run first: read the command, fly the step, then wait for real time.
        self._simulation.AddModelToTask("dynamics", self._effector, 3)
        self._simulation.AddModelToTask("dynamics", self._hub, 2)
        if with_clock:
            self._clock = simSynch.ClockSynch()
            self._clock.accuracyNanos = 100_000
            self._simulation.AddModelToTask("dynamics", self._clock, 1)
        self._push(0.0, np.zeros(3))
        self._simulation.InitializeSimulation()
        self._simulation.ConfigureStopTime(0)
        self._simulation.ExecuteSimulation()

    @property
    def state(self) -> State:
        """Present state."""
        state = self._hub.scStateOutMsg.read()
        return State(
            np.array(state.r_BN_N),
            np.array(state.v_BN_N),
            Rotations.MRP2C(state.sigma_BN),
            np.array(state.omega_BN_B),
        )

    def command_thrust(self, thrust_body_mps2: tuple[float, float, float]) -> None:
        """Set the thrust per mass in the present body axes; its direction then stays fixed in inertial space."""
        self._wanted_inertial_mps2 = self.state.body_from_inertial.T @ np.array(thrust_body_mps2)

    def step(self) -> None:
        """Fly one step with the autopilot's force and torque."""
        state = self.state
        wanted_mps2 = state.body_from_inertial @ self._wanted_inertial_mps2
        along_engine_mps2 = float(wanted_mps2 @ _ENGINE_BODY)
        thrust_n = min(max(0.0, MASS_KG * along_engine_mps2), LARGEST_THRUST_N)
        size_mps2 = float(np.linalg.norm(wanted_mps2))
        turn_rad = np.cross(_ENGINE_BODY, wanted_mps2 / size_mps2) if size_mps2 > 0 else np.zeros(3)
        wanted_radps2 = _NATURAL_RADPS**2 * turn_rad - 2 * _DAMPING * _NATURAL_RADPS * state.rate_body_radps
        self._push(thrust_n, INERTIA_KG_M2 @ wanted_radps2)
        self.time_ns += self._step_ns
        self._simulation.ConfigureStopTime(self.time_ns)
        self._simulation.ExecuteSimulation()

    def _push(self, thrust_n: float, torque_body_nm: Array) -> None:
        force, torque = messaging.CmdForceBodyMsgPayload(), messaging.CmdTorqueBodyMsgPayload()
        force.forceRequestBody = (thrust_n * _ENGINE_BODY).tolist()
        torque.torqueRequestBody = torque_body_nm.tolist()
        self._force.write(force, self.time_ns)
        self._torque.write(torque, self.time_ns)


def _hub(start: State, bodies: simIncludeGravBody.gravBodyFactory) -> spacecraft.Spacecraft:
    made = spacecraft.Spacecraft()
    made.ModelTag = "lander"
    made.hub.mHub = MASS_KG
    made.hub.r_BcB_B = [[0.0], [0.0], [0.0]]
    made.hub.IHubPntBc_B = INERTIA_KG_M2.tolist()
    made.hub.r_CN_NInit = start.position_m.reshape(3, 1).tolist()
    made.hub.v_CN_NInit = start.velocity_mps.reshape(3, 1).tolist()
    made.hub.sigma_BNInit = Rotations.C2MRP(start.body_from_inertial).reshape(3, 1).tolist()
    made.hub.omega_BN_BInit = start.rate_body_radps.reshape(3, 1).tolist()
    bodies.createMoon().isCentralBody = True
    bodies.addBodiesTo(made)
    return made
