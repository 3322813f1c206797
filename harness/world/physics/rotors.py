"""Forces and torques of rotors and body drag: kernels over all vehicles at once.

The model is PX4's `gazebo_motor_model`: thrust and yaw torque are proportional to the square of the speed;
in-plane drag and rolling moment follow P. Martin and E. Salaün, "The true role of accelerometer feedback in
quadrotor control", ICRA 2010. All are proportional to the air density; Gazebo's constants hold at sea level.
The optional ground effect follows I. C. Cheeseman and W. E. Bennett, "The effect of the ground on a
helicopter rotor in forward flight", ARC R&M 3021, 1955, equation for the hover, multiplied by the cosine of
the vehicle's tilt.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from foundation.airframe.description import Airframe
from foundation.types import Array
from harness.world.physics.environment import Surroundings
from harness.world.physics.rotation import in_frd, in_ned


class RotorKernelModel(NamedTuple):
    """Rotors of n vehicles as an argument of kernels; R is the greatest number of rotors of a vehicle.

    Elements beyond a vehicle's own rotors are zero and not used.
    """

    rotors: NDArray[np.int64]
    """(n,) number of rotors"""
    hubs_frd_m: Array
    """(n, R, 3)"""
    axes_frd: Array
    """(n, R, 3) direction of the thrust, of length 1"""
    turning: Array
    """(n, R) +1 counter-clockwise from above"""
    thrust_n_s2: Array
    """(n,), like all that follow; see `foundation.airframe.description.Propulsion`"""
    moment_m: Array
    drag_n_s2_m: Array
    rolling_n_s2: Array
    body_drag_n_s_m: Array
    ground_effect_radius_m: Array
    """Radius of a rotor; 0 disables the ground effect"""
    axial_speed_limit_m_s: Array
    idle_rad_s: Array
    range_rad_s: Array
    rise: Array
    """Fraction of a motor's speed error that remains after one step while it rises."""
    fall: Array


LEAST_HEIGHT_RADII = 0.5
"""Least height over radius in Cheeseman and Bennett's formula, which has a pole at 0.25 and is usually
considered valid above 0.5. A landed Iris's rotors are at 0.61."""
MOST_AXIAL_FACTOR = 1.2
"""Limit of the thrust's increase, reached by the Iris at an inflow of 5 m/s from below. Its hovering rotors
induce 5.5 m/s, sqrt(3.8 N / (2 rho A)); from about there a rotor is in its vortex ring state."""


def kernel_model(
    airframes: Sequence[Airframe], *, step_s: float, ground_effect: bool = False
) -> RotorKernelModel:
    """Return the kernels' model of vehicles with these airframes for steps of ``step_s``."""
    n, most = len(airframes), most_rotors(airframes)
    hubs_frd_m, axes_frd, turning = np.zeros((n, most, 3)), np.zeros((n, most, 3)), np.zeros((n, most))
    for i, airframe in enumerate(airframes):
        count = len(airframe.rotors)
        hubs_frd_m[i, :count] = [rotor.position_frd_m for rotor in airframe.rotors]
        axes_frd[i, :count] = [rotor.thrust_axis_frd for rotor in airframe.rotors]
        turning[i, :count] = [rotor.direction for rotor in airframe.rotors]
    units = [airframe.propulsion for airframe in airframes]
    return RotorKernelModel(
        rotors=np.array([len(airframe.rotors) for airframe in airframes]),
        hubs_frd_m=hubs_frd_m,
        axes_frd=axes_frd,
        turning=turning,
        thrust_n_s2=np.array([unit.thrust_n_s2 for unit in units]),
        moment_m=np.array([unit.moment_m for unit in units]),
        drag_n_s2_m=np.array([unit.drag_n_s2_m for unit in units]),
        rolling_n_s2=np.array([unit.rolling_moment_n_s2 for unit in units]),
        body_drag_n_s_m=np.array([airframe.body.drag_n_s_m for airframe in airframes]),
        ground_effect_radius_m=np.array([unit.radius_m if ground_effect else 0.0 for unit in units]),
        axial_speed_limit_m_s=np.array([unit.axial_speed_limit_m_s for unit in units]),
        idle_rad_s=np.array([unit.idle_rad_s for unit in units]),
        range_rad_s=np.array([unit.range_rad_s for unit in units]),
        rise=np.array([math.exp(-step_s / unit.rise_s) for unit in units]),
        fall=np.array([math.exp(-step_s / unit.fall_s) for unit in units]),
    )


