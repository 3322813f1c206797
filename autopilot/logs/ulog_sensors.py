"""ULog samples of sensors, battery and sticks of one vehicle, by field; None: there is none.

Device numbers are 0: simulated sensors have none.
"""

import math
from typing import TYPE_CHECKING

from autopilot.estimation import atmosphere
from autopilot.logs.ulog_messages import Values
from autopilot.mavlink.codec import Message

if TYPE_CHECKING:
    from autopilot.vehicle.vehicle import Vehicle

_UNKNOWN = 65_535
"""MAVLink's mark of an unknown value of 16 bits."""
_MOST_MAH = 65_535.0
"""Greatest capacity that battery_status can state."""
_PA_PER_HPA = 100.0
_KELVIN = 273.15
_AIR_J_KG_K = 287.1
"""Specific gas constant of dry air."""
_BY_MAVLINK = 2
"""manual_control_setpoint.data_source: the first MAVLink instance."""
_US_PER_S = 1_000_000


def gps(vehicle: "Vehicle") -> Values | None:
    """Return vehicle_gps_position and sensor_gps: the last HIL_GPS as received.

    It has no ellipsoidal height and no dilution of precision; its accuracies of velocity are not sent.
    """
    fix = vehicle.flight.gps
    if fix is None:
        return None
    time_us = vehicle.flight.gps_us
    return {
        "timestamp_sample": time_us, "time_utc_usec": vehicle.config.epoch_unix_us + time_us,
        "latitude_deg": fix.lat * 1e-7, "longitude_deg": fix.lon * 1e-7, "altitude_msl_m": fix.alt * 1e-3,
        "altitude_ellipsoid_m": fix.alt * 1e-3, "fix_type": fix.fix_type,
        "eph": _centi(fix.eph), "epv": _centi(fix.epv), "vel_m_s": _centi(fix.vel),
        "vel_n_m_s": fix.vn * 1e-2, "vel_e_m_s": fix.ve * 1e-2, "vel_d_m_s": fix.vd * 1e-2,
        "cog_rad": math.remainder(math.radians(_centi(fix.cog)), math.tau), "vel_ned_valid": True,
        "satellites_used": fix.satellites_visible,
    }  # fmt: skip


def air_data(sample: Message) -> Values:
    """Return vehicle_air_data of a HIL_SENSOR: height of the standard atmosphere, as in PX4."""
    pressure_pa = sample.abs_pressure * _PA_PER_HPA
    return {
        "timestamp_sample": sample.time_usec,
        "baro_alt_meter": atmosphere.altitude_m(pressure_pa) if pressure_pa > 0.0 else math.nan,
        "baro_pressure_pa": pressure_pa,
        "ambient_temperature": sample.temperature,
        "rho": pressure_pa / (_AIR_J_KG_K * (sample.temperature + _KELVIN)),
    }


def baro(sample: Message) -> Values:
    """Return sensor_baro of a HIL_SENSOR."""
    return {
        "timestamp_sample": sample.time_usec,
        "pressure": sample.abs_pressure * _PA_PER_HPA,
        "temperature": sample.temperature,
    }


def mag(sample: Message) -> Values:
    """Return vehicle_magnetometer of a HIL_SENSOR."""
    field_gauss = (sample.xmag, sample.ymag, sample.zmag)
    return {"timestamp_sample": sample.time_usec, "magnetometer_ga": field_gauss}


def battery(vehicle: "Vehicle") -> Values | None:
    """Return battery_status."""
    pack = vehicle.flight.battery
    if pack.sampled_us is None:
        return None
    left_s = pack.time_remaining_s
    return {
        "connected": True, "voltage_v": pack.voltage_v,
        "current_a": -1.0 if pack.current_a is None else pack.current_a,
        "discharged_mah": pack.consumed_mah, "remaining": pack.remaining, "scale": 1.0,
        "time_remaining_s": math.nan if left_s is None else left_s, "cell_count": pack.params.cells,
        "capacity": round(min(max(pack.params.capacity_mah, 0.0), _MOST_MAH)), "id": 1,
        "warning": int(pack.warning),
        "internal_resistance_estimate": pack.cell_resistance_ohm, "is_required": True,
    }  # fmt: skip


def sticks(vehicle: "Vehicle") -> Values | None:
    """Return manual_control_setpoint."""
    held = vehicle.manual.sticks
    if held is None:
        return None
    limit_us = round(vehicle.commander.params.manual_loss_s * _US_PER_S)
    return {
        "timestamp_sample": held.time_us, "valid": vehicle.manual.is_fresh(vehicle.flight.now_us, limit_us),
        "data_source": _BY_MAVLINK, "roll": held.roll, "pitch": held.pitch, "yaw": held.yaw,
        "throttle": 2.0 * held.throttle - 1.0,
    }  # fmt: skip


def _centi(value: int) -> float:
    """Return a value in hundredths; NaN if it is unknown."""
    return math.nan if value == _UNKNOWN else value * 1e-2
