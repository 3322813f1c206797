"""SET_HOME_POSITION and SET_GPS_GLOBAL_ORIGIN: positions that a station sets by dedicated messages."""

from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Reason
from autopilot.mavlink.codec import Message
from autopilot.services.command import refusal_text
from autopilot.services.service import ALL, Addressed, Listener, Partner, reply

_LAT_MAX_E7, _LON_MAX_E7 = 900_000_000, 1_800_000_000


class PlacesService(Listener):
    """Sets home. The local origin is fixed at the first GPS fix; requests to set it are answered with it."""

    takes = frozenset({common.MAVLINK_MSG_ID_SET_HOME_POSITION, common.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN})

    def __init__(
        self,
        set_home: Callable[[float, float, float], Reason | None],
        global_origin: Callable[[], Message | None],
    ) -> None:
        """``set_home`` takes latitude and longitude in degrees and metres above mean sea level."""
        self._set_home = set_home
        self._global_origin = global_origin

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:  # noqa: ARG002
        """Handle a position; a new home is reported by the streams."""
        if message.get_msgId() == common.MAVLINK_MSG_ID_SET_GPS_GLOBAL_ORIGIN:
            origin = self._global_origin()
            return () if origin is None else reply(Partner(partner.link), origin)
        if abs(message.latitude) > _LAT_MAX_E7 or abs(message.longitude) > _LON_MAX_E7:
            refusal: Reason | None = Reason.BAD_ARGUMENT
        else:
            refusal = self._set_home(
                message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3
            )
        return () if refusal is None else reply(ALL, refusal_text("Home", refusal))
