"""ULog samples of arming, mode, landing and failsafes of one vehicle, by field, with PX4's numbers."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from autopilot.commander.arming_checks import Condition
from autopilot.commander.failsafe import Cause
from autopilot.commander.land_detector import LandStage
from autopilot.logs.ulog_messages import Values
from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.mavlink.modes import EXTERNAL_MODES, FlightMode

if TYPE_CHECKING:
    from autopilot.vehicle.vehicle import Vehicle

NAV_STATES = {
    FlightMode.MANUAL: 0, FlightMode.ALTITUDE: 1, FlightMode.POSITION: 2, FlightMode.MISSION: 3,
    FlightMode.HOLD: 4, FlightMode.READY: 4, FlightMode.RETURN: 5, FlightMode.ACRO: 10,
    FlightMode.DESCEND: 12, FlightMode.OFFBOARD: 14, FlightMode.STABILIZED: 15, FlightMode.TAKEOFF: 17,
    FlightMode.LAND: 18,
    **{mode: 23 + number for number, mode in enumerate(EXTERNAL_MODES)},
}  # fmt: skip
"""PX4's vehicle_status.nav_state"""
OTHER_STATE = 21
"""Orbit, the only other mode; 21 is NAVIGATION_STATE_ORBIT."""
STANDBY, ARMED = 1, 2
_ROTARY_WING = 1
_MOTOR_FAILURE = 128
"""vehicle_status.failure_detector_status: a motor."""
_NEEDS = {
    "mode_req_angular_velocity": Condition.IMU, "mode_req_attitude": Condition.ATTITUDE,
    "mode_req_local_alt": Condition.HEIGHT, "mode_req_local_position": Condition.POSITION,
    "mode_req_global_position": Condition.GPS, "mode_req_mission": Condition.MISSION,
    "mode_req_offboard_signal": Condition.SETPOINTS, "mode_req_home_position": Condition.HOME,
    "mode_req_manual_control": Condition.MANUAL,
}  # fmt: skip
"""Condition of each mask of modes in failsafe_flags."""
_UNMET = {
    "angular_velocity_invalid": Condition.IMU, "attitude_invalid": Condition.ATTITUDE,
    "local_altitude_invalid": Condition.HEIGHT, "local_position_invalid": Condition.POSITION,
    "local_position_invalid_relaxed": Condition.POSITION, "local_velocity_invalid": Condition.VELOCITY,
    "global_position_invalid": Condition.POSITION, "global_position_invalid_relaxed": Condition.POSITION,
    "auto_mission_missing": Condition.MISSION, "offboard_control_signal_lost": Condition.SETPOINTS,
    "home_position_invalid": Condition.HOME, "manual_control_signal_lost": Condition.MANUAL,
}  # fmt: skip
"""Condition without which a flag is set."""
_CAUSES = {
    "gcs_connection_lost": Cause.GCS_LOST, "geofence_breached": Cause.GEOFENCE,
    "fd_critical_failure": Cause.TIPPED_OVER, "fd_motor_failure": Cause.MOTOR_FAILED,
}  # fmt: skip
"""Cause with which a flag is set."""


def nav_state(mode: FlightMode) -> int:
    """Return PX4's number of a mode."""
    return NAV_STATES.get(mode, OTHER_STATE)


def status(vehicle: "Vehicle", entered_us: int) -> Values:
    """Return vehicle_status; ``entered_us``: when the present mode began."""
    flight, commander = vehicle.flight, vehicle.commander
    state = nav_state(commander.mode)
    return {
        "armed_time": flight.armed_us if commander.armed else 0,
        "takeoff_time": 0 if vehicle.pilot.landed else flight.took_off_us,
        "nav_state_timestamp": entered_us, "nav_state": state, "nav_state_user_intention": state,
        "arming_state": ARMED if commander.armed else STANDBY, "vehicle_type": _ROTARY_WING,
        "failure_detector_status": _MOTOR_FAILURE if flight.causes & int(Cause.MOTOR_FAILED) else 0,
        "failsafe": commander.failsafe, "gcs_connection_lost": bool(flight.causes & int(Cause.GCS_LOST)),
        "system_type": flight.mav_type, "system_id": vehicle.config.instance + 1,
        "component_id": AUTOPILOT_COMPONENT, "safety_off": True, "power_input_valid": True,
        "pre_flight_checks_pass": commander.armed or not commander.arming_refusals(),
    }  # fmt: skip


def landed(vehicle: "Vehicle") -> Values:
    """Return vehicle_land_detected: the stages of the detector."""
    stage = vehicle.pilot.land_stage
    return {
        "ground_contact": stage >= LandStage.GROUND_CONTACT,
        "maybe_landed": stage >= LandStage.MAYBE_LANDED,
        "landed": vehicle.pilot.landed,
        "at_rest": vehicle.pilot.landed and not vehicle.commander.armed,
    }


def failsafe_flags(vehicle: "Vehicle", masks: Mapping[str, int]) -> Values:
    """Return failsafe_flags; ``masks`` are those of `mode_masks`."""
    flight = vehicle.flight
    conditions, causes = flight.conditions, flight.causes
    return (
        dict(masks)
        | {name: not conditions & needed for name, needed in _UNMET_BITS}
        | {name: bool(causes & cause) for name, cause in _CAUSE_BITS}
        | {"battery_warning": int(flight.battery.warning)}
    )


def mode_masks(vehicle: "Vehicle") -> dict[str, int]:
    """Return for each condition the modes that need it, a bit for each nav_state."""
    needs = vehicle.commander.modes.needs
    return {
        name: sum({1 << nav_state(mode) for mode, bits in needs.items() if bits & int(condition)})
        for name, condition in _NEEDS.items()
    }


# plain integers: operations on the flag types take longer than the rest
_UNMET_BITS = tuple((name, int(condition)) for name, condition in _UNMET.items())
_CAUSE_BITS = tuple((name, int(cause)) for name, cause in _CAUSES.items())
