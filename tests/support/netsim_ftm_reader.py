"""An independent reader of FTM action frames, the inverse of `netsim.ftm.elements`."""

import struct

from netsim.ftm.elements import Measurement, Parameters, Request, Status


def read(body):
    """Return the request or measurement of a valid frame body."""
    assert body[0] == 4
    if body[1] == 32:
        return Request(trigger=bool(body[2]), parameters=_parameters(body[3:]))
    assert body[1] == 33
    token, followed, t1_low, t1_high, t4_low, t4_high, t1_error, t4_error = struct.unpack_from(
        "<BBIHIHHH", body, 2
    )
    return Measurement(
        token=token,
        followed=followed,
        t1_ps=t1_high << 32 | t1_low,
        t4_ps=t4_high << 32 | t4_low,
        t1_error_exponent=t1_error,
        t4_error_exponent=t4_error,
        parameters=_parameters(body[20:]),
    )


def _parameters(element):
    if not element:
        return None
    assert element[:2] == bytes((206, 9))
    assert len(element) == 11
    bits = int.from_bytes(element[2:], "little")
    exponent, duration = bits >> 8 & 15, bits >> 12 & 15
    return Parameters(
        status=Status(bits & 3),
        value=bits >> 2 & 31,
        bursts_exponent=None if exponent == 15 else exponent,
        burst_duration_us=None if duration == 15 else 250 << duration - 2,
        min_delta_us=100 * (bits >> 16 & 255) or None,
        partial_tsf=None if bits >> 40 & 1 else bits >> 24 & 0xFFFF,
        asap_capable=bool(bits >> 41 & 1),
        asap=bool(bits >> 42 & 1),
        ftms_per_burst=bits >> 43 & 31 or None,
        format_and_bandwidth=bits >> 50 & 63 or None,
        burst_period_ms=100 * (bits >> 56) or None,
    )
