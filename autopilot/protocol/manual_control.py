"""MANUAL_CONTROL, the sticks of a joystick or of a ground station's thumb pads, with the time they came."""

import math
from collections.abc import Sequence

from pymavlink.dialects.v20 import common

from autopilot.commander.commander import Commander
from autopilot.commander.conditions import MANUAL_MODES
from autopilot.mavlink.codec import Message
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.manual import ManualInput
from autopilot.protocol.service import ALL, Addressed, Listener, Partner, reply
from autopilot.protocol.status import status_text

_FULL = 1000.0
_INVALID = 32_767
"""MAVLink's mark of an axis that the joystick does not have."""
_FROM_AUTO, _FROM_OFFBOARD = 1, 2
"""Bits of COM_RC_OVERRIDE."""


class ManualControlService(Listener):
    """The newest sticks from any link."""

    takes = frozenset({common.MAVLINK_MSG_ID_MANUAL_CONTROL})

    def __init__(self, commander: Commander) -> None:
        self._commander = commander
        self.sticks: ManualInput | None = None
        """None before any came."""

    def is_fresh(self, now_us: int, timeout_us: int) -> bool:
        """Whether sticks came within ``timeout_us``."""
        return self.sticks is not None and now_us - self.sticks.time_us <= timeout_us

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:  # noqa: ARG002
        """Take the sticks; moved far enough, they take over from modes that fly by themselves."""
        axes = (message.x, message.y, message.r)
        pitch, roll, yaw = (0.0 if axis == _INVALID else _clamp(axis / _FULL, -1.0) for axis in axes)
        throttle = 0.5 if message.z == _INVALID else _clamp(message.z / _FULL, 0.0)
        if not all(map(math.isfinite, (pitch, roll, yaw, throttle))):
            return ()
        self.sticks = ManualInput(time_us=now_us, roll=roll, pitch=pitch, yaw=yaw, throttle=throttle)
        return self._take_over(max(abs(roll), abs(pitch), abs(yaw)))

    def _take_over(self, deflection: float) -> Sequence[Addressed]:
        commander = self._commander
        params = commander.params
        if (
            not commander.armed
            or commander.landed
            or commander.mode in MANUAL_MODES
            or (commander.failsafe and commander.mode is FlightMode.HOLD)  # that is what it holds against
            or deflection < params.stick_takeover_fraction
        ):
            return ()
        bit = _FROM_OFFBOARD if commander.mode is FlightMode.OFFBOARD else _FROM_AUTO
        if not params.stick_takeover & bit or commander.set_mode(FlightMode.POSITION) is not None:
            return ()
        return reply(ALL, status_text(common.MAV_SEVERITY_INFO, "Pilot took over using sticks"))


def _clamp(value: float, least: float) -> float:
    return max(least, min(1.0, value))
