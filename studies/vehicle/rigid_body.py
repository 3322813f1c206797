"""Rigid-body Iris with six degrees of freedom: an independent plant for controller tests, beside PyBullet.

Rotors, lag, drag and moments are modelled as in Gazebo-classic; wind is a force at the centre of mass. Unlike
the physics server's world it can start in any attitude. The estimate is the truth, optionally with the white
noise of gyro and accelerometer.
"""

import math

import numpy as np
from numba import njit

from foundation.geometry.rotations import quat_rotate, quat_rotate_inverse
from foundation.types import Array, EstimatorState

DT_S = 0.004
SUBSTEPS = 4
MASS_KG = 1.55
GRAVITY_M_S2 = 9.8066
INERTIA_KG_M2 = np.array((0.029125, 0.029125, 0.055225))
ROTOR_POS_FRD_M = np.array(
    ((0.13, 0.22, -0.023), (-0.13, -0.20, -0.023), (0.13, -0.22, -0.023), (-0.13, 0.20, -0.023))
)
ROTOR_CCW = np.array((1.0, 1.0, -1.0, -1.0))
THRUST_N_S2 = 5.84e-6
GYRO_NOISE_RAD_S = 0.0138
ACC_NOISE_M_S2 = 0.1007


@njit(cache=True)
def _step(
    state: Array, speed: Array, controls: Array, force_ned: Array, armed: float, acc_out: Array
) -> None:
    """``state``: position 0-2, velocity 3-5, quaternion 6-9, rates 10-12; semi-implicit Euler at 1 ms."""
    dt = DT_S / SUBSTEPS
    vel_before = state[3:6].copy()
    for _ in range(SUBSTEPS):
        q = state[6:10]
        vel_frd = quat_rotate_inverse(q, state[3:6])
        omega = state[10:13]
        force = np.zeros(3)
        torque = np.zeros(3)
        for i in range(4):
            target = armed * (1000.0 * controls[i] + 100.0)
            tau = 0.0125 if target > speed[i] else 0.025
            speed[i] += (1.0 - math.exp(-dt / tau)) * (target - speed[i])
            arm = ROTOR_POS_FRD_M[i]
            v = vel_frd + np.cross(omega, arm)
            thrust = THRUST_N_S2 * speed[i] ** 2
            v_axial = -v[2]
            part = np.array([-1.75e-4 * speed[i] * v[0], -1.75e-4 * speed[i] * v[1], 0.0])
            part[2] = -thrust * min(max(1.0 - v_axial / 25.0, 0.0), 1.0)
            force += part
            torque += np.cross(arm, part)
            torque[2] += ROTOR_CCW[i] * thrust * 0.06
            torque[0] -= ROTOR_CCW[i] * 1e-6 * speed[i] * v[0]
            torque[1] -= ROTOR_CCW[i] * 1e-6 * speed[i] * v[1]
        acc = (quat_rotate(q, force) + force_ned) / MASS_KG
        acc[2] += GRAVITY_M_S2
        omega += dt * (torque - np.cross(omega, INERTIA_KG_M2 * omega)) / INERTIA_KG_M2
        state[3:6] += dt * acc
        state[0:3] += dt * state[3:6]
        if state[2] >= 0.0 and state[5] >= 0.0:  # on the ground, which holds it as it stands
            state[2] = 0.0
            state[3:6] = 0.0
            omega[:] = 0.0
        half = 0.5 * dt
        w, x, y, z = q[0], q[1], q[2], q[3]
        q[0] -= half * (x * omega[0] + y * omega[1] + z * omega[2])
        q[1] += half * (w * omega[0] + y * omega[2] - z * omega[1])
        q[2] += half * (w * omega[1] + z * omega[0] - x * omega[2])
        q[3] += half * (w * omega[2] + x * omega[1] - y * omega[0])
        q /= math.sqrt((q**2).sum())
    acc_out[:] = (state[3:6] - vel_before) / DT_S


class Iris:
    """Armed vehicle; its rotors start at hover speed in the air, at idle speed on the ground."""

    def __init__(
        self, *, height_m: float = 0.0, q_ned_frd: Array | None = None, omega_frd_rad_s: Array | None = None,
        noise_seed: int | None = None,
    ) -> None:  # fmt: skip
        self._state = np.zeros(13)
        self.pos_ned_m, self.vel_ned_m_s = self._state[0:3], self._state[3:6]
        """(3,) relative to the start; down is 0 on the ground. These four are views of the state."""
        self.q_ned_frd, self.omega_frd_rad_s = self._state[6:10], self._state[10:13]
        """(4,) wxyz; (3,)"""
        self.pos_ned_m[2] = -height_m
        self.q_ned_frd[:] = (1.0, 0.0, 0.0, 0.0) if q_ned_frd is None else q_ned_frd
        if omega_frd_rad_s is not None:
            self.omega_frd_rad_s[:] = omega_frd_rad_s
        self._speed = np.full(4, 806.7 if height_m > 0.0 else 100.0)
        self._acc = np.zeros(3)
        self._noise = None if noise_seed is None else np.random.default_rng(noise_seed)
        self.time_us = 0

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle is on the ground."""
        return bool(self.pos_ned_m[2] >= 0.0)

    def step(self, controls: Array, force_ned_n: Array) -> None:
        """Advance by `DT_S` with constant motor controls (4,) and force (3,) at the centre of mass."""
        _step(self._state, self._speed, controls, force_ned_n, 1.0, self._acc)
        self.time_us += round(DT_S * 1e6)

    def estimate(self) -> EstimatorState:
        """Return the truth as an estimate, with inertial noise if ``noise_seed`` was given."""
        gyro_noise, acc_noise = np.zeros(3), np.zeros(3)
        if self._noise is not None:
            gyro_noise = GYRO_NOISE_RAD_S * self._noise.standard_normal(3)
            acc_noise = ACC_NOISE_M_S2 * self._noise.standard_normal(3)
        return estimate(
            pos_ned_m=self.pos_ned_m.copy(), vel_ned_m_s=self.vel_ned_m_s.copy(),
            q_ned_frd=self.q_ned_frd.copy(), omega_frd_rad_s=self.omega_frd_rad_s + gyro_noise,
            acc_ned_m_s2=self._acc + acc_noise,
        )  # fmt: skip


def estimate(**given: object) -> EstimatorState:
    """Return a valid estimate, by default level and at rest at the origin; arguments replace its fields."""
    zero = np.zeros(3)
    values: dict[str, object] = {
        "q_ned_frd": np.array((1.0, 0.0, 0.0, 0.0)), "vel_ned_m_s": zero, "pos_ned_m": zero,
        "omega_frd_rad_s": zero, "acc_ned_m_s2": zero, "gyro_bias_rad_s": zero, "accel_bias_m_s2": zero,
        "pos_std_m": zero, "vel_std_m_s": zero, "attitude_std_rad": zero,
        "origin_lat_deg": 47.0, "origin_lon_deg": 8.0, "origin_alt_m": 488.0,
        "attitude_valid": True, "velocity_valid": True, "position_valid": True, "height_valid": True,
        "reset_counter": 0,
    }  # fmt: skip
    return EstimatorState(**(values | given))  # type: ignore[arg-type]
