"""FTM action frames as bytes: round trips, layout of the fields, decoding by Wireshark."""

import shutil
import struct
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st
from netsim_ftm_reader import read

from netsim.ftm.elements import (
    Measurement,
    Parameters,
    Request,
    Status,
    error_exponent,
    format_and_bandwidth,
)
from netsim.phy.modes import phy_mode

STAMPS = st.integers(0, 2**48 - 1)
EXPONENTS = st.integers(0, 31)
PARAMETERS = st.builds(
    Parameters,
    status=st.sampled_from(Status),
    value=st.integers(0, 31),
    bursts_exponent=st.none() | st.integers(0, 14),
    burst_duration_us=st.none() | st.sampled_from([250 << k for k in range(10)]),
    min_delta_us=st.none() | st.integers(1, 255).map(lambda units: 100 * units),
    partial_tsf=st.none() | st.integers(0, 2**16 - 1),
    asap_capable=st.booleans(),
    asap=st.booleans(),
    ftms_per_burst=st.none() | st.integers(1, 31),
    format_and_bandwidth=st.none() | st.integers(1, 63),
    burst_period_ms=st.none() | st.integers(1, 2**16 - 1).map(lambda units: 100 * units),
)
BODIES = st.builds(Request, trigger=st.booleans(), parameters=st.none() | PARAMETERS) | st.builds(
    Measurement,
    token=st.integers(0, 255),
    followed=st.integers(0, 255),
    t1_ps=STAMPS,
    t4_ps=STAMPS,
    t1_error_exponent=EXPONENTS,
    t4_error_exponent=EXPONENTS,
    parameters=st.none() | PARAMETERS,
)
EXAMPLE = Parameters(
    status=Status.FAILED,
    value=0b10110,
    bursts_exponent=2,
    burst_duration_us=16_000,
    min_delta_us=400,
    partial_tsf=0xABCD,
    asap_capable=True,
    ftms_per_burst=8,
    format_and_bandwidth=13,
    burst_period_ms=25_800,
)


@given(BODIES)
def test_elements_round_trip(body):
    assert read(body.encode()) == body


def test_sizes_follow_from_the_fields():
    # category, action, trigger; two tokens, two stamps of 48 bits, two errors of 16; element of 2 + 9
    for body, size in (
        (Request(), 3),
        (Request(parameters=EXAMPLE), 3 + 11),
        (Measurement(token=1), 2 + 2 + 12 + 4),
        (Measurement(token=1, parameters=EXAMPLE), 20 + 11),
    ):
        assert len(body.encode()) == body.size == size


def test_fields_have_the_layout_of_the_standard():
    """9.4.2.168: bits of each octet from its lowest on.

    status 2, value 5, reserved 1 | exponent 4, duration 4 | min delta 8 | partial TSF 16 | no preference 1,
    ASAP capable 1, ASAP 1, FTMs 5 | reserved 2, format 6 | period 16.
    """
    element = EXAMPLE.encode()
    assert element[:2] == bytes((206, 9))
    assert element[2] == 0b0_10110_11
    assert element[3] == 0b1000_0010  # 16 ms is code 8
    assert element[4] == 4
    assert element[5:7] == bytes((0xCD, 0xAB))
    assert element[7] == 0b01000_0_1_0
    assert element[8] == 0b001101_00
    assert element[9:11] == bytes((0x02, 0x01))  # 258 * 100 ms
    assert Request(trigger=False).encode() == bytes((4, 32, 0))
    body = Measurement(token=7, followed=6, t1_ps=0x010203040506, t4_ps=0x0A0B0C0D0E0F, t4_error_exponent=14)
    assert body.encode() == bytes((4, 33, 7, 6, 6, 5, 4, 3, 2, 1, 15, 14, 13, 12, 11, 10, 0, 0, 14, 0))


def test_no_preference_has_its_own_codes():
    element = Parameters().encode()
    assert element[3] == 0xFF
    assert element[4] == 0
    assert element[7] == 1  # partial TSF timer no preference; FTMs per burst 0


def test_formats():
    codes = [format_and_bandwidth(phy_mode("vht_mcs0", width)) for width in (20, 40, 80)]
    assert codes == [10, 12, 13]
    assert format_and_bandwidth(phy_mode("ofdm6", 80)) == 8


@given(st.floats(0.0, 1e12))
def test_error_exponent_is_the_least_that_holds(bound_ps):
    # 9.6.8.33: exponent E says at most 2^(E - 1) ps, 31 is anything above 2^29
    exponent = error_exponent(bound_ps)
    assert 1 <= exponent <= 31
    assert exponent == 31 or bound_ps <= 2.0 ** (exponent - 1)
    assert exponent == 1 or bound_ps > 2.0 ** (exponent - 2)


@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")
def test_wireshark_decodes_equal_fields(tmp_path):
    bodies = [
        Request(parameters=EXAMPLE),
        Measurement(
            token=9, followed=8, t1_ps=2**48 - 3, t4_ps=20_015_998_343_868, t1_error_exponent=1,
            t4_error_exponent=13, parameters=EXAMPLE,
        ),
    ]  # fmt: skip
    # management header of an action frame: frame control, duration, three addresses, sequence
    header = (
        struct.pack("<HH", 0x00D0, 44)
        + bytes((2, 0, 0, 0, 0, 1, 2, 0, 0, 0, 0, 2, 2, 255, 0, 0, 0, 0))
        + bytes(2)
    )
    capture = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 105)
    for body in bodies:
        frame = header + body.encode()
        capture += struct.pack("<IIII", 0, 0, len(frame), len(frame)) + frame
    path = tmp_path / "ftm.pcap"
    path.write_bytes(capture)
    prefix = "wlan.fixed.ftm.param."
    fields = [
        *(prefix + name for name in ("status_indication", "value", "burst_exponent", "burst_duration")),
        *(prefix + name for name in ("min_delta_ftm", "partial_tsf_timer", "partial_tsf_no_pref")),
        *(
            prefix + name
            for name in ("asap_capable", "asap", "ftm_per_burst", "format_and_bw", "burst_period")
        ),
        *("wlan.fixed.dialog_token", "wlan.fixed.followup_dialog_token", "wlan.fixed.ftm_tod"),
        *("wlan.fixed.ftm_toa", "wlan.fixed.ftm_tod_err", "wlan.fixed.ftm_toa_err", "_ws.malformed"),
    ]
    command = ["tshark", "-r", str(path), "-T", "fields"]
    for field in fields:
        command += ["-e", field]
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    request, measurement = (
        [int(value, 0) if value else None for value in line.split("\t")] for line in output.splitlines()
    )
    parameters = [3, 22, 2, 8, 4, 0xABCD, 0, 1, 0, 8, 13, 258]
    assert request == parameters + [None] * 7
    assert measurement == [*parameters, 9, 8, 2**48 - 3, 20_015_998_343_868, 1, 13, None]
