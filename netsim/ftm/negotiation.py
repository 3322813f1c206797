"""Negotiation of ranging sessions: requested and granted parameters, and the schedule of the bursts.

Source: IEEE 802.11-2016, 11.24.6.3 and 9.4.2.168. All stations share the TSF of the ad-hoc network:
simulated time in microseconds.
"""

from msgspec import Struct

from netsim.ftm.elements import (
    BURST_DURATION_CODES,
    BURST_PERIOD_UNIT_MS,
    MIN_DELTA_UNIT_US,
    NON_HT_FORMAT,
    SHORTEST_BURST_US,
    VHT_FORMATS,
    Parameters,
    Status,
)
from netsim.model.config import BandwidthMhz, FtmConfig

TIME_UNIT_NS = 1_024_000
LEAST_WAIT_NS = 10_000_000
"""Least time to a first burst that is not ASAP: the frame that announces it has to arrive before."""
LONGEST_BURST_US = SHORTEST_BURST_US << len(BURST_DURATION_CODES) - 1
LONGEST_RETRY_S = 31
_PARTIAL_TSF = 2**16
_FORMATS_WITHIN = {
    widest: {code for width, code in VHT_FORMATS.items() if width <= widest} for widest in VHT_FORMATS
}
"""Codes of VHT formats that fit into a channel, by its width in MHz."""


def requested_parameters(config: FtmConfig, format_and_bandwidth: int) -> Parameters:
    """Return the parameters of the initiator's request; the responder chooses the time of the first burst.

    The time between frames is rounded up to the protocol's unit of 100 us.
    """
    return Parameters(
        bursts_exponent=config.bursts_exponent,
        burst_duration_us=config.burst_duration_us,
        min_delta_us=_whole_units_us(config.min_delta_us),
        asap=config.asap,
        ftms_per_burst=config.ftms_per_burst,
        format_and_bandwidth=format_and_bandwidth,
        burst_period_ms=config.burst_period_ms if config.bursts_exponent else None,
    )


def can_measure(requested: Parameters, bandwidth_mhz: BandwidthMhz, *, vht: bool = True) -> bool:
    """Whether frames of the requested format fit into the responder's channel, which may have no VHT."""
    code = requested.format_and_bandwidth
    return code in (None, NON_HT_FORMAT) or (vht and code in _FORMATS_WITHIN[bandwidth_mhz])


def grant(requested: Parameters, config: FtmConfig, format_and_bandwidth: int, now_ns: int) -> Parameters:
    """Return the granted parameters: the requested ones within the responder's limits.

    Without a preference the responder's own request parameters apply. If the responder needs more time
    between frames than requested, bursts are lengthened to fit all frames, up to the longest duration, and
    the period is at least the burst duration.
    """
    exponent = _or_own(requested.bursts_exponent, config.bursts_exponent)
    frames = min(_or_own(requested.ftms_per_burst, config.ftms_per_burst), config.responder_ftms_per_burst)
    requested_delta_us = _or_own(requested.min_delta_us, _whole_units_us(config.min_delta_us))
    delta_us = max(requested_delta_us, _whole_units_us(config.responder_min_delta_us))
    duration_us = _or_own(requested.burst_duration_us, config.burst_duration_us)
    if delta_us > requested_delta_us:
        while duration_us < min(frames * delta_us, LONGEST_BURST_US):
            duration_us *= 2
    period_ms = None
    if exponent:
        least_ms = -(-duration_us // (1_000 * BURST_PERIOD_UNIT_MS)) * BURST_PERIOD_UNIT_MS
        period_ms = max(_or_own(requested.burst_period_ms, config.burst_period_ms), least_ms)
    asap = requested.asap and config.responder_asap_capable
    first_ns = now_ns
    if not asap:
        first_ns += LEAST_WAIT_NS + TIME_UNIT_NS - 1
        if requested.partial_tsf is not None and not requested.asap:
            first_ns = max(first_ns, from_partial_tsf_ns(requested.partial_tsf, now_ns))
    return Parameters(
        status=Status.SUCCESSFUL,
        bursts_exponent=exponent,
        burst_duration_us=duration_us,
        min_delta_us=delta_us,
        partial_tsf=first_ns // TIME_UNIT_NS % _PARTIAL_TSF,
        asap_capable=config.responder_asap_capable,
        asap=asap,
        ftms_per_burst=frames,
        format_and_bandwidth=format_and_bandwidth,
        burst_period_ms=period_ms,
    )


def rejection(status: Status, retry_after_ns: int = 0) -> Parameters:
    """Return the parameters of a rejection; the time to retry is rounded up to seconds, at most 31."""
    retry_s = min(-(-retry_after_ns // 1_000_000_000), LONGEST_RETRY_S) if status is Status.FAILED else 0
    return Parameters(status=status, value=retry_s, partial_tsf=0)


class Schedule(Struct, frozen=True, kw_only=True):
    """Times of a session's bursts; the first ASAP burst may begin up to one time unit later."""

    first_ns: int
    period_ns: int
    duration_ns: int
    last: int
    """Number of the last burst; the first is number 0."""

    @classmethod
    def of(cls, granted: Parameters, now_ns: int) -> "Schedule":
        """Return the schedule of a grant that is received at ``now_ns``."""
        return cls(
            first_ns=from_partial_tsf_ns(granted.partial_tsf or 0, now_ns),
            period_ns=1_000_000 * (granted.burst_period_ms or 0),
            duration_ns=1_000 * (granted.burst_duration_us or LONGEST_BURST_US),
            last=(1 << (granted.bursts_exponent or 0)) - 1,
        )

    def begin_ns(self, burst: int) -> int:
        """Return the begin of a burst."""
        return self.first_ns + burst * self.period_ns

    def end_ns(self, burst: int) -> int:
        """Return the end of a burst."""
        return self.begin_ns(burst) + self.duration_ns

    def burst_at(self, at_ns: int) -> int | None:
        """Return the number of the burst at a time, or None between bursts."""
        since_ns = at_ns - self.first_ns
        if since_ns < 0:
            return None
        burst = min(since_ns // self.period_ns, self.last) if self.period_ns else 0
        return burst if since_ns - burst * self.period_ns <= self.duration_ns else None


def from_partial_tsf_ns(partial_tsf: int, now_ns: int) -> int:
    """Return the time of a partial TSF (bits 10 to 25, ambiguous by 67 s) that is nearest to now."""
    now_units = now_ns // TIME_UNIT_NS
    ahead = (partial_tsf - now_units + _PARTIAL_TSF // 2) % _PARTIAL_TSF - _PARTIAL_TSF // 2
    return (now_units + ahead) * TIME_UNIT_NS


def _whole_units_us(delta_us: int) -> int:
    return -(-delta_us // MIN_DELTA_UNIT_US) * MIN_DELTA_UNIT_US


def _or_own(requested: int | None, own: int) -> int:
    return own if requested is None else requested
