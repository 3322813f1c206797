"""Sticks, with the time they came: MANUAL_CONTROL of a joystick or thumb pads, or RC_CHANNELS_OVERRIDE.

One partner's sticks count as long as they are fresh, within COM_RC_LOSS_T; what others send meanwhile moves
nothing, as PX4's selector has it. Buttons and further axes mean nothing here. Channels are as PX4 maps them
without a calibration of its own: 1 roll, 2 pitch, 3 throttle, 4 yaw, from 1000 to 2000 us, forward and right
being more.
"""

from collections.abc import Sequence
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.commander.commander import Commander
from autopilot.commander.conditions import MANUAL_MODES
from autopilot.commander.failsafe import US_PER_S
from autopilot.mavlink.codec import Message
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.manual import ManualInput
from autopilot.services.service import ALL, Addressed, Listener, Partner, reply
from autopilot.services.status import status_text

_FULL = 1000.0
_INVALID = 32_767
"""MAVLink's mark of an axis that the joystick does not have."""
_CHANNELS = 4
_PARTNERS_MAX = 8
"""Whose channels are kept; of more, the one that has been silent longest is forgotten."""
_NOTHING_SAID = 65_535
"""RC_CHANNELS_OVERRIDE's mark of a channel that stays as it was."""
_RELEASED = 0
_MIDDLE_US, _HALF_US = 1_500, 500
_FROM_AUTO, _FROM_OFFBOARD = 1, 2
"""Bits of COM_RC_OVERRIDE."""


class _Channels(NamedTuple):
    """What a partner has overridden last."""

    widths_us: tuple[int, ...]
    time_us: int


class ManualControlService(Listener):
    """The newest sticks of the partner that counts."""

    takes = frozenset({common.MAVLINK_MSG_ID_MANUAL_CONTROL, common.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE})

    def __init__(self, commander: Commander) -> None:
        self._commander = commander
        self.sticks: ManualInput | None = None
        """None before any came."""
        self._source: Partner | None = None
        """Whose they are."""
        self._channels: dict[Partner, _Channels] = {}
        """Who spoke last is last."""

    def is_fresh(self, now_us: int, timeout_us: int) -> bool:
        """Whether sticks came within ``timeout_us``."""
        return self.sticks is not None and now_us - self.sticks.time_us <= timeout_us

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Take the sticks; moved far enough, they take over from modes that fly by themselves."""
        if message.get_msgId() == common.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE:
            return self._take_channels(message, now_us, partner)
        axes = (message.x, message.y, message.r)
        pitch, roll, yaw = (0.0 if axis == _INVALID else _clamp(axis / _FULL, -1.0) for axis in axes)
        throttle = 0.5 if message.z == _INVALID else _clamp(message.z / _FULL, 0.0)
        return self._move(
            ManualInput(time_us=now_us, roll=roll, pitch=pitch, yaw=yaw, throttle=throttle), partner
        )

    def _take_channels(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Take the channels that are overridden, the rest as centred; with none, there are no sticks.

        What "as it was" means is the partner's own, and nothing once that is as old as lost sticks.
        """
        last = self._channels.pop(partner, None)
        widths_us = (_RELEASED,) * _CHANNELS
        if last is not None and now_us - last.time_us <= self._timeout_us:
            widths_us = last.widths_us
        said_us = (message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw)
        widths_us = tuple(
            before if said == _NOTHING_SAID else said for before, said in zip(widths_us, said_us, strict=True)
        )
        self._channels[partner] = _Channels(widths_us, now_us)
        if len(self._channels) > _PARTNERS_MAX:
            del self._channels[next(iter(self._channels))]
        if not any(widths_us):
            return ()
        roll, pitch, throttle, yaw = (
            0.0 if width_us == _RELEASED else _clamp((width_us - _MIDDLE_US) / _HALF_US, -1.0)
            for width_us in widths_us
        )
        throttle = 0.5 + 0.5 * throttle
        return self._move(
            ManualInput(time_us=now_us, roll=roll, pitch=pitch, yaw=yaw, throttle=throttle), partner
        )

    @property
    def _timeout_us(self) -> int:
        return round(self._commander.params.manual_loss_s * US_PER_S)

    def _move(self, sticks: ManualInput, partner: Partner) -> Sequence[Addressed]:
        if partner != self._source and self.is_fresh(sticks.time_us, self._timeout_us):
            return ()
        self._source, self.sticks = partner, sticks
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
