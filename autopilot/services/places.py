"""SET_HOME_POSITION and SET_GPS_GLOBAL_ORIGIN: positions that a station sets by dedicated messages."""

from collections.abc import Callable, Sequence

from autopilot.commander.arming_checks import Reason
from autopilot.mavlink.codec import Message
from autopilot.services.command import refusal_text
from autopilot.services.service import ALL, Addressed, Partner, Service, reply

_LAT_MAX_E7, _LON_MAX_E7 = 900_000_000, 1_800_000_000


class PlacesService(Service):
    """Sets home. The local origin is fixed at the first GPS fix; requests to set it are answered with it."""

    def __init__(
        self,
        set_home: Callable[[float, float, float], Reason | None],
        global_origin: Callable[[], Message | None],
    ) -> None:
        """``set_home`` takes latitude and longitude in degrees and metres above mean sea level."""
        super().__init__(SET_HOME_POSITION=self._on_home, SET_GPS_GLOBAL_ORIGIN=self._on_origin)
        self._set_home = set_home
        self._global_origin = global_origin

    def _on_origin(self, _message: Message, _now_us: int, partner: Partner) -> Sequence[Addressed]:
        origin = self._global_origin()
        return () if origin is None else reply(Partner(partner.link), origin)

    def _on_home(self, message: Message, _now_us: int, _partner: Partner) -> Sequence[Addressed]:
        """Set home; the new one is reported by the streams."""
        refusal: Reason | None = Reason.BAD_ARGUMENT
        if abs(message.latitude) <= _LAT_MAX_E7 and abs(message.longitude) <= _LON_MAX_E7:
            refusal = self._set_home(
                message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3
            )
        return () if refusal is None else reply(ALL, refusal_text("Home", refusal))
