"""Air density and ground effect: the vehicles' environment."""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta, Struct

from autopilot.estimation import atmosphere
from foundation.airframe.description import SEA_LEVEL_DENSITY_KG_M3
from foundation.types import Array


class EnvironmentConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[environment]`` table."""

    density: Literal["standard", "isa"] = "standard"
    """``standard``: 1.225 kg/m^3 everywhere, as for Gazebo's constants. ``isa``: density of the standard
    atmosphere at the vehicle's altitude above mean sea level; thrust, torques and drag are proportional to
    it."""
    temperature_offset_k: Annotated[float, Meta(ge=-60.0, le=60.0)] = 0.0
    """Air temperature minus the standard atmosphere's. The pressure remains the standard's, as for
    altimeters. If ``density`` is "isa", the density is multiplied by T / (T + offset)."""
    ground_effect: bool = False
    """Whether rotors have more thrust near the ground, after Cheeseman and Bennett."""

    def density_ratio(self, altitude_m: Array) -> Array:
        """Return (n,) density over that at sea level, at geopotential altitudes (n,) above mean sea level."""
        if self.density == "standard":
            return np.ones_like(altitude_m)
        standard_k = atmosphere.temperature_k(altitude_m)
        thinner = standard_k / (standard_k + self.temperature_offset_k)
        return atmosphere.density_kg_m3(altitude_m) * thinner / SEA_LEVEL_DENSITY_KG_M3


STANDARD = EnvironmentConfig()


class Surroundings(NamedTuple):
    """Environment of n vehicles in a step, as an argument of kernels."""

    air_vel_ned_m_s: Array
    """(n, 3) relative to the ground"""
    density_ratio: Array
    """(n,) over `SEA_LEVEL_DENSITY_KG_M3`"""
    effectiveness: Array
    """(n, R) remaining fraction of each rotor's thrust and torques"""
