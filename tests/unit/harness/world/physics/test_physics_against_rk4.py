"""The world compared with an independent implementation that shares only the vehicle's parameters.

Gazebo's axes (ENU, FLU), vectors as the plugin has them, and a fourth-order integrator with a fine step.
"""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from foundation.airframe.files import IRIS
from harness.world.physics.world import World

STEP_S = 0.004
HUBS_FLU_M = np.array(
    [(0.13, -0.22, 0.023), (-0.13, 0.20, 0.023), (0.13, 0.22, 0.023), (-0.13, -0.20, 0.023)]
)
TURNING = np.array((1.0, 1.0, -1.0, -1.0))
INERTIA = np.diag((0.029125, 0.029125, 0.055225))
UP = np.array((0.0, 0.0, 1.0))
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_FROM_FRD = np.diag((1.0, -1.0, -1.0))


def derivative(state, rotor_speed, wind_enu_n):
    """Return d/dt of (position ENU, velocity ENU, rotation matrix ENU<-FLU, body rates FLU)."""
    _, vel, dcm, omega = state
    force_enu = wind_enu_n + 1.55 * 9.8066 * -UP
    torque_flu = np.zeros(3)
    for hub, turning, speed in zip(HUBS_FLU_M, TURNING, rotor_speed, strict=True):
        hub_vel = dcm.T @ vel + np.cross(omega, hub)
        parallel = hub_vel @ UP * UP
        perpendicular = hub_vel - parallel
        thrust = 5.84e-6 * speed**2
        force = thrust * np.clip(1.0 - parallel[2] / 25.0, 0.0, 1.2) * UP - speed * 1.75e-4 * perpendicular
        torque_flu += (
            np.cross(hub, force) - turning * thrust * 0.06 * UP - speed * turning * 1e-6 * perpendicular
        )
        force_enu = force_enu + dcm @ force
    skew = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
    omega_dot = np.linalg.solve(INERTIA, torque_flu - np.cross(omega, INERTIA @ omega))
    return vel, force_enu / 1.55, dcm @ skew, omega_dot


def rk4(state, rotor_speed, wind_enu_n, dt):
    def moved(k, h):
        return tuple(s + h * d for s, d in zip(state, k, strict=True))

    k1 = derivative(state, rotor_speed, wind_enu_n)
    k2 = derivative(moved(k1, dt / 2), rotor_speed, wind_enu_n)
    k3 = derivative(moved(k2, dt / 2), rotor_speed, wind_enu_n)
    k4 = derivative(moved(k3, dt), rotor_speed, wind_enu_n)
    return tuple(
        s + dt / 6 * (a + 2 * b + 2 * c + d) for s, a, b, c, d in zip(state, k1, k2, k3, k4, strict=True)
    )


def test_a_rough_flight_agrees_with_a_fourth_order_integrator_in_gazebos_frames():
    """1.2 s with tilts past 40 degrees and spins past 2 rad/s; twice the measured differences."""
    yaw_rad = 0.5
    start_ned_m = (1.0, 2.0, -60.0)
    dcm_ned_frd = Rotation.from_euler("z", yaw_rad).as_matrix()
    state = (
        ENU_FROM_NED @ start_ned_m,
        np.zeros(3),
        ENU_FROM_NED @ dcm_ned_frd @ FLU_FROM_FRD.T,
        np.zeros(3),
    )
    wind_ned_n = np.array((2.0, -1.0, 0.3))
    controls = [
        (0.72, 0.72, 0.72, 0.72),
        (0.80, 0.70, 0.68, 0.66),
        (0.59, 0.72, 0.74, 0.83),
        (0.8, 0.8, 0.7, 0.7),
    ]
    rotor_speed = np.zeros(4)
    largest_tilt_rad = largest_rate_rad_s = 0.0
    with World(airframes=[IRIS], spawn_pos_ned_m=start_ned_m, spawn_yaw_rad=yaw_rad, step_us=4_000) as world:
        for step in range(300):
            control = np.array(controls[step // 75])
            world.step(control[None], np.ones(1, bool), wind_ned_n[None], rotors_stopped=np.zeros(1, bool))
            target = 100.0 + 1000.0 * control
            time_constant_s = np.where(target > rotor_speed, 0.0125, 0.025)
            rotor_speed = target + np.exp(-STEP_S / time_constant_s) * (rotor_speed - target)
            for _ in range(4):
                state = rk4(state, rotor_speed, ENU_FROM_NED @ wind_ned_n, STEP_S / 4)
            largest_tilt_rad = max(largest_tilt_rad, math.acos(np.clip(state[2][2, 2], -1, 1)))
            largest_rate_rad_s = max(largest_rate_rad_s, np.linalg.norm(state[3]))
        truth = world.truth
    assert largest_tilt_rad > math.radians(40.0)
    assert largest_rate_rad_s > 2.0
    pos_enu_m, vel_enu_m_s, dcm_enu_flu, omega_flu_rad_s = state
    np.testing.assert_allclose(truth.rotor_speed_rad_s[0], rotor_speed, rtol=1e-12)
    np.testing.assert_allclose(ENU_FROM_NED @ truth.pos_ned_m[0], pos_enu_m, atol=0.0056)
    np.testing.assert_allclose(ENU_FROM_NED @ truth.vel_ned_m_s[0], vel_enu_m_s, atol=0.016)
    np.testing.assert_allclose(FLU_FROM_FRD @ truth.omega_frd_rad_s[0], omega_flu_rad_s, atol=0.004)
    dcm = Rotation.from_quat(truth.q_ned_frd[0], scalar_first=True).as_matrix()
    apart = Rotation.from_matrix(dcm_enu_flu.T @ ENU_FROM_NED @ dcm @ FLU_FROM_FRD.T)
    assert apart.magnitude() < math.radians(0.24)
