"""Rates of a link's streams by its data rate and by its modem's RADIO_STATUS, as PX4 sets them.

Rules of PX4's mavlink_main.cpp (`update_rate_mult`, `update_radio_status`), v1.17. Streams other than the
heartbeat are sent at their rates times a factor: the smaller one of what fits into the data rate, and of one
that follows the free space of the modem's buffer. PX4 also reduces rates after failed writes to the port,
which do not occur here: what the modem's buffers have no space for is lost.
"""

BYTES_S = 1_200
"""Data rate of a telemetry port, bytes/s: the default of MAV_0_RATE."""
TIMEOUT_US = 5_000_000
"""Time after which a report has no effect: the default of MAV_RADIO_TOUT."""
CRITICAL_PERCENT, LOW_PERCENT, HALF_PERCENT = 25, 35, 50
"""Free space of the modem's buffer below which rates are reduced by much and by little, and above which they
are raised (RADIO_BUFFER_..._PERCENTAGE)."""
MUCH_LESS, LESS, MORE = 0.8, 0.975, 1.025
LEAST_STORED, LEAST = 0.01, 0.05
"""Lower limits of the stored factor of the modem and of the factor of the streams."""


class FlowControl:
    """Factor of one link's stream rates; ``bytes_s`` is the link's data rate."""

    def __init__(self, bytes_s: int) -> None:
        self._bytes_s = bytes_s
        self._by_modem = 1.0
        self._reported_us: int | None = None
        """Time of the last report that has effect."""
        self._is_low = False

    def on_radio_status(self, txbuf_percent: int, now_us: int) -> None:
        """Adapt to the free space of the modem's buffer, which a RADIO_STATUS reports."""
        self._reported_us = now_us
        self._is_low = txbuf_percent < LOW_PERCENT
        factor = self._by_modem
        if txbuf_percent < CRITICAL_PERCENT:
            factor *= MUCH_LESS
        elif self._is_low:
            factor *= LESS
        elif txbuf_percent > HALF_PERCENT:
            factor *= MORE
        self._by_modem = min(max(factor, LEAST_STORED), 1.0)

    def is_low(self, now_us: int) -> bool:
        """Whether the modem's buffer has little space, so that transfers such as parameter lists wait."""
        self._expire(now_us)
        return self._is_low

    def factor(self, now_us: int, constant_bytes_s: float, variable_bytes_s: float) -> float:
        """Return the factor of the stream rates, 0.05 to 1.

        ``constant_bytes_s`` is the heartbeat's need at full rate, ``variable_bytes_s`` that of the others.
        """
        self._expire(now_us)
        fitting = (self._bytes_s - constant_bytes_s) / variable_bytes_s if variable_bytes_s > 0.0 else 1.0
        return min(max(min(fitting, self._by_modem), LEAST), 1.0)

    def _expire(self, now_us: int) -> None:
        if self._reported_us is not None and now_us - self._reported_us > TIMEOUT_US:
            self._reported_us, self._by_modem, self._is_low = None, 1.0, False