def most_rotors(airframes: Sequence[Airframe]) -> int:
    """Return the greatest number of rotors of a vehicle: the length R of rows of rotors."""
    return max(len(airframe.rotors) for airframe in airframes)


@njit(cache=True)
def rotor_speeds(
    model: RotorKernelModel,
    speed_rad_s: Array,
    controls: Array,
    armed: NDArray[np.bool_],
    stopped: NDArray[np.bool_],
) -> Array:
    """Return the rotor speeds (n, R) after a step: a first-order lag towards those of ``controls`` (n, R).

    Controls are limited to 0..1, NaN counts as 0; rotors that are ``stopped`` (n, R), or not ``armed`` (n,),
    spin down.
    """
    after_rad_s = np.zeros_like(speed_rad_s)
    for vehicle in range(speed_rad_s.shape[0]):
        for rotor in range(model.rotors[vehicle]):
            target_rad_s = 0.0
            if armed[vehicle] and not stopped[vehicle, rotor]:
                control = controls[vehicle, rotor]
                if not control > 0.0:  # also NaN
                    control = 0.0
                target_rad_s = model.idle_rad_s[vehicle] + model.range_rad_s[vehicle] * min(control, 1.0)
            now_rad_s = speed_rad_s[vehicle, rotor]
            left = model.rise[vehicle] if target_rad_s > now_rad_s else model.fall[vehicle]
            after_rad_s[vehicle, rotor] = target_rad_s + left * (now_rad_s - target_rad_s)
    return after_rad_s


@njit(cache=True)
def axial_factor(inflow_from_below_m_s: float, limit_m_s: float) -> float:
    """Return the thrust of a rotor over its static thrust for an axial inflow, positive from below.

    Linear: in a climb or a downdraught it falls, to zero at -``limit_m_s``; in a descent or an updraught it
    rises with the same slope, up to `MOST_AXIAL_FACTOR`. Gazebo's plugin uses the speed's magnitude, which
    makes descents unstable.
    """
    return min(max(1.0 + inflow_from_below_m_s / limit_m_s, 0.0), MOST_AXIAL_FACTOR)


@njit(cache=True)
def ground_effect(height_m: float, radius_m: float) -> float:
    """Return a rotor's thrust at a height above the ground over its thrust far from it, at the same speed."""
    radii = max(height_m / radius_m, LEAST_HEIGHT_RADII)
    return 1.0 / (1.0 - 1.0 / (16.0 * radii * radii))


