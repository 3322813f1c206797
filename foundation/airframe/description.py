"""Airframe: mass, body, rotors, battery and given gains of one multicopter, and what follows from them.

There is one frame: body axes FRD (forward, right, down) with the origin at the centre of mass, in metres.
"""

import math
from itertools import combinations
from typing import Annotated, Literal

from msgspec import Meta, Struct

from foundation.types import Vector

MOST_ROTORS = 16
"""Controls in HIL_ACTUATOR_CONTROLS."""
LEAST_ROTORS = 4
"""Thrust and three torques are four demands; tilting a rotor by a servo is not modelled."""
GRAVITY_M_S2 = 9.8066
"""Of the simulated world: the value of Gazebo-classic's worlds."""
SEA_LEVEL_DENSITY_KG_M3 = 1.225
"""Air density for which `Propulsion.thrust_n_s2` is given."""
CELL_V = 3.7
"""Voltage of a lithium-polymer cell under load, for currents that are derived."""
MOTOR_AND_BLADE_EFFICIENCY = 0.5
"""Ideal induced power of a hovering rotor over its electrical power, for currents that are derived; it gives
3.8 A for the Iris, whose file has 4 A."""
CLEARANCE_M = 0.05
"""Between the discs of two vehicles at their places."""
LEAST_UPRIGHT = 0.5
"""Least cosine between a rotor's axis and the upward direction of the body."""
MOST_HOVER_SHARE = 0.8
"""Greatest share of the thrust range in hover, that of PX4's MPC_THR_HOVER."""

Inertia = Annotated[float, Meta(ge=1e-9, le=1e5)]
Speed = Annotated[float, Meta(gt=0.0, le=1e5)]
Coefficient = Annotated[float, Meta(ge=0.0, le=1.0)]
Current = Annotated[float, Meta(gt=0.0, le=1_000.0)]
RateGain = Annotated[float, Meta(ge=0.01, le=5.0)]
Direction = Annotated[float, Meta(ge=-1.0, le=1.0)]
Side = Annotated[float, Meta(ge=0.005, le=20.0)]
Offset = Annotated[float, Meta(ge=-10.0, le=10.0)]
Lag = Annotated[float, Meta(ge=0.001, le=1.0)]


