"""Settings of arming, modes and failsafes; each docstring names the PX4 parameter that a field stands for."""

from typing import Annotated

from msgspec import Meta, Struct


class CommanderParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Time limits, and what is done about what goes wrong (values as in `autopilot.commander.failsafe`)."""

    armable: Annotated[int, Meta(ge=0, le=1)] = 1
    """COM_ARMABLE: 0 denies every arming that is not forced"""
    disarm_landed_s: Annotated[float, Meta(ge=-1.0, le=60.0)] = 2.0
    """COM_DISARM_LAND: from landing to disarming; negative never"""
    disarm_preflight_s: Annotated[float, Meta(ge=-1.0, le=60.0)] = 10.0
    """COM_DISARM_PRFLT: from arming to disarming without take-off; negative never"""
    spool_up_s: Annotated[float, Meta(ge=0.0, le=30.0)] = 1.0
    """COM_SPOOLUP_TIME: from arming until thrust may rise"""

    action_delay_s: Annotated[float, Meta(ge=0.0, le=25.0)] = 5.0
    """COM_FAIL_ACT_T: hold for this long before a failsafe returns or lands, for the pilot to take over"""
    offboard_loss_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 1.0
    """COM_OF_LOSS_T: age of the last offboard setpoint from which the stream counts as lost"""
    offboard_loss_action: Annotated[int, Meta(ge=0, le=7)] = 0
    """COM_OBL_RC_ACT: 0 position, 1 altitude, 2 stabilised, 3 return, 4 land, 5 hold, 6 terminate, 7 disarm;
    without sticks the first three hold"""
    gcs_loss_s: Annotated[float, Meta(ge=5.0, le=300.0)] = 10.0
    """COM_DL_LOSS_T: silence from which the ground station counts as lost"""
    gcs_loss_action: Annotated[int, Meta(ge=0, le=6)] = 0
    """NAV_DLL_ACT: 0 nothing, 1 hold, 2 return, 3 land, 5 terminate, 6 disarm"""
    gcs_loss_except: Annotated[int, Meta(ge=0, le=7)] = 0
    """COM_DLL_EXCEPT: modes that fly on, bits 0 mission, 1 other auto modes, 2 offboard"""
    manual_loss_s: Annotated[float, Meta(ge=0.0, le=35.0)] = 0.5
    """COM_RC_LOSS_T: silence from which the sticks count as lost"""
    manual_loss_action: Annotated[int, Meta(ge=0, le=6)] = 2
    """NAV_RCL_ACT: values as NAV_DLL_ACT's"""
    manual_loss_except: Annotated[int, Meta(ge=0, le=7)] = 0
    """COM_RCL_EXCEPT: bits as COM_DLL_EXCEPT's"""
    stick_takeover: Annotated[int, Meta(ge=0, le=3)] = 1
    """COM_RC_OVERRIDE: moved sticks take over, bits 0 from auto modes, 1 from offboard"""
    stick_takeover_fraction: Annotated[float, Meta(ge=0.05, le=0.8)] = 0.3
    """COM_RC_STICK_OV (there in percent): how far they must move"""

    low_battery_action: Annotated[int, Meta(ge=0, le=3)] = 0
    """COM_LOW_BAT_ACT: 0 warn, 1 return, 2 land when critical, 3 return when critical and land when empty"""
    arming_battery_min: Annotated[float, Meta(ge=-1.0, le=0.9)] = -1.0
    """COM_ARM_BAT_MIN: least remaining charge to arm with; negative: the critical level alone decides"""
    geofence_action: Annotated[int, Meta(ge=0, le=5)] = 2
    """GF_ACTION: 0 nothing, 1 warn, 2 hold, 3 return, 4 terminate, 5 land"""
    motor_failure_action: Annotated[int, Meta(ge=0, le=4)] = 0
    """COM_ACT_FAIL_ACT: 0 warn, 1 hold, 2 land, 3 return, 4 terminate"""
    gps_loss_action: Annotated[int, Meta(ge=0, le=3)] = 0
    """COM_GNSSLOSS_ACT: 0 warn, 1 return, 2 land, 3 terminate; without a position it descends in any case"""
    termination_breaker: Annotated[int, Meta(ge=0, le=121_212)] = 121_212
    """CBRK_FLIGHTTERM: 121212 keeps a vehicle that tips over from terminating its flight, 0 does not"""

    pos_error_max_m: Annotated[float, Meta(ge=-1.0, le=400.0)] = 5.0
    """COM_POS_FS_EPH: horizontal standard deviation beyond which the position counts as lost; -1 none"""
    vel_error_max_m_s: Annotated[float, Meta(ge=0.0, le=5.0)] = 1.0
    """COM_VEL_FS_EVH: likewise of the velocity; 0 none"""
