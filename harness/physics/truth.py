"""What the physics knows about the vehicles after a step; sensors, recorder and emulator read it."""

from dataclasses import dataclass

from autopilot.types import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """State of n vehicles at the end of a step, and means over that step.

    The arrays are never written again.
    """

    pos_ned_m: Array
    """(n, 3) centre of mass, from the site's origin; the ground is down = 0."""
    vel_ned_m_s: Array
    """(n, 3)"""
    q_ned_frd: Array
    """(n, 4) wxyz"""
    omega_frd_rad_s: Array
    """(n, 3)"""
    rotor_speed_rad_s: Array
    """(n, 4)"""
    acc_ned_m_s2: Array
    """(n, 3) change of velocity over the step, per second: contact forces are in it."""
    specific_force_frd_m_s2: Array
    """(n, 3) what an accelerometer at the centre of mass would report of the step: acceleration less gravity,
    in the body axes half-way through it; (0, 0, -9.8066) standing level. Before the first step: as if held
    still."""
    mean_omega_frd_rad_s: Array
    """(n, 3) what a gyroscope would report of the step: mean body rate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """Two vehicles that touched during the last step."""

    first: int
    second: int
    """The larger of the two numbers."""
    pos_ned_m: tuple[float, float, float]
    """One point of contact."""