class Body(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ``[body]`` table."""

    size_m: tuple[Side, Side, Side]
    """Sides of the box that collides, along the body's axes; its centre is the centre of mass."""
    friction: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.8
    """Coefficient against the ground, whose own is 1.0; 0.8: rubber feet on asphalt."""
    drag_n_s_m: Annotated[float, Meta(ge=0.0, le=1_000.0)] = 0.0
    """Drag of the body over its air speed, N/(m/s), in addition to that of the rotors."""


class Propulsion(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ``[propulsion]`` table: motor and propeller, equal for all rotors.

    A control u, 0..1, turns an armed rotor at ``idle_rad_s`` + u ``range_rad_s``; its thrust is
    ``thrust_n_s2`` times the square of the speed.
    """

    thrust_n_s2: Annotated[float, Meta(ge=1e-12, le=1.0)]
    """Static thrust over the square of the rotor's speed, N/(rad/s)^2, at sea level."""
    moment_m: Coefficient
    """Torque about the rotor's axis over its static thrust."""
    idle_rad_s: Annotated[float, Meta(ge=0.0, le=1e5)]
    """Speed at control 0 while armed."""
    range_rad_s: Speed
    """Speed that a control of 1 adds."""
    rise_s: Lag
    """Time constant of the rotor's speed while it rises."""
    fall_s: Lag
    """Time constant of the rotor's speed while it falls."""
    radius_m: Annotated[float, Meta(ge=0.005, le=5.0)]
    """Radius of the propeller, for ground effect, spacing and derived currents."""
    drag_n_s2_m: Coefficient = 0.0
    """In-plane force over rotor speed and in-plane air speed, N/(rad/s)/(m/s)."""
    rolling_moment_n_s2: Coefficient = 0.0
    """Rolling moment over rotor speed and in-plane air speed, N m/(rad/s)/(m/s)."""
    axial_speed_limit_m_s: Annotated[float, Meta(ge=0.1, le=1_000.0)] = 25.0
    """Axial climb speed through the air at which the linearly falling thrust reaches zero."""

    @property
    def range_n(self) -> float:
        """Thrust that a control of 1 adds to that at control 0."""
        most_rad_s = self.idle_rad_s + self.range_rad_s
        return self.thrust_n_s2 * (most_rad_s * most_rad_s - self.idle_rad_s * self.idle_rad_s)

    @property
    def thrust_model_factor(self) -> float:
        """Factor f of relative thrust = f u^2 + (1 - f) u for a control u: the autopilot's THR_MDL_FAC.

        The thrust above idle over its range is (w^2 - a^2) / ((a + b)^2 - a^2) with w = a + b u, which is
        f u^2 + (1 - f) u with f = b / (b + 2 a).
        """
        return self.range_rad_s / (self.range_rad_s + 2.0 * self.idle_rad_s)

    @property
    def lag_s(self) -> float:
        """Mean of the two time constants."""
        return 0.5 * (self.rise_s + self.fall_s)


class Rotor(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One of ``[[rotors]]``, in the order of the motor controls."""

    position_frd_m: tuple[Offset, Offset, Offset]
    """Hub, from the centre of mass."""
    turns: Literal["ccw", "cw"]
    """Direction of rotation seen from above."""
    axis_frd: tuple[Direction, Direction, Direction] = (0.0, 0.0, -1.0)
    """Direction of the thrust; its length does not matter. (0, 0, -1) is upright."""

    def __post_init__(self) -> None:
        """Check the axis. Raises ValueError."""
        length = math.hypot(*self.axis_frd)
        if not math.isfinite(length) or -self.axis_frd[2] < LEAST_UPRIGHT * length or length == 0.0:
            raise ValueError("axis_frd: expected a direction at most 60 degrees from (0, 0, -1)")

    @property
    def thrust_axis_frd(self) -> Vector:
        """``axis_frd`` with length 1."""
        length = math.hypot(*self.axis_frd)
        x, y, z = self.axis_frd
        return x / length, y / length, z / length

    @property
    def direction(self) -> float:
        """1 for counter-clockwise, -1 for clockwise, seen from above."""
        return 1.0 if self.turns == "ccw" else -1.0


class Battery(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ``[battery]`` table: pack and load."""

    cells: Annotated[int, Meta(ge=1, le=16)]
    """Cells in series."""
    capacity_mah: Annotated[float, Meta(gt=0.0, le=100_000.0)]
    """Capacity of the full pack."""
    cell_resistance_ohm: Annotated[float, Meta(ge=0.0, le=0.2)] = 0.005
    """Resistance of one cell that is not nearly empty."""
    avionics_current_a: Annotated[float, Meta(ge=0.0, le=500.0)] = 1.0
    """Current of everything except the motors."""
    motor_current_a: Current | None = None
    """Current of one motor at ``motor_current_at_rad_s``; derived from the momentum theory of a hovering
    rotor if missing."""
    motor_current_at_rad_s: Speed | None = None
    """Rotor speed of ``motor_current_a``; the hover speed if missing."""
    average_current_a: Annotated[float, Meta(gt=0.0, le=500.0)] | None = None
    """First value of the average current, for the remaining time; that of the hover if missing."""


class Gains(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ``[gains]`` table; what is missing is derived by `autopilot.control.airframe_gains`."""

    hover_thrust: Annotated[float, Meta(ge=0.1, le=MOST_HOVER_SHARE)] | None = None
    """MPC_THR_HOVER: thrust above idle over its range in hover."""
    thrust_lag_s: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    """Time constant of the thrust in the disturbance observer."""
    roll_rate_k: RateGain | None = None
    """MC_ROLLRATE_K"""
    pitch_rate_k: RateGain | None = None
    """MC_PITCHRATE_K"""
    yaw_rate_k: RateGain | None = None
    """MC_YAWRATE_K"""
    roll_p: Annotated[float, Meta(gt=0.0, le=12.0)] | None = None
    """MC_ROLL_P, 1/s"""
    pitch_p: Annotated[float, Meta(gt=0.0, le=12.0)] | None = None
    """MC_PITCH_P, 1/s"""
    yaw_p: Annotated[float, Meta(gt=0.0, le=5.0)] | None = None
    """MC_YAW_P, 1/s"""


class Airframe(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One airframe. Raises ValueError with the field for values that contradict each other."""

    mass_kg: Annotated[float, Meta(ge=1e-4, le=1_000.0)]
    """Mass at take-off."""
    inertia_kg_m2: tuple[Inertia, Inertia, Inertia]
    """Principal moments of inertia about the body's axes."""
    body: Body
    """Collision shape, friction and drag."""
    propulsion: Propulsion
    """Motors and propellers."""
    rotors: Annotated[tuple[Rotor, ...], Meta(min_length=LEAST_ROTORS, max_length=MOST_ROTORS)]
    """Tables ``[[rotors]]``; the first one is motor 0."""
    battery: Battery
    """Pack and load."""
    gains: Gains = Gains()
    """Gains of the autopilot that are not to be derived."""

    def __post_init__(self) -> None:
        """Check what no single field can."""
        x, y, z = self.inertia_kg_m2
        if x > y + z or y > z + x or z > x + y:
            raise ValueError(
                "inertia_kg_m2: no rigid body has a moment of inertia above the sum of the two others"
            )
        for (i, first), (j, second) in combinations(enumerate(self.rotors), 2):
            if first.position_frd_m == second.position_frd_m:
                raise ValueError(f"rotors[{j}].position_frd_m: that of rotors[{i}], too")
        share = self.hover_share
        if not share > 0.0:
            raise ValueError("propulsion.idle_rad_s: the idle rotors lift more than mass_kg; expected less")
        if not share <= MOST_HOVER_SHARE:
            raise ValueError(
                f"propulsion.thrust_n_s2: hover takes {share:.2f} of the thrust range; expected at most "
                f"{MOST_HOVER_SHARE:g}, so more thrust or less mass_kg"
            )

    @property
    def lift_of_rotors(self) -> float:
        """Sum of the upward components of the rotors' axes: the number of upright rotors."""
        return math.fsum(-rotor.thrust_axis_frd[2] for rotor in self.rotors)

    @property
    def hover_thrust_n(self) -> float:
        """Thrust of one rotor in hover, if all have the same."""
        return self.mass_kg * GRAVITY_M_S2 / self.lift_of_rotors

    @property
    def hover_rad_s(self) -> float:
        """Rotor speed in hover at sea level."""
        return math.sqrt(self.hover_thrust_n / self.propulsion.thrust_n_s2)

    @property
    def hover_share(self) -> float:
        """Thrust above idle over its range in hover: the right value of MPC_THR_HOVER."""
        idle_n = self.propulsion.thrust_n_s2 * self.propulsion.idle_rad_s**2
        return (self.hover_thrust_n - idle_n) / self.propulsion.range_n

    @property
    def standing_height_m(self) -> float:
        """Height of the centre of mass above the ground of a landed vehicle."""
        return self.body.size_m[2] / 2.0

    @property
    def span_m(self) -> float:
        """Greatest distance across the rotors' discs."""
        hubs = [rotor.position_frd_m for rotor in self.rotors]
        apart_m = max(math.dist(first, second) for first, second in combinations(hubs, 2))
        return apart_m + 2.0 * self.propulsion.radius_m

    @property
    def spacing_m(self) -> float:
        """Least distance between the places of two vehicles of this airframe, in whole centimetres."""
        return round(self.span_m + CLEARANCE_M, 2)

    @property
    def current_speed_rad_s(self) -> float:
        """Rotor speed to which `motor_current_a` belongs."""
        given = self.battery.motor_current_at_rad_s
        return self.hover_rad_s if given is None else given

    @property
    def motor_current_a(self) -> float:
        """Current of one motor at `current_speed_rad_s`; it is proportional to the cube of the speed.

        If it is not given: P / U with P = T sqrt(T / (2 rho A)) / `MOTOR_AND_BLADE_EFFICIENCY`, the momentum
        theory of a hovering rotor of disc area A and thrust T.
        """
        if self.battery.motor_current_a is not None:
            return self.battery.motor_current_a
        thrust_n = self.propulsion.thrust_n_s2 * self.current_speed_rad_s**2
        area_m2 = math.pi * self.propulsion.radius_m**2
        induced_m_s = math.sqrt(thrust_n / (2.0 * SEA_LEVEL_DENSITY_KG_M3 * area_m2))
        return thrust_n * induced_m_s / (MOTOR_AND_BLADE_EFFICIENCY * CELL_V * self.battery.cells)

    @property
    def average_current_a(self) -> float:
        """Current of the pack in hover, as given or derived."""
        if self.battery.average_current_a is not None:
            return self.battery.average_current_a
        of_motor_a = self.motor_current_a * (self.hover_rad_s / self.current_speed_rad_s) ** 3
        return self.battery.avionics_current_a + len(self.rotors) * of_motor_a
