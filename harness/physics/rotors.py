"""Forces and torques of the rotors: kernels over all vehicles at once.

The model is PX4's `gazebo_motor_model`: thrust and yaw torque by the square of the speed, in-plane drag and
rolling moment after P. Martin and E. Salaün, "The true role of accelerometer feedback in quadrotor control",
ICRA 2010.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from autopilot.estimation.rotation import quat_rotate, quat_rotate_inverse
from autopilot.types import Array
from harness.physics.frames import frd_from_flu
from harness.physics.model import VehicleModel


class RotorKernelModel(NamedTuple):
    """`VehicleModel` in the form that compiled code takes."""

    hubs_frd_m: Array
    """(4, 3)"""
    turning: Array
    """(4,) +1 counter-clockwise from above"""
    thrust_n_s2: float
    moment_m: float
    drag_n_s2_m: float
    rolling_n_s2: float
    axial_speed_limit_m_s: float
    armed_speed_rad_s: float
    control_speed_rad_s: float
    rise: float
    """Part of a motor's speed error that is left after one step while it rises."""
    fall: float


def kernel_model(model: VehicleModel, *, step_s: float) -> RotorKernelModel:
    """Numbers of the model for steps of that length."""
    return RotorKernelModel(
        hubs_frd_m=frd_from_flu(model.rotor_hubs_flu_m),
        turning=np.array(model.rotor_turning),
        thrust_n_s2=model.thrust_n_s2,
        moment_m=model.moment_m,
        drag_n_s2_m=model.rotor_drag_n_s2_m,
        rolling_n_s2=model.rolling_moment_n_s2,
        axial_speed_limit_m_s=model.axial_speed_limit_m_s,
        armed_speed_rad_s=model.armed_speed_rad_s,
        control_speed_rad_s=model.control_speed_rad_s,
        rise=math.exp(-step_s / model.motor_rise_s),
        fall=math.exp(-step_s / model.motor_fall_s),
    )


@njit(cache=True)
def rotor_speeds(
    model: RotorKernelModel, speed_rad_s: Array, controls: Array, powered: NDArray[np.bool_]
) -> Array:
    """Rotor speeds (n, 4) one step on: a first-order lag towards what controls (n, 4) ask.

    Controls are limited to 0..1, not-a-number counting as 0; vehicles whose ``powered`` (n,) is False spin
    down.
    """
    after_rad_s = np.empty_like(speed_rad_s)
    for vehicle in range(speed_rad_s.shape[0]):
        for rotor in range(4):
            target_rad_s = 0.0
            if powered[vehicle]:
                control = controls[vehicle, rotor]
                if not control > 0.0:  # not-a-number, too
                    control = 0.0
                target_rad_s = model.armed_speed_rad_s + model.control_speed_rad_s * min(control, 1.0)
            now_rad_s = speed_rad_s[vehicle, rotor]
            left = model.rise if target_rad_s > now_rad_s else model.fall
            after_rad_s[vehicle, rotor] = target_rad_s + left * (now_rad_s - target_rad_s)
    return after_rad_s


@njit(cache=True)
def wrenches(
    model: RotorKernelModel,
    q_ned_frd: Array,
    vel_ned_m_s: Array,
    omega_ned_rad_s: Array,
    rotor_speed_rad_s: Array,
) -> tuple[Array, Array]:
    """Force and torque on each vehicle for Bullet to apply: (n, 3) newtons and (n, 3) newton metres, NED.

    The torque is about the centre of mass, the velocities are its own. The air is at rest.
    """
    vehicles = q_ned_frd.shape[0]
    force_ned_n = np.empty((vehicles, 3))
    torque_ned_n_m = np.empty((vehicles, 3))
    force = np.empty(3)
    torque = np.empty(3)
    for vehicle in range(vehicles):
        vel = quat_rotate_inverse(q_ned_frd[vehicle], vel_ned_m_s[vehicle])
        omega = quat_rotate_inverse(q_ned_frd[vehicle], omega_ned_rad_s[vehicle])
        force[:] = 0.0
        torque[:] = 0.0
        for rotor in range(4):
            x, y, z = model.hubs_frd_m[rotor]
            turning = model.turning[rotor]
            speed = rotor_speed_rad_s[vehicle, rotor]
            air_x = vel[0] + omega[1] * z - omega[2] * y
            air_y = vel[1] + omega[2] * x - omega[0] * z
            air_z = vel[2] + omega[0] * y - omega[1] * x
            static_thrust = model.thrust_n_s2 * speed * speed
            # full in descent too: Gazebo's plugin takes |air_z|, and so makes every descent run away
            up = static_thrust * min(max(1.0 + air_z / model.axial_speed_limit_m_s, 0.0), 1.0)
            drag_x = -model.drag_n_s2_m * speed * air_x
            drag_y = -model.drag_n_s2_m * speed * air_y
            force[0] += drag_x
            force[1] += drag_y
            force[2] -= up
            # hub x force, then the rolling moment; the reaction to a counter-clockwise rotor turns the body
            # clockwise seen from above, which is the positive sense about FRD's z
            torque[0] += -y * up - z * drag_y - turning * model.rolling_n_s2 * speed * air_x
            torque[1] += z * drag_x + x * up - turning * model.rolling_n_s2 * speed * air_y
            torque[2] += x * drag_y - y * drag_x + turning * model.moment_m * static_thrust
        force_ned_n[vehicle] = quat_rotate(q_ned_frd[vehicle], force)
        torque_ned_n_m[vehicle] = quat_rotate(q_ned_frd[vehicle], torque)
    return force_ned_n, torque_ned_n_m