@njit(cache=True)
def wrenches(
    model: RotorKernelModel, bodies: NDArray[np.void], rotor_speed_rad_s: Array, surroundings: Surroundings
) -> tuple[Array, Array]:
    """Return force (n, 3) in N and torque (n, 3) in N m on each vehicle, NED.

    ``bodies`` (n,) are rows of `harness.world.physics.bodies.BODY`. The torque is about the centre of mass;
    the velocities are those of the centre of mass relative to the ground. The wind is the same at all rotors
    and the body of a vehicle.
    """
    vehicles = len(bodies)
    force_ned_n = np.empty((vehicles, 3))
    torque_ned_n_m = np.empty((vehicles, 3))
    force = np.empty(3)
    torque = np.empty(3)
    for vehicle in range(vehicles):
        density = surroundings.density_ratio[vehicle]
        body, air_vel = bodies[vehicle], surroundings.air_vel_ned_m_s[vehicle]
        q, ground_vel, turn = body["q_ned_frd"], body["vel_ned_m_s"], body["omega_ned_rad_s"]
        north_m_s = ground_vel[0] - air_vel[0]
        east_m_s = ground_vel[1] - air_vel[1]
        down_m_s = ground_vel[2] - air_vel[2]
        vel = in_frd(q, north_m_s, east_m_s, down_m_s)
        omega = in_frd(q, turn[0], turn[1], turn[2])
        down = in_frd(q, 0.0, 0.0, 1.0)
        force[:] = 0.0
        torque[:] = 0.0
        thrust_n_s2, moment_m = model.thrust_n_s2[vehicle], model.moment_m[vehicle]
        drag_n_s2_m, rolling_n_s2 = model.drag_n_s2_m[vehicle], model.rolling_n_s2[vehicle]
        radius_m, limit_m_s = model.ground_effect_radius_m[vehicle], model.axial_speed_limit_m_s[vehicle]
        for rotor in range(model.rotors[vehicle]):
            hub_m, axis = model.hubs_frd_m[vehicle, rotor], model.axes_frd[vehicle, rotor]
            x, y, z = hub_m[0], hub_m[1], hub_m[2]
            turning = model.turning[vehicle, rotor]
            speed = rotor_speed_rad_s[vehicle, rotor]
            air_x = vel[0] + omega[1] * z - omega[2] * y
            air_y = vel[1] + omega[2] * x - omega[0] * z
            air_z = vel[2] + omega[0] * y - omega[1] * x
            along = air_x * axis[0] + air_y * axis[1] + air_z * axis[2]
            blades = density * surroundings.effectiveness[vehicle, rotor]
            static_thrust = blades * (thrust_n_s2 * speed * speed)
            thrust = static_thrust * axial_factor(-along, limit_m_s)
            if radius_m > 0.0 and down[2] > 0.0:  # not upside down
                height_m = -body["pos_ned_m"][2] - (down[0] * x + down[1] * y + down[2] * z)
                more = ground_effect(height_m, radius_m) - 1.0
                thrust *= 1.0 + down[2] * more  # full effect when level, none at 90 degrees
            # in the plane of the rotor
            air_x -= along * axis[0]
            air_y -= along * axis[1]
            air_z -= along * axis[2]
            rotor_x = blades * (-drag_n_s2_m * speed * air_x) + thrust * axis[0]
            rotor_y = blades * (-drag_n_s2_m * speed * air_y) + thrust * axis[1]
            rotor_z = blades * (-drag_n_s2_m * speed * air_z) + thrust * axis[2]
            force[0] += rotor_x
            force[1] += rotor_y
            force[2] += rotor_z
            # hub x force, then the rolling moment, then the reaction to the rotor's torque: that to a
            # counter-clockwise rotor turns the body clockwise seen from above
            rolling = turning * rolling_n_s2 * speed
            reaction = turning * moment_m * static_thrust
            torque[0] += y * rotor_z - z * rotor_y - blades * (rolling * air_x) - reaction * axis[0]
            torque[1] += z * rotor_x - x * rotor_z - blades * (rolling * air_y) - reaction * axis[1]
            torque[2] += x * rotor_y - y * rotor_x - blades * (rolling * air_z) - reaction * axis[2]
        north_n, east_n, down_n = in_ned(q, force[0], force[1], force[2])
        if model.body_drag_n_s_m[vehicle] > 0.0:
            body_drag_n_s_m = density * model.body_drag_n_s_m[vehicle]
            north_n -= body_drag_n_s_m * north_m_s
            east_n -= body_drag_n_s_m * east_m_s
            down_n -= body_drag_n_s_m * down_m_s
        force_ned_n[vehicle, 0], force_ned_n[vehicle, 1], force_ned_n[vehicle, 2] = north_n, east_n, down_n
        north_n_m, east_n_m, down_n_m = in_ned(q, torque[0], torque[1], torque[2])
        torque_ned_n_m[vehicle, 0], torque_ned_n_m[vehicle, 1] = north_n_m, east_n_m
        torque_ned_n_m[vehicle, 2] = down_n_m
    return force_ned_n, torque_ned_n_m
