"""Settings of arming, modes and failsafes; each docstring begins with the corresponding PX4 parameter."""

from typing import Annotated

from msgspec import Meta, Struct


class CommanderParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Time limits and failsafe actions (values as in `autopilot.commander.failsafe`)."""

    armable: Annotated[int, Meta(ge=0, le=1)] = 1
    """COM_ARMABLE: 0 denies arming unless it is forced"""
    disarm_landed_s: Annotated[float, Meta(ge=-1.0, le=60.0)] = 2.0
    """COM_DISARM_LAND: delay from landing to disarming; negative: never"""
    disarm_preflight_s: Annotated[float, Meta(ge=-1.0, le=60.0)] = 10.0
    """COM_DISARM_PRFLT: delay from arming to disarming if the vehicle does not take off; negative: never"""
    spool_up_s: Annotated[float, Meta(ge=0.0, le=30.0)] = 1.0
    """COM_SPOOLUP_TIME: delay from arming until thrust may rise"""

    action_delay_s: Annotated[float, Meta(ge=0.0, le=25.0)] = 5.0
    """COM_FAIL_ACT_T: duration of the hold before a failsafe returns or lands; the pilot can take over"""
    offboard_loss_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 1.0
    """COM_OF_LOSS_T: age of the last offboard setpoint at which the stream counts as lost"""
    offboard_loss_action: Annotated[int, Meta(ge=0, le=7)] = 0
    """COM_OBL_RC_ACT: action on lost offboard setpoints: 0 position, 1 altitude, 2 stabilised, 3 return, 4
    land, 5 hold, 6 terminate, 7 disarm; 0 to 2 hold if there is no manual control"""
    gcs_loss_s: Annotated[float, Meta(ge=5.0, le=300.0)] = 10.0
    """COM_DL_LOSS_T: time without a heartbeat after which the ground station counts as lost"""
    gcs_loss_action: Annotated[int, Meta(ge=0, le=6)] = 0
    """NAV_DLL_ACT: action on a lost ground station: 0 nothing, 1 hold, 2 return, 3 land, 5 terminate, 6
    disarm"""
    gcs_loss_except: Annotated[int, Meta(ge=0, le=7)] = 0
    """COM_DLL_EXCEPT: modes that ignore a lost ground station; bits: 0 mission, 1 other auto modes, 2
    offboard"""
    manual_loss_s: Annotated[float, Meta(ge=0.0, le=35.0)] = 0.5
    """COM_RC_LOSS_T: time without stick input after which manual control counts as lost"""
    manual_loss_action: Annotated[int, Meta(ge=0, le=6)] = 2
    """NAV_RCL_ACT: action on lost manual control; values as in NAV_DLL_ACT"""
    manual_loss_except: Annotated[int, Meta(ge=0, le=7)] = 0
    """COM_RCL_EXCEPT: modes that ignore lost manual control; bits as in COM_DLL_EXCEPT"""
    stick_takeover: Annotated[int, Meta(ge=0, le=3)] = 1
    """COM_RC_OVERRIDE: stick movement takes over; bits: 0 from auto modes, 1 from offboard"""
    stick_takeover_fraction: Annotated[float, Meta(ge=0.05, le=0.8)] = 0.3
    """COM_RC_STICK_OV (there in percent): stick movement that takes over"""

    low_battery_action: Annotated[int, Meta(ge=0, le=3)] = 0
    """COM_LOW_BAT_ACT: action on low battery: 0 warn, 1 return, 2 land when critical, 3 return when critical
    and land when empty"""
    arming_battery_min: Annotated[float, Meta(ge=-1.0, le=0.9)] = -1.0
    """COM_ARM_BAT_MIN: least remaining charge for arming; negative: only the critical level counts"""
    geofence_action: Annotated[int, Meta(ge=0, le=5)] = 2
    """GF_ACTION: action on a breach: 0 nothing, 1 warn, 2 hold, 3 return, 4 terminate, 5 land"""
    motor_failure_action: Annotated[int, Meta(ge=0, le=4)] = 0
    """COM_ACT_FAIL_ACT: action on motor failure: 0 warn, 1 hold, 2 land, 3 return, 4 terminate"""
    gps_loss_action: Annotated[int, Meta(ge=0, le=3)] = 0
    """COM_GNSSLOSS_ACT: action on GPS loss: 0 warn, 1 return, 2 land, 3 terminate; without a position
    estimate it always descends"""
    termination_breaker: Annotated[int, Meta(ge=0, le=121_212)] = 121_212
    """CBRK_FLIGHTTERM: 121212 disables flight termination of a vehicle that tips over, 0 enables it"""

    pos_error_max_m: Annotated[float, Meta(ge=-1.0, le=400.0)] = 5.0
    """COM_POS_FS_EPH: horizontal standard deviation above which the position counts as lost; -1: no limit"""
    vel_error_max_m_s: Annotated[float, Meta(ge=0.0, le=5.0)] = 1.0
    """COM_VEL_FS_EVH: standard deviation above which the velocity counts as lost; 0: no limit"""
