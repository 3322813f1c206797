"""Stick positions with their time of arrival, from MANUAL_CONTROL or RC_CHANNELS_OVERRIDE.

The sticks of one partner are used as long as they are fresh (COM_RC_LOSS_T); those of others are ignored
meanwhile, as in PX4's selector. Buttons and further axes are ignored. Channels are mapped as in PX4 without
calibration: 1 roll, 2 pitch, 3 throttle, 4 yaw, from 1000 to 2000 us; larger is forward or right.
"""

from collections.abc import Sequence
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.commander.commander import Commander
from autopilot.commander.failsafe import US_PER_S
from autopilot.mavlink.codec import Message
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.flight_mode import ManualInput
from autopilot.services.service import ALL, Addressed, Newest, Partner, Service, reply
from autopilot.services.status import status_text

_FULL = 1000.0
_INVALID = 32_767
"""MAVLink's mark of an axis that is not available."""
_CHANNELS = 4
_PARTNERS_MAX = 8
"""Partners whose channels are stored; a new one replaces the one that has been silent longest."""
_UNCHANGED = 65_535
"""RC_CHANNELS_OVERRIDE's mark of a channel that keeps its value."""
_RELEASED = 0
_MIDDLE_US, _HALF_US = 1_500, 500
_FROM_AUTO, _FROM_OFFBOARD = 1, 2
"""Bits of COM_RC_OVERRIDE."""


class _Channels(NamedTuple):
    """Pulse widths that a partner has last sent."""

    widths_us: tuple[int, ...]
    time_us: int


class ManualControlService(Service):
    """The latest sticks of the selected partner."""

    def __init__(self, commander: Commander) -> None:
        super().__init__(MANUAL_CONTROL=self._on_axes, RC_CHANNELS_OVERRIDE=self._on_channels)
        self._commander = commander
        self.sticks: ManualInput | None = None
        """None before the first message."""
        self._source: Partner | None = None
        """The selected partner."""
        self._channels: Newest[Partner, _Channels] = Newest(_PARTNERS_MAX)

    def is_fresh(self, now_us: int, timeout_us: int) -> bool:
        """Whether the sticks are at most ``timeout_us`` old."""
        return self.sticks is not None and now_us - self.sticks.time_us <= timeout_us

    def _on_axes(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        axes = (message.x, message.y, message.r)
        pitch, roll, yaw = (0.0 if axis == _INVALID else _clamp(axis / _FULL, -1.0) for axis in axes)
        throttle = 0.5 if message.z == _INVALID else _clamp(message.z / _FULL, 0.0)
        return self._move(
            ManualInput(time_us=now_us, roll=roll, pitch=pitch, yaw=yaw, throttle=throttle), partner
        )

    def _on_channels(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:
        """Read overridden channels, released ones as centred; without any, the sticks are not updated.

        A channel that is marked as unchanged keeps the partner's last value, if that is still fresh.
        """
        last = self._channels.get(partner)
        widths_us = (_RELEASED,) * _CHANNELS
        if last is not None and now_us - last.time_us <= self._timeout_us:
            widths_us = last.widths_us
        sent_us = (message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw)
        widths_us = tuple(
            before if sent == _UNCHANGED else sent for before, sent in zip(widths_us, sent_us, strict=True)
        )
        self._channels[partner] = _Channels(widths_us, now_us)
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
        """Update the sticks; a large enough deflection takes over from autonomous modes."""
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
            or commander.mode in commander.modes.by_sticks
            or (commander.failsafe and commander.mode is FlightMode.HOLD)  # not while a failsafe holds
            or deflection < params.stick_takeover_fraction
        ):
            return ()
        bit = _FROM_OFFBOARD if commander.mode is FlightMode.OFFBOARD else _FROM_AUTO
        if not params.stick_takeover & bit or commander.set_mode(FlightMode.POSITION) is not None:
            return ()
        return reply(ALL, status_text(common.MAV_SEVERITY_INFO, "Pilot took over using sticks"))


def _clamp(value: float, least: float) -> float:
    return max(least, min(1.0, value))
