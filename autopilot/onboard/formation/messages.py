"""Constructors of the MAVLink messages that the application sends."""

from collections.abc import Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.components import AUTOPILOT_COMPONENT
from autopilot.mavlink.local_messages import PositionTarget
from autopilot.onboard.formation.guidance import Setpoint

COMMANDS = frozenset({common.MAVLINK_MSG_ID_COMMAND_LONG, common.MAVLINK_MSG_ID_COMMAND_INT})
_LOCAL_NED = int(common.MAV_FRAME_LOCAL_NED)
_NO_YAW = common.POSITION_TARGET_TYPEMASK_YAW_IGNORE | common.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
_NO_YAW_NOR_ACCELERATION = (
    _NO_YAW
    | common.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | common.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | common.POSITION_TARGET_TYPEMASK_AZ_IGNORE
)


def offboard_setpoint(setpoint: Setpoint, target_system: int, now_us: int) -> PositionTarget:
    """Return the setpoint message of a position, a velocity and, if given, an acceleration."""
    pos_ned_m, vel_ned_m_s, acc_ned_m_s2 = setpoint
    mask = _NO_YAW if acc_ned_m_s2 else _NO_YAW_NOR_ACCELERATION
    return PositionTarget(
        now_us // 1_000, target_system, AUTOPILOT_COMPONENT, _LOCAL_NED, mask,
        *pos_ned_m, *vel_ned_m_s, *(acc_ned_m_s2 or ()),
    )  # fmt: skip


def gain_requests(names: Sequence[str], target_system: int) -> list[common.MAVLink_message]:
    """Return a PARAM_REQUEST_READ of each possible name of the position loop's gain."""
    return [
        common.MAVLink_param_request_read_message(
            target_system, AUTOPILOT_COMPONENT, name.encode("ascii"), -1
        )
        for name in names
    ]


def acknowledgement(command: common.MAVLink_message, *, accepted: bool) -> common.MAVLink_message:
    """Return the COMMAND_ACK of a command to the application; without ``accepted`` it is unsupported."""
    result = common.MAV_RESULT_ACCEPTED if accepted else common.MAV_RESULT_UNSUPPORTED
    return common.MAVLink_command_ack_message(
        command.command, result, 255, 0, command.get_srcSystem(), command.get_srcComponent()
    )
