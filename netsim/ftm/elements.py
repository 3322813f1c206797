"""Fine Time Measurement action frames, encoded from the category on: no MAC header, no FCS.

Source: IEEE 802.11-2016, 9.6.8.32 (request), 9.6.8.33 (measurement), 9.4.2.168 (parameters element). Not
supported: location reports, vendor elements, and the synchronisation element, since stations of an ad-hoc
network share one TSF.
"""

from enum import IntEnum
from struct import Struct as Layout

from msgspec import Struct

from netsim.phy.modes import PhyMode

PUBLIC_ACTION = 4
REQUEST_ACTION = 32
MEASUREMENT_ACTION = 33
PARAMETERS_ELEMENT = 206
PARAMETERS_BYTES = 9
_ELEMENT_BYTES = 2 + PARAMETERS_BYTES
NO_PREFERENCE = 15
"""Code for "no preference" of bursts exponent and burst duration; in the other fields it is 0."""
MIN_DELTA_UNIT_US = 100
BURST_PERIOD_UNIT_MS = 100
SHORTEST_BURST_US = 250
"""Code 2; each code up to 11 doubles it."""
BURST_DURATION_CODES = range(2, 12)
NON_HT_FORMAT = 8
"""Code of non-HT 20 MHz; non-HT duplicate on a wider channel has no code."""
VHT_FORMATS = {20: 10, 40: 12, 80: 13}
"""By channel width in MHz."""
_HEAD = Layout("<BBB")
_STAMPS = Layout("<BBBBIHIHHH")
"""Category, action, two dialog tokens; times of departure and arrival in two parts each; their errors."""
_LOW_32 = 2**32 - 1


class Status(IntEnum):
    """Status indication of the responder."""

    RESERVED = 0
    """Value in a request."""
    SUCCESSFUL = 1
    INCAPABLE = 2
    """Do not send the same request again."""
    FAILED = 3
    """Do not send a new request for the number of seconds in the value field."""


class Parameters(Struct, frozen=True, kw_only=True, gc=False):
    """Fine Timing Measurement Parameters element of a request, or of the responder's grant or rejection.

    None means no preference or not applicable.
    """

    status: Status = Status.RESERVED
    value: int = 0
    """0..31: seconds, with ``FAILED``."""
    bursts_exponent: int | None = None
    """0..14: 2^this bursts."""
    burst_duration_us: int | None = None
    """250 us times a power of two, up to 128 ms."""
    min_delta_us: int | None = None
    """100..25500, a multiple of 100."""
    partial_tsf: int | None = None
    """Beginning of the first burst: bits 10 to 25 of the TSF, time units of 1024 us modulo 2^16."""
    asap_capable: bool = False
    asap: bool = False
    ftms_per_burst: int | None = None
    """1..31"""
    format_and_bandwidth: int | None = None
    """1..63"""
    burst_period_ms: int | None = None
    """100..6553500, a multiple of 100."""

    def encode(self) -> bytes:
        """Return the bytes of the element with its header."""
        partial_tsf, free = (0, 1) if self.partial_tsf is None else (self.partial_tsf, 0)
        exponent = NO_PREFERENCE if self.bursts_exponent is None else self.bursts_exponent
        bits = (
            self.status
            | self.value << 2
            | exponent << 8
            | _duration_code(self.burst_duration_us) << 12
            | (self.min_delta_us or 0) // MIN_DELTA_UNIT_US << 16
            | partial_tsf << 24
            | free << 40
            | self.asap_capable << 41
            | self.asap << 42
            | (self.ftms_per_burst or 0) << 43
            | (self.format_and_bandwidth or 0) << 50
            | (self.burst_period_ms or 0) // BURST_PERIOD_UNIT_MS << 56
        )
        return bytes((PARAMETERS_ELEMENT, PARAMETERS_BYTES)) + bits.to_bytes(PARAMETERS_BYTES, "little")


class Request(Struct, frozen=True, kw_only=True):
    """Body of a request frame: with parameters it requests a session, without it triggers a burst."""

    trigger: bool = True
    """True: start or continue sending measurement frames; False: stop."""
    parameters: Parameters | None = None

    @property
    def size(self) -> int:
        """Bytes of the body."""
        return _HEAD.size if self.parameters is None else _HEAD.size + _ELEMENT_BYTES

    def encode(self) -> bytes:
        """Return the bytes of the body."""
        head = _HEAD.pack(PUBLIC_ACTION, REQUEST_ACTION, self.trigger)
        return head if self.parameters is None else head + self.parameters.encode()


class Measurement(Struct, frozen=True, kw_only=True, gc=False):
    """Body of a measurement frame."""

    token: int
    """Dialog token, 1..255; 0 ends the session."""
    followed: int = 0
    """Dialog token of the frame that the time stamps belong to; 0: no time stamps."""
    t1_ps: int = 0
    """Departure of the followed frame, 48 bits."""
    t4_ps: int = 0
    """Arrival of its acknowledgement, 48 bits."""
    t1_error_exponent: int = 0
    """0..31: the error is at most 2^(exponent - 1) ps; 0: unknown."""
    t4_error_exponent: int = 0
    parameters: Parameters | None = None
    """In the first frames of a session, until one is acknowledged."""

    @property
    def size(self) -> int:
        """Bytes of the body."""
        return _STAMPS.size if self.parameters is None else _STAMPS.size + _ELEMENT_BYTES

    def encode(self) -> bytes:
        """Return the bytes of the body."""
        body = _STAMPS.pack(
            PUBLIC_ACTION, MEASUREMENT_ACTION, self.token, self.followed,
            self.t1_ps & _LOW_32, self.t1_ps >> 32, self.t4_ps & _LOW_32, self.t4_ps >> 32,
            self.t1_error_exponent, self.t4_error_exponent,
        )  # fmt: skip
        return body if self.parameters is None else body + self.parameters.encode()


def format_and_bandwidth(mode: PhyMode) -> int:
    """Return the format and bandwidth code of a mode."""
    return VHT_FORMATS[mode.bandwidth_mhz] if mode.vht else NON_HT_FORMAT


def error_exponent(bound_ps: float) -> int:
    """Return the least error exponent that covers a bound of ``bound_ps``."""
    if bound_ps <= 1.0:
        return 1
    return min((int(bound_ps - 1e-9)).bit_length() + 1, 31)


def _duration_code(burst_duration_us: int | None) -> int:
    if burst_duration_us is None:
        return NO_PREFERENCE
    return BURST_DURATION_CODES.start + (burst_duration_us // SHORTEST_BURST_US).bit_length() - 1
