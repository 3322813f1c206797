"""Conditions of flight modes and of arming, and the reasons for which a request is refused."""

from enum import Enum, IntFlag

from pymavlink.dialects.v20 import common


class Condition(IntFlag):
    """Preconditions of modes and arming, as bits; `Commander.update` receives all that are met."""

    IMU = 1
    BARO = 2
    MAG = 4
    GPS = 8
    """The sensor's data are complete and fresh."""
    ATTITUDE = 16
    HEIGHT = 32
    VELOCITY = 64
    POSITION = 128
    """The estimate is valid, within COM_VEL_FS_EVH and COM_POS_FS_EPH."""
    HOME = 256
    """The home position is known."""
    SETPOINTS = 512
    """Offboard setpoints have arrived within COM_OF_LOSS_T."""
    MANUAL = 1024
    """Stick input has arrived within COM_RC_LOSS_T."""
    MISSION = 2048
    """There is a valid mission."""
    CHARGE = 4096
    """The remaining charge is at least COM_ARM_BAT_MIN."""


class Reason(Enum):
    """Why a request was refused: the text of the message and the MAV_RESULT of the reply.

    PX4 replies TEMPORARILY_REJECTED if the request may be granted later; MAVSDK reports that as
    CommandDenied.
    """

    NO_IMU = ("no inertial data", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_BARO = ("no barometer data", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_MAG = ("no compass data", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_GPS = ("no GPS fix", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_ATTITUDE = ("no attitude estimate", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_HEIGHT = ("no height estimate", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_VELOCITY = ("no velocity estimate", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_POSITION = ("no position estimate", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_HOME = ("no home position", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_SETPOINTS = ("no offboard setpoints", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_MANUAL = ("no manual control", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_MISSION = ("no valid mission", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_CHARGE = ("battery below COM_ARM_BAT_MIN", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NO_GROUND_STATION = ("no ground station", common.MAV_RESULT_TEMPORARILY_REJECTED)
    BATTERY_LOW = ("battery low", common.MAV_RESULT_TEMPORARILY_REJECTED)
    OUTSIDE_GEOFENCE = ("outside the geofence", common.MAV_RESULT_TEMPORARILY_REJECTED)
    ESTIMATOR_FAILED = ("estimator failed", common.MAV_RESULT_TEMPORARILY_REJECTED)
    TIPPED_OVER = ("not upright", common.MAV_RESULT_TEMPORARILY_REJECTED)
    IN_AIR = ("not landed", common.MAV_RESULT_TEMPORARILY_REJECTED)
    TERMINATED = ("flight was terminated", common.MAV_RESULT_DENIED)
    ON_GROUND = ("on the ground", common.MAV_RESULT_TEMPORARILY_REJECTED)
    NOT_ARMABLE = ("COM_ARMABLE is 0", common.MAV_RESULT_TEMPORARILY_REJECTED)
    MODE_CANNOT_ARM = ("this mode does not take off", common.MAV_RESULT_TEMPORARILY_REJECTED)
    MODE_UNAVAILABLE = ("this mode is not available", common.MAV_RESULT_DENIED)
    BAD_ARGUMENT = ("wrong parameter", common.MAV_RESULT_DENIED)

    def __init__(self, text: str, result: int) -> None:
        self.text = text
        self.result = result


ARMING_NEEDS = Condition.IMU | Condition.BARO | Condition.MAG | Condition.CHARGE
"""Needs of arming in addition to those of the mode; a mode that needs the position also needs the GPS."""

_REASONS = {condition: Reason[f"NO_{condition.name}"] for condition in Condition}


def first_missing(needs: int, conditions: int) -> Reason | None:
    """Return the reason for the most basic unmet need; None if all needs are met."""
    missing = needs & ~conditions
    return _REASONS[Condition(missing & -missing)] if missing else None


def all_missing(needs: int, conditions: int) -> list[Reason]:
    """Return a reason for each unmet need, the most basic first."""
    return [reason for condition, reason in _REASONS.items() if needs & ~conditions & condition]
