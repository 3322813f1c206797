"""The standard atmosphere below 11 km (ISO 2533), used to simulate barometers and to convert their readings.

All functions are pure and accept floats or float64 arrays; compiled code may call them with floats. Altitudes
are geopotential, above mean sea level.
"""

from typing import TypeVar

from numba.extending import register_jitable

from foundation.types import Array

FloatOrArray = TypeVar("FloatOrArray", float, Array)

GRAVITY_M_S2 = 9.80665
SEA_LEVEL_PRESSURE_PA = 101_325.0
SEA_LEVEL_TEMPERATURE_K = 288.15
LAPSE_RATE_K_M = 6.5e-3
AIR_GAS_CONSTANT_J_KG_K = 287.05287
_PRESSURE_EXPONENT = GRAVITY_M_S2 / (AIR_GAS_CONSTANT_J_KG_K * LAPSE_RATE_K_M)


@register_jitable
def temperature_k(altitude_m: FloatOrArray) -> FloatOrArray:
    """Return the air temperature."""
    return SEA_LEVEL_TEMPERATURE_K - LAPSE_RATE_K_M * altitude_m


@register_jitable
def pressure_pa(altitude_m: FloatOrArray) -> FloatOrArray:
    """Return the static pressure, p0 (T / T0)^(g / (R L))."""
    pressure: FloatOrArray = (
        SEA_LEVEL_PRESSURE_PA * (temperature_k(altitude_m) / SEA_LEVEL_TEMPERATURE_K) ** _PRESSURE_EXPONENT
    )
    return pressure


def density_kg_m3(altitude_m: FloatOrArray) -> FloatOrArray:
    """Return the density of dry air, p / (R T)."""
    return pressure_pa(altitude_m) / (AIR_GAS_CONSTANT_J_KG_K * temperature_k(altitude_m))


@register_jitable
def altitude_m(pressure_pa: FloatOrArray) -> FloatOrArray:
    """Return the pressure altitude, the inverse of ``pressure_pa``; pressures must be positive."""
    ratio = pressure_pa / SEA_LEVEL_PRESSURE_PA
    altitude: FloatOrArray = (1.0 - ratio ** (1.0 / _PRESSURE_EXPONENT)) * (
        SEA_LEVEL_TEMPERATURE_K / LAPSE_RATE_K_M
    )
    return altitude
