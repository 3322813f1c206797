"""When exchanges begin: after a random delay (ALOHA), or in slots of the stations (TDMA)."""

from math import ceil

from netsim.model.random_streams import FloatStream
from netsim.uwb.config import UwbConfig
from netsim.uwb.frames import exchange_us, slot_us


class Access:
    """Beginnings of the exchanges of all stations.

    ``draws`` are uniform floats by station; ``slot_errors_us`` the constant errors of the stations' slot
    times.
    """

    def __init__(self, config: UwbConfig, draws: list[FloatStream], slot_errors_us: list[float]) -> None:
        self._slots = config.access == "slots"
        self._delay_ns = 1_000 * config.aloha_delay_us
        self._draws = draws
        self._slot_ns = ceil(1e3 * slot_us(config))
        self._round_ns = self._slot_ns * len(draws)
        guard_ns = 1_000 * config.slot_guard_us
        self._offsets_ns = [
            station * self._slot_ns + guard_ns + round(1e3 * error_us)
            for station, error_us in enumerate(slot_errors_us)
        ]

    def begin_ns(self, station: int, now_ns: int) -> int:
        """Return when a station begins an exchange that it has from ``now_ns`` on."""
        if not self._slots:
            return now_ns + int(self._delay_ns * self._draws[station].draw())
        offset_ns = self._offsets_ns[station]
        rounds = max(0, -((offset_ns - now_ns) // self._round_ns))
        return max(now_ns, offset_ns + rounds * self._round_ns)


def check_stations(config: UwbConfig, stations: int) -> None:
    """Raise ValueError, with the field below ``uwb``, if a request may time out before its slot."""
    least_us = ceil(slot_us(config)) * stations + exchange_us(config)
    if config.access == "slots" and config.request_timeout_us < least_us:
        raise ValueError(
            f"request_timeout_us: {config.request_timeout_us} us; the slots of {stations} stations and an "
            f'exchange take {least_us:.0f} us; expected at least that, shorter slots, or access = "aloha"'
        )
