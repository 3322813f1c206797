"""The interface of a controller in place of the cascade: its inputs, and what it returns.

`autopilot.control.user_control` calls it. The autopilot keeps what lies on both sides of it: setpoints,
take-off and land detection, observers of hover thrust and disturbance before it, allocation with its
desaturation after it.
"""

from typing import Protocol

from msgspec import Struct

from autopilot.control.params import ControlParams
from foundation.airframe.description import Airframe
from foundation.types import Array, EstimatorState, Setpoint, Triple, Vector

TORQUE_MAX = 10.0
"""Greatest magnitude of a normalised torque; one of 1 already needs most of the rotors' range."""


class ThrustTorque(Struct, frozen=True):
    """Demand of a controller, in the units of PX4's allocation.

    Thrust and torque instead of motor commands: allocation then gives up yaw first, roll and pitch last, and
    the collective that it achieves is what land detection and the observers depend on.
    """

    thrust: float
    """Collective thrust along -z of the body, 0..1 of the rotors' full thrust above idle."""
    torque: Triple
    """(3,) about FRD axes, normalised: a unit is `ControllerContext.unit_torque_m`; at most `TORQUE_MAX`."""


class ControllerContext(Struct, frozen=True, kw_only=True):
    """What a controller is made for: one vehicle, for its lifetime."""

    instance: int
    """Number of the UAV."""
    airframe: Airframe
    """Mass, inertia, rotors and battery of the vehicle, as in its airframe file."""
    unit_torque_m: Vector
    """Normalised torque of 1 about x, y and z (FRD): N m per newton of one rotor's full thrust above idle,
    which is ``airframe.propulsion.range_n``."""
    params: ControlParams
    """The autopilot's parameters at the start: limits of tilt, rates, speeds and accelerations."""


class ControllerInputs(Struct, kw_only=True):
    """Inputs of one inertial sample. Arrays may be updated in place after the call: copy what is kept."""

    state: EstimatorState
    """The estimate. Setpoints of a position or velocity that is not valid must not be followed."""
    setpoint: Setpoint
    """Of the mode, or of offboard mode's source: the same object until it changes."""
    yaw_rad: float
    """Heading to follow with a `TrajectorySetpoint`, clockwise from north: the setpoint's, or the one that is
    kept or turned by its yaw rate if it has none."""
    dt_s: float
    """Since the last sample, > 0."""
    landed: bool
    """Contact with the ground is likely: nothing may integrate."""
    climb_max_m_s: float
    """Limit of the climb rate while thrust rises for take-off, negative at first; infinite in flight."""
    hover_thrust: float
    """Estimated thrust of the hover, 0..1: gravity is cancelled by this `ThrustTorque.thrust`."""
    disturbance_ned_m_s2: Array
    """(3,) acceleration that gravity and thrust do not explain, such as wind; zero if CF_DOB_EN is 0."""
    unallocated: Array
    """(3,) normalised torque of the last demand that the rotors could not produce."""
    controls_yaw: bool
    """False: a motor has failed, and the others cannot control yaw, so the vehicle turns about its thrust;
    ``unallocated`` then has the whole torque about z."""


class Controller(Protocol):
    """Replaces position, attitude and rate control of one vehicle.

    The class is created as ``Class(context)`` with a `ControllerContext`; with a class attribute
    ``Settings``, a msgspec Struct or dataclass, as ``Class(context, settings)``.

    Call order: `reset` before the first `update` after arming and after each landing; then `update` at every
    inertial sample (4 ms). It is not called while the motors idle. There is no clock, no I/O and no
    randomness: equal calls return equal values. An exception, or an output outside its range, ends the
    vehicle.
    """

    def reset(self, state: EstimatorState) -> None:
        """Forget integrals, filters and everything else of the flight before."""

    def update(self, inputs: ControllerInputs) -> ThrustTorque:
        """Return the demand until the next sample."""
