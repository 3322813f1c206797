"""Settings of navigation; each docstring names the PX4 parameter that a field stands for.

Defaults are PX4's. Angles are radians here where PX4 has degrees. The parameter table states them by PX4's
names.
"""

from math import radians
from typing import Annotated

from msgspec import Meta, Struct

NonNegative = Annotated[float, Meta(ge=0.0)]
Positive = Annotated[float, Meta(gt=0.0)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]


class ReturnParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The way home."""

    height_m: NonNegative = 30.0
    """RTL_RETURN_ALT: above home; whoever is higher stays as high (PX4: 60, and 30 on multicopters)"""
    descend_height_m: NonNegative = 10.0
    """RTL_DESCEND_ALT: above home, where it waits before it lands (PX4: 30, and 10 on multicopters)"""
    land_delay_s: Annotated[float, Meta(ge=-1.0)] = 0.0
    """RTL_LAND_DELAY: wait before landing; 0 lands without going by the waiting height, negative never"""
    cone_half_angle_rad: Annotated[float, Meta(ge=0.0, le=radians(90.0))] = radians(45.0)
    """RTL_CONE_ANG: of the cone above home that limits the climb near home; 0: no cone"""
    min_distance_m: NonNegative = 10.0
    """RTL_MIN_DIST: the cone counts within this distance of home"""


class ManualParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the sticks ask for."""

    tilt_max_rad: Annotated[float, Meta(gt=0.0, le=radians(70.0))] = radians(35.0)
    """MPC_MAN_TILT_MAX"""
    yaw_rate_max_rad_s: NonNegative = radians(150.0)
    """MPC_MAN_Y_MAX"""
    yaw_rate_filter_s: NonNegative = 0.08
    """MPC_MAN_Y_TAU"""
    thrust_min: Fraction = 0.08
    """MPC_MANTHR_MIN: in the air, of full thrust"""
    deadzone: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.1
    """MPC_HOLD_DZ: share of a stick's way about its centre that counts as centred"""
    xy_expo: Fraction = 0.6
    """MPC_XY_MAN_EXPO: cubic share of the curve"""
    z_expo: Fraction = 0.6
    """MPC_Z_MAN_EXPO"""
    yaw_expo: Fraction = 0.6
    """MPC_YAW_EXPO"""
    xy_speed_m_s: Positive = 10.0
    """MPC_VEL_MANUAL"""
    jerk_m_s3: Positive = 8.0
    """MPC_JERK_MAX"""
    hold_max_xy_m_s: NonNegative = 0.8
    """MPC_HOLD_MAX_XY: the place is held once the motion is slower; 0: from the stick's centring on"""
    hold_max_z_m_s: NonNegative = 0.6
    """MPC_HOLD_MAX_Z"""


class NavigationParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Heights, speeds and what counts as there."""

    takeoff_height_m: Positive = 2.5
    """MIS_TAKEOFF_ALT: above home, for a take-off without an altitude"""
    acceptance_m: Positive = 2.0
    """NAV_ACC_RAD: horizontal distance at which a place is reached (PX4: 10, and 2 on multicopters)"""
    altitude_acceptance_m: Positive = 0.8
    """NAV_MC_ALT_RAD: likewise in height"""
    yaw_acceptance_rad: Positive = radians(12.0)
    """MIS_YAW_ERR: likewise in heading, for places with a heading"""
    first_place_max_m: float = 10_000.0
    """MIS_DIST_1WP: from home to a mission's first place, beyond it is warned; 0 or less: any distance"""
    yaw_mode: Annotated[int, Meta(ge=0, le=3)] = 0
    """MPC_YAW_MODE: towards the place (0), towards home (1), away from home (2), along the path (3)"""
    land_speed_m_s: Positive = 0.7
    """MPC_LAND_SPEED"""
    land_slow_height_m: Positive = 5.0
    """MPC_LAND_ALT2: below this height over home at the landing speed"""
    land_fast_height_m: Positive = 10.0
    """MPC_LAND_ALT1: above this height at MPC_Z_V_AUTO_DN; between the two in proportion"""
    return_home: ReturnParams = ReturnParams()
    manual: ManualParams = ManualParams()
