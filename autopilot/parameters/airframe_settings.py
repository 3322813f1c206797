"""Settings of a vehicle that follow from its airframe: the values that its parameters start from."""

from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from autopilot.control.airframe_gains import control_params
from autopilot.parameters.table import Settings
from foundation.airframe.description import Airframe
from foundation.airframe.files import IRIS

_LEAST_CURRENT_SHARE = 0.5
"""A motor has failed if it draws less than this share of the current in hover at full thrust, and
proportionally less below."""
_MOST_AVERAGE_A, _MOST_PER_THRUST_A = 500.0, 50.0
"""Greatest values of BAT_AVRG_CURRENT and FD_ACT_MOT_C2T."""
_TYPE_OF_ROTORS = {
    4: common.MAV_TYPE_QUADROTOR,
    6: common.MAV_TYPE_HEXAROTOR,
    8: common.MAV_TYPE_OCTOROTOR,
    10: common.MAV_TYPE_DECAROTOR,
    12: common.MAV_TYPE_DODECAROTOR,
}
_OF_NO_PX4_AIRFRAME = 0


def settings_of(airframe: Airframe) -> Settings:
    """Return the settings of a vehicle; those of the Iris are the defaults.

    Raises ValueError for an airframe that cannot control thrust, roll, pitch and yaw.
    """
    base, battery = Settings(), airframe.battery
    return replace(
        base,
        control=control_params(airframe),
        battery=replace(
            base.battery,
            cells=battery.cells,
            capacity_mah=battery.capacity_mah,
            average_current_a=min(airframe.average_current_a, _MOST_AVERAGE_A),
        ),
        battery_sim=replace(
            base.battery_sim,
            resistance_ohm=battery.cell_resistance_ohm,
            avionics_current_a=battery.avionics_current_a,
            hover_motor_current_a=airframe.motor_current_a,
            hover_rotor_rad_s=airframe.current_speed_rad_s,
        ),
        failure_detector=replace(
            base.failure_detector,
            motor_current_per_thrust_a=min(
                _LEAST_CURRENT_SHARE * airframe.motor_current_a, _MOST_PER_THRUST_A
            ),
        ),
    )


def mav_type(airframe: Airframe) -> int:
    """Return the MAV_TYPE of a multicopter by its number of rotors."""
    found: int = _TYPE_OF_ROTORS.get(len(airframe.rotors), common.MAV_TYPE_GENERIC)
    return found


def stated_of(airframe: Airframe) -> dict[str, float]:
    """Return the values of parameters without effect that describe the airframe."""
    stated: dict[str, float] = {"CA_ROTOR_COUNT": len(airframe.rotors), "MAV_TYPE": mav_type(airframe)}
    if airframe != IRIS:
        stated["SYS_AUTOSTART"] = _OF_NO_PX4_AIRFRAME
    return stated
