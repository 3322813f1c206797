"""Sticks, with the time they came: MANUAL_CONTROL of a joystick or thumb pads, or RC_CHANNELS_OVERRIDE.

Buttons and further axes mean nothing here. Channels are as PX4 maps them without a calibration of its own: 1
roll, 2 pitch, 3 throttle, 4 yaw, from 1000 to 2000 us, forward and right being more.
"""

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
_CHANNELS = 4
_NOTHING_SAID = 65_535
"""RC_CHANNELS_OVERRIDE's mark of a channel that stays as it was."""
_RELEASED = 0
_MIDDLE_US, _HALF_US = 1_500, 500
_FROM_AUTO, _FROM_OFFBOARD = 1, 2
"""Bits of COM_RC_OVERRIDE."""


class ManualControlService(Listener):
    """The newest sticks from any link."""

    takes = frozenset({common.MAVLINK_MSG_ID_MANUAL_CONTROL, common.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE})

    def __init__(self, commander: Commander) -> None:
        self._commander = commander
        self.sticks: ManualInput | None = None
        """None before any came."""
        self._channels_us = [_RELEASED] * _CHANNELS
        """As overridden last."""

    def is_fresh(self, now_us: int, timeout_us: int) -> bool:
        """Whether sticks came within ``timeout_us``."""
        return self.sticks is not None and now_us - self.sticks.time_us <= timeout_us

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:  # noqa: ARG002
        """Take the sticks; moved far enough, they take over from modes that fly by themselves."""
        if message.get_msgId() == common.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE:
            return self._take_channels(message, now_us)
        axes = (message.x, message.y, message.r)
        pitch, roll, yaw = (0.0 if axis == _INVALID else _clamp(axis / _FULL, -1.0) for axis in axes)
        throttle = 0.5 if message.z == _INVALID else _clamp(message.z / _FULL, 0.0)
        return self._move(ManualInput(time_us=now_us, roll=roll, pitch=pitch, yaw=yaw, throttle=throttle))

    def _take_channels(self, message: Message, now_us: int) -> Sequence[Addressed]:
        """Take the channels that are overridden, the rest as centred; with none, there are no sticks."""
        said_us = (message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw)
        self._channels_us = [
            before if said == _NOTHING_SAID else said
            for before, said in zip(self._channels_us, said_us, strict=True)
        ]
        if not any(self._channels_us):
            return ()
        roll, pitch, throttle, yaw = (
            0.0 if width_us == _RELEASED else _clamp((width_us - _MIDDLE_US) / _HALF_US, -1.0)
            for width_us in self._channels_us
        )
        throttle = 0.5 + 0.5 * throttle
        return self._move(ManualInput(time_us=now_us, roll=roll, pitch=pitch, yaw=yaw, throttle=throttle))

    def _move(self, sticks: ManualInput) -> Sequence[Addressed]:
        self.sticks = sticks
        return self._take_over(max(abs(sticks.roll), abs(sticks.pitch), abs(sticks.yaw)))

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
