"""STATUSTEXT and HEARTBEAT: what the vehicle says of itself in words and in one number."""

from pymavlink.dialects.v20 import common

from autopilot.commander.commander import Commander
from autopilot.commander.conditions import Condition
from autopilot.mavlink.codec import Message
from autopilot.mavlink.modes import FlightMode

_TEXT_BYTES = 50


def status_text(severity: int, text: str) -> Message:
    """STATUSTEXT; text beyond the message's 50 bytes is cut."""
    return common.MAVLink_statustext_message(severity, text.encode("ascii", "replace")[:_TEXT_BYTES])


def heartbeat(commander: Commander, conditions: int) -> Message:
    """HEARTBEAT of the autopilot, as a PX4 multicopter's."""
    if commander.armed:
        system_status = common.MAV_STATE_CRITICAL if commander.failsafe else common.MAV_STATE_ACTIVE
    else:
        system_status = common.MAV_STATE_STANDBY if conditions & _ATTITUDE else common.MAV_STATE_UNINIT
    armed = common.MAV_MODE_FLAG_SAFETY_ARMED if commander.armed else 0
    return common.MAVLink_heartbeat_message(
        common.MAV_TYPE_QUADROTOR,
        common.MAV_AUTOPILOT_PX4,
        commander.mode.base_mode | armed,
        commander.mode.custom_mode,
        system_status,
        3,
    )


def landed_state(commander: Commander) -> int:
    """MAV_LANDED_STATE: ground, take-off, air, landing."""
    state: int = common.MAV_LANDED_STATE_ON_GROUND
    if not commander.landed:
        state = _LANDED_STATE_IN_MODE.get(commander.mode, common.MAV_LANDED_STATE_IN_AIR)
    return state


_ATTITUDE = int(Condition.ATTITUDE)
_LANDED_STATE_IN_MODE = {
    FlightMode.TAKEOFF: common.MAV_LANDED_STATE_TAKEOFF,
    FlightMode.LAND: common.MAV_LANDED_STATE_LANDING,
    FlightMode.DESCEND: common.MAV_LANDED_STATE_LANDING,
}
