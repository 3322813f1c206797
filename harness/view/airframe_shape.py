"""The drawing of a vehicle in its body's frame (FRD): body, arms and rotors, from the airframe's file."""

import numpy as np

from foundation.airframe.description import Airframe
from foundation.types import Array

CIRCLE_POINTS = 25
SLOW, FAST = (60, 60, 60), (80, 220, 255)
"""Colours of a rotor that stands and of one at full speed"""


def arms(airframe: Airframe) -> list[Array]:
    """Return a line (2, 3) from the centre of mass to the hub of each rotor, m."""
    return [np.array([[0.0, 0.0, 0.0], rotor.position_frd_m]) for rotor in airframe.rotors]


def rotor_circles(airframe: Airframe) -> list[Array]:
    """Return the circle (`CIRCLE_POINTS`, 3) of each rotor's blade tips, m."""
    angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_POINTS)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    radius_m = airframe.propulsion.radius_m
    return [np.array(rotor.position_frd_m) + radius_m * circle for rotor in airframe.rotors]


def rotor_colours(airframe: Airframe, speeds_rad_s: Array) -> Array:
    """Return colours (T, rotors, 3), 0 to 255, of rotors with speeds (T, rotors)."""
    propulsion = airframe.propulsion
    share = np.clip(speeds_rad_s / (propulsion.idle_rad_s + propulsion.range_rad_s), 0.0, 1.0)
    colours: Array = np.array(SLOW) + share[..., None] * (np.array(FAST) - np.array(SLOW))
    return colours.astype(np.uint8)


def nose(airframe: Airframe) -> list[Array]:
    """Return a line (3, 3) that marks the front of the body, m."""
    length_m, width_m, _ = airframe.body.size_m
    tip = max(length_m, 0.3)
    return [np.array([[0.5 * tip, -0.25 * width_m, 0.0], [tip, 0.0, 0.0], [0.5 * tip, 0.25 * width_m, 0.0]])]
