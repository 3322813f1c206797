"""The phases of a flight as the on-board application sees it."""

from enum import IntEnum


class FlightPhase(IntEnum):
    """What the application is about; its value is the custom_mode of the application's HEARTBEAT."""

    WAITING = 0
    """For the autopilot's position, origin and GPS."""
    LOCALISING = 1
    """On the ground, until the formation's shape is known."""
    ARMING = 2
    TAKE_OFF = 3
    """Under the autopilot's own take-off, up to the height of the hand-over."""
    JOINING = 4
    """On the way to the own place, in offboard."""
    ON_STATION = 5
    """Has been at the own place for long enough; kept from then on."""
    YIELDED = 6
    """Somebody else chose another mode, or a failsafe did. The application goes on with beacons and ranging,
    and takes over again if that somebody sets the mode to offboard."""
    LANDED = 7
    HELD = 8
    """On the ground as far as it is concerned, and not to go up before it is released: `OnboardConfig.hold`.
    Beacons and ranging go on; somebody else may fly the vehicle meanwhile."""
