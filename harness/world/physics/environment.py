"""The air and the ground around the vehicles, as far as they act on rotors and bodies."""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from msgspec import Meta, Struct

from autopilot.estimation import atmosphere
from foundation.types import Array

SEA_LEVEL_DENSITY_KG_M3 = 1.225
"""At which the constants of the rotors hold: Gazebo's motor model has no other."""


class EnvironmentConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's ``[environment]`` table."""

    density: Literal["standard", "isa"] = "standard"
    """``standard``: 1.225 kg/m^3 wherever the vehicles are, for which Gazebo's constants are. ``isa``: the
    standard atmosphere's at the vehicle's altitude above mean sea level; thrust, torques and drag go with
    it."""
    temperature_offset_k: Annotated[float, Meta(ge=-60.0, le=60.0)] = 0.0
    """Air temperature less the standard atmosphere's. The pressure stays the standard's, as it does for
    altimeters: warmer air is thinner by T / (T + offset), if ``density`` is "isa"."""
    ground_effect: bool = False
    """Whether rotors near the ground lift more, after Cheeseman and Bennett."""

    def density_ratio(self, altitude_m: Array) -> Array:
        """Density (n,) over the sea level's at altitudes (n,) above mean sea level (geopotential)."""
        if self.density == "standard":
            return np.ones_like(altitude_m)
        standard_k = atmosphere.temperature_k(altitude_m)
        thinner = standard_k / (standard_k + self.temperature_offset_k)
        return atmosphere.density_kg_m3(altitude_m) * thinner / SEA_LEVEL_DENSITY_KG_M3


STANDARD = EnvironmentConfig()


class Surroundings(NamedTuple):
    """What n vehicles meet over a step, in the form that compiled code takes."""

    air_vel_ned_m_s: Array
    """(n, 3) against the ground"""
    density_ratio: Array
    """(n,) over that of `SEA_LEVEL_DENSITY_KG_M3`"""
    height_m: Array
    """(n,) of the centres of mass above the ground"""
    effectiveness: Array
    """(n, 4) thrust and torques of each rotor over what they are when it is whole"""
