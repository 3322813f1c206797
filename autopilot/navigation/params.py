"""Settings of navigation; each docstring begins with the corresponding PX4 parameter.

Defaults are PX4's. Angles are radians where PX4 uses degrees. The parameter table uses PX4's names.
"""

from math import radians
from typing import Annotated

from msgspec import Meta, Struct

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]


class ReturnParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Return mode."""

    height_m: NonNegative = 30.0
    """RTL_RETURN_ALT: return height above home; a higher vehicle keeps its height (PX4: 60, 30 on
    multicopters)"""
    descend_height_m: NonNegative = 10.0
    """RTL_DESCEND_ALT: waiting height above home before the landing (PX4: 30, and 10 on multicopters)"""
    land_delay_s: Annotated[float, Meta(ge=-1.0)] = 0.0
    """RTL_LAND_DELAY: wait before landing; 0 lands directly, without the waiting height; negative: never
    lands"""
    cone_half_angle_rad: Annotated[float, Meta(ge=0.0, le=radians(90.0))] = radians(45.0)
    """RTL_CONE_ANG: half angle of the cone above home that limits the climb near home; 0: no cone"""
    min_distance_m: NonNegative = 10.0
    """RTL_MIN_DIST: distance from home within which the cone applies"""


class ManualParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Manual modes."""

    tilt_max_rad: Annotated[float, Meta(gt=0.0, le=radians(70.0))] = radians(35.0)
    """MPC_MAN_TILT_MAX: greatest tilt of manual modes"""
    yaw_rate_max_rad_s: NonNegative = radians(150.0)
    """MPC_MAN_Y_MAX: greatest yaw rate of manual modes"""
    yaw_rate_filter_s: NonNegative = 0.08
    """MPC_MAN_Y_TAU: time constant of the yaw rate filter of manual modes"""
    thrust_min: Fraction = 0.08
    """MPC_MANTHR_MIN: least thrust in the air, as a fraction of full thrust"""
    deadzone: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.1
    """MPC_HOLD_DZ: fraction of a stick's range around its centre that counts as centred"""
    xy_expo: Fraction = 0.6
    """MPC_XY_MAN_EXPO: cubic fraction of the horizontal stick curve"""
    z_expo: Fraction = 0.6
    """MPC_Z_MAN_EXPO: cubic fraction of the throttle curve"""
    yaw_expo: Fraction = 0.6
    """MPC_YAW_EXPO: cubic fraction of the yaw stick curve"""
    xy_speed_m_s: Positive = 10.0
    """MPC_VEL_MANUAL: greatest horizontal speed of position mode"""
    jerk_m_s3: Positive = 8.0
    """MPC_JERK_MAX: greatest jerk of manual modes"""
    hold_max_xy_m_s: NonNegative = 0.8
    """MPC_HOLD_MAX_XY: speed below which the position is held once the sticks are centred; 0: at any speed"""
    hold_max_z_m_s: NonNegative = 0.6
    """MPC_HOLD_MAX_Z: vertical speed below which the height is held once the throttle is centred; 0: at any
    speed"""


class NavigationParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Heights, speeds and acceptance radii."""

    takeoff_height_m: Positive = 2.5
    """MIS_TAKEOFF_ALT: height above home of a take-off without an altitude"""
    acceptance_m: Positive = 2.0
    """NAV_ACC_RAD: horizontal distance at which a position is reached (PX4: 10, and 2 on multicopters)"""
    altitude_acceptance_m: Positive = 0.8
    """NAV_MC_ALT_RAD: vertical distance at which a position is reached"""
    yaw_acceptance_rad: Positive = radians(12.0)
    """MIS_YAW_ERR: heading error at which an item with a heading is reached"""
    first_place_max_m: float = 10_000.0
    """MIS_DIST_1WP: distance from home to a mission's first position above which a warning is sent; 0 or
    less: never"""
    yaw_mode: Annotated[int, Meta(ge=0, le=3)] = 0
    """MPC_YAW_MODE: heading towards the target (0), towards home (1), away from home (2), along the path
    (3)"""
    land_speed_m_s: Positive = 0.7
    """MPC_LAND_SPEED: landing speed"""
    land_slow_height_m: Positive = 5.0
    """MPC_LAND_ALT2: height above home below which the landing speed applies"""
    land_fast_height_m: Positive = 10.0
    """MPC_LAND_ALT1: height above home above which MPC_Z_V_AUTO_DN applies; interpolated in between"""
    return_home: ReturnParams = ReturnParams()
    manual: ManualParams = ManualParams()
