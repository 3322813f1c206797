"""What the modes and arming need, and the reasons that a request can be refused for. Data, no behaviour."""

from enum import Enum, IntFlag

from pymavlink.dialects.v20 import common

from autopilot.mavlink.modes import FlightMode


class Condition(IntFlag):
    """Something that holds at the moment; the commander is told all that hold whenever it is asked."""

    IMU = 1
    BARO = 2
    MAG = 4
    GPS = 8
    """A sensor's data are complete and fresh."""
    ATTITUDE = 16
    HEIGHT = 32
    VELOCITY = 64
    POSITION = 128
    """The estimator vouches for it, within COM_VEL_FS_EVH and COM_POS_FS_EPH."""
    HOME = 256
    """The place to return to is known."""
    SETPOINTS = 512
    """Offboard setpoints have come within COM_OF_LOSS_T."""
    MANUAL = 1024
    """Sticks have come within COM_RC_LOSS_T."""
    MISSION = 2048
    """There is a valid mission."""
    CHARGE = 4096
    """The battery has what COM_ARM_BAT_MIN asks for."""


class Reason(Enum):
    """Why a request was refused: the text for people and the MAV_RESULT for the asker.

    PX4 answers TEMPORARILY_REJECTED to whatever may be granted later; MAVSDK shows that as CommandDenied.
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


_FLIES_TO_A_PLACE = Condition.ATTITUDE | Condition.HEIGHT | Condition.VELOCITY | Condition.POSITION

MODE_NEEDS: dict[FlightMode, Condition] = {
    FlightMode.TAKEOFF: _FLIES_TO_A_PLACE,
    FlightMode.HOLD: _FLIES_TO_A_PLACE,
    FlightMode.MISSION: _FLIES_TO_A_PLACE | Condition.HOME | Condition.MISSION,
    FlightMode.RETURN: _FLIES_TO_A_PLACE | Condition.HOME,
    FlightMode.LAND: _FLIES_TO_A_PLACE,
    FlightMode.ORBIT: _FLIES_TO_A_PLACE,
    FlightMode.OFFBOARD: _FLIES_TO_A_PLACE | Condition.SETPOINTS,
    FlightMode.POSITION: _FLIES_TO_A_PLACE | Condition.MANUAL,
    FlightMode.ALTITUDE: Condition.ATTITUDE | Condition.HEIGHT | Condition.MANUAL,
    FlightMode.STABILIZED: Condition.ATTITUDE | Condition.MANUAL,
    FlightMode.DESCEND: Condition.ATTITUDE,
}
"""The modes that this autopilot flies."""

MODE_NEED_BITS = {mode: int(needs) for mode, needs in MODE_NEEDS.items()}
"""Plain integers: the test costs a tenth of the flag type's."""

ARMING_NEEDS = Condition.IMU | Condition.BARO | Condition.MAG | Condition.CHARGE
"""On top of what the mode needs; a mode that needs the position needs the GPS, too."""

MODES_TO_ARM_IN = frozenset({
    FlightMode.TAKEOFF, FlightMode.HOLD, FlightMode.MISSION, FlightMode.OFFBOARD,
    FlightMode.POSITION, FlightMode.ALTITUDE, FlightMode.STABILIZED,
})  # fmt: skip

MANUAL_MODES = frozenset({FlightMode.POSITION, FlightMode.ALTITUDE, FlightMode.STABILIZED})

AFTER_DISARMING: dict[FlightMode, FlightMode] = {
    FlightMode.TAKEOFF: FlightMode.HOLD,
    FlightMode.MISSION: FlightMode.HOLD,
    FlightMode.RETURN: FlightMode.HOLD,
    FlightMode.LAND: FlightMode.HOLD,
    FlightMode.ORBIT: FlightMode.HOLD,
    FlightMode.DESCEND: FlightMode.HOLD,
}
"""A flight's last mode must not be the next one's first."""

_REASONS = {condition: Reason[f"NO_{condition.name}"] for condition in Condition}


def arming_needs(mode: FlightMode) -> int:
    """Give the `Condition` bits without which a vehicle in this mode is not armed."""
    needs = int(ARMING_NEEDS) | MODE_NEED_BITS[mode]
    return needs | int(Condition.GPS) if needs & Condition.POSITION else needs


def first_missing(needs: int, conditions: int) -> Reason | None:
    """Find the most basic of the needs that the conditions leave unmet; None when all are met."""
    missing = needs & ~conditions
    return _REASONS[Condition(missing & -missing)] if missing else None


def all_missing(needs: int, conditions: int) -> list[Reason]:
    """Give a reason for each of the needs that the conditions leave unmet, the most basic first."""
    return [reason for condition, reason in _REASONS.items() if needs & ~conditions & condition]
