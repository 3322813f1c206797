"""Flight phases of the on-board application."""

from enum import IntEnum


class FlightPhase(IntEnum):
    """Phase of a flight; its value is the custom_mode of the application's HEARTBEAT."""

    WAITING = 0
    """Waits for the autopilot's position, origin and GPS."""
    LOCALISING = 1
    """Waits on the ground until the formation's shape is known."""
    ARMING = 2
    TAKE_OFF = 3
    """The autopilot's own take-off, up to the height of the hand-over."""
    JOINING = 4
    """Flies to the own place, in offboard mode."""
    ON_STATION = 5
    """Has been at its place for the hold time; the phase is kept from then on."""
    YIELDED = 6
    """A user or a failsafe has selected another mode. The application continues beacons and ranging, and
    takes over again when the mode is set to offboard."""
    LANDED = 7
    HELD = 8
    """Waits for its release before take-off: `OnboardConfig.hold`. Beacons and ranging continue; a user may
    fly the vehicle meanwhile."""
