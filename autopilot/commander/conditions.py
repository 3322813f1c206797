"""What the modes and arming need, and the reasons that a request can be refused for. Data, no behaviour."""

from enum import Enum, IntFlag

from pymavlink.dialects.v20 import common

from autopilot.mavlink.modes import FlightMode


class Condition(IntFlag):
    """Something that holds at the moment; the commander is told all that hold at every step."""

    IMU = 1
    BARO = 2
    MAG = 4
    GPS = 8
    """A sensor's data are complete and fresh."""
    ATTITUDE = 16
    HEIGHT = 32
    VELOCITY = 64
    POSITION = 128
    """The estimator vouches for it."""
    SETPOINTS = 256
    """Offboard setpoints have come within COM_OF_LOSS_T."""


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
    NO_SETPOINTS = ("no offboard setpoints", common.MAV_RESULT_TEMPORARILY_REJECTED)
    IN_AIR = ("not landed", common.MAV_RESULT_TEMPORARILY_REJECTED)
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
    FlightMode.LAND: _FLIES_TO_A_PLACE,
    FlightMode.OFFBOARD: _FLIES_TO_A_PLACE | Condition.SETPOINTS,
    FlightMode.DESCEND: Condition.ATTITUDE | Condition.HEIGHT,
}
"""The modes that this autopilot flies."""

ARMING_NEEDS = Condition.IMU | Condition.BARO | Condition.MAG | Condition.GPS
"""On top of what the mode needs."""

MODES_TO_ARM_IN = frozenset({FlightMode.TAKEOFF, FlightMode.HOLD, FlightMode.OFFBOARD})

FALLBACKS: dict[FlightMode, tuple[FlightMode, ...]] = {
    FlightMode.OFFBOARD: (FlightMode.HOLD, FlightMode.LAND, FlightMode.DESCEND),
    FlightMode.TAKEOFF: (FlightMode.LAND, FlightMode.DESCEND),
    FlightMode.HOLD: (FlightMode.LAND, FlightMode.DESCEND),
    FlightMode.LAND: (FlightMode.DESCEND,),
    FlightMode.DESCEND: (),
}
"""When a mode's needs are no longer met in flight: the first of these whose needs are, else the last."""

AFTER_DISARMING: dict[FlightMode, FlightMode] = {
    FlightMode.TAKEOFF: FlightMode.HOLD,
    FlightMode.LAND: FlightMode.HOLD,
    FlightMode.DESCEND: FlightMode.HOLD,
}
"""A flight's last mode must not be the next one's first."""

_REASONS = {
    Condition.IMU: Reason.NO_IMU,
    Condition.BARO: Reason.NO_BARO,
    Condition.MAG: Reason.NO_MAG,
    Condition.GPS: Reason.NO_GPS,
    Condition.ATTITUDE: Reason.NO_ATTITUDE,
    Condition.HEIGHT: Reason.NO_HEIGHT,
    Condition.VELOCITY: Reason.NO_VELOCITY,
    Condition.POSITION: Reason.NO_POSITION,
    Condition.SETPOINTS: Reason.NO_SETPOINTS,
}


def first_missing(needs: int, conditions: int) -> Reason | None:
    """Find the most basic of the needs that the conditions leave unmet; None when all are met."""
    missing = needs & ~conditions
    return _REASONS[Condition(missing & -missing)] if missing else None
