"""Frames as bytes and radiotap headers. The whole file takes 1 s."""

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from netsim_pcapng import OFDM24, datagram, radiotap

from netsim.capture.ieee80211 import NETWORK_ADDRESS, address, mpdu
from netsim.capture.radiotap import Radiotap
from netsim.phy.frames import ACK_BYTES, CTS_BYTES, GROUP, RTS_BYTES, Datagram, Frame, FrameKind, Packet
from netsim.phy.modes import phy_mode

NON_HT = [f"ofdm{rate}" for rate in (6, 9, 12, 18, 24, 36, 48, 54)]
MULTICAST = bytes.fromhex("333300000001")
CRC_RESIDUE = 0x2144DF1C
"""CRC-32 of anything that its own CRC-32 follows, least significant byte first."""


class Body:
    """Of an action frame: bytes that encode to themselves."""

    def __init__(self, content):
        self.content = content

    def encode(self):
        return self.content


def ones_complement_sum(content):
    """Sum of 16-bit words with end-around carry: 0xFFFF for what carries its own checksum (RFC 1071)."""
    total = 0
    for high, low in zip(content[::2], content[1::2] + b"\x00" * (len(content) % 2), strict=True):
        total += high << 8 | low
        total = (total & 0xFFFF) + (total >> 16)
    return total


stations = st.integers(0, 65_535)


# --- frames as bytes


@given(
    source=stations,
    destination=stations | st.just(GROUP),
    sequence=st.integers(0, 2**40),
    seq=st.integers(0, 2**63 - 1),
    nav_ns=st.integers(0, 32_767_000),
    payload=st.binary(max_size=1472),
    retry=st.booleans(),
    port=st.integers(1, 65_535),
)
def test_a_datagram_has_every_header_and_valid_checksums(
    source, destination, sequence, seq, nav_ns, payload, retry, port
):
    """Layout by offset: 802.11 header 0..24, LLC/SNAP ..32, IPv4 ..52, UDP ..60, payload, FCS 4."""
    frame = Frame(
        kind=FrameKind.DATA, source=source, destination=destination, mode=OFDM24,
        frame_bytes=len(payload) + 64, nav_ns=nav_ns, seq=seq, sequence=sequence,
        body=Datagram(port, payload),
    )  # fmt: skip
    data = mpdu(frame, retry=retry)
    assert len(data) == frame.frame_bytes
    assert zlib.crc32(data) == CRC_RESIDUE
    control, duration_us, to, by, network, order = struct.unpack_from("<HH6s6s6sH", data)
    assert control == (0x0808 if retry else 0x0008)
    assert duration_us - 1 < nav_ns / 1_000 <= duration_us
    assert (to, by, network) == (address(destination), address(source), NETWORK_ADDRESS)
    assert order >> 4 == sequence % 4096
    assert order & 0xF == 0
    ip, udp = data[32:52], data[52:-4]
    assert ones_complement_sum(ip) == 0xFFFF
    assert ip[12] == ip[16] == 10
    assert struct.unpack(">H", ip[2:4]) == (len(ip) + len(udp),)
    pseudo_header = ip[12:] + struct.pack(">HH", 17, len(udp))
    assert ones_complement_sum(pseudo_header + udp) == 0xFFFF
    assert struct.unpack(">HHH", udp[:6]) == (port, port, len(udp))
    assert udp[6:8] != b"\x00\x00"  # would be no checksum
    assert udp[8:] == payload


@given(
    source=stations,
    destination=st.one_of(stations.map(lambda each: (each, address(each))), st.just((GROUP, MULTICAST))),
    ether_type=st.integers(0x0600, 0xFFFF),
    payload=st.binary(max_size=2_296),
)
def test_a_packet_has_its_own_destination_and_type(source, destination, ether_type, payload):
    """Layout by offset: 802.11 header 0..24, LLC/SNAP ..32, payload, FCS 4."""
    station, to = destination
    frame = Frame(
        kind=FrameKind.DATA, source=source, destination=station, mode=OFDM24, frame_bytes=len(payload) + 36,
        body=Packet(to, ether_type, payload),
    )  # fmt: skip
    data = mpdu(frame)
    assert len(data) == frame.frame_bytes
    assert zlib.crc32(data) == CRC_RESIDUE
    assert (data[:2], data[4:10], data[10:16]) == (b"\x08\x00", to, address(source))
    assert data[24:32] == b"\xaa\xaa\x03\x00\x00\x00" + struct.pack(">H", ether_type)
    assert data[32:-4] == payload


def test_checksum_of_zero_is_encoded_per_protocol():
    """A word that equals the checksum over the others makes their sum 0xFFFF, whose complement is 0.

    IPv4 writes 0, not minus zero (RFC 1624); in UDP that would say that there is no checksum: minus zero.
    """
    ip_checksum = int.from_bytes(mpdu(datagram(seq=0))[42:44], "big")
    assert ip_checksum != 0
    assert mpdu(datagram(seq=ip_checksum))[42:44] == b"\x00\x00"
    udp_checksum = mpdu(datagram(b"\x00\x00"))[58:60]
    assert udp_checksum != b"\xff\xff"
    assert mpdu(datagram(udp_checksum))[58:60] == b"\xff\xff"


@given(
    kind=st.sampled_from([FrameKind.FTM_REQUEST, FrameKind.FTM]), content=st.binary(min_size=2, max_size=300)
)
def test_action_frame_contains_its_encoded_body(kind, content):
    frame = Frame(
        kind=kind, source=3, destination=4, mode=OFDM24, frame_bytes=28 + len(content), body=Body(content)
    )
    data = mpdu(frame)
    assert len(data) == frame.frame_bytes
    assert zlib.crc32(data) == CRC_RESIDUE
    assert data[:2] == b"\xd0\x00"
    assert data[24:-4] == content


@given(source=stations, destination=stations, nav_ns=st.integers(0, 32_767_000))
def test_control_frames_have_their_sizes_and_addresses(source, destination, nav_ns):
    duration_us = -(-nav_ns // 1_000)
    for kind, frame_bytes, control, addresses in (
        (FrameKind.RTS, RTS_BYTES, 0xB4, address(destination) + address(source)),
        (FrameKind.CTS, CTS_BYTES, 0xC4, address(destination)),
        (FrameKind.ACK, ACK_BYTES, 0xD4, address(destination)),
    ):
        frame = Frame(
            kind=kind,
            source=source,
            destination=destination,
            mode=OFDM24,
            frame_bytes=frame_bytes,
            nav_ns=nav_ns,
        )
        data = mpdu(frame)
        assert len(data) == frame_bytes
        assert zlib.crc32(data) == CRC_RESIDUE
        assert data[:-4] == struct.pack("<HH", control, duration_us) + addresses


def test_duration_is_limited_to_the_field():
    """A VI TXOP of 3.008 ms fits; the field's 15 bits end at 32.767 ms (9.2.4.2)."""
    frame = Frame(kind=FrameKind.ACK, source=0, destination=1, mode=OFDM24, frame_bytes=14, nav_ns=40_000_000)
    assert struct.unpack_from("<H", mpdu(frame), 2) == (32_767,)


@given(st.integers(64, 2000))
def test_a_data_frame_without_a_body_is_a_datagram_of_zeros(frame_bytes):
    frame = Frame(
        kind=FrameKind.DATA, source=0, destination=GROUP, mode=OFDM24, frame_bytes=frame_bytes, sequence=1
    )
    data = mpdu(frame)
    assert len(data) == frame_bytes
    assert data[60:-4] == bytes(frame_bytes - 64)


def test_body_of_wrong_length_is_rejected():
    frame = Frame(
        kind=FrameKind.DATA,
        source=0,
        destination=GROUP,
        mode=OFDM24,
        frame_bytes=100,
        body=Datagram(1, b"too short"),
    )
    with pytest.raises(ValueError, match="expected 100"):
        mpdu(frame)
    frame = Frame(kind=FrameKind.FTM, source=0, destination=1, mode=OFDM24, frame_bytes=48, body=object())
    with pytest.raises(TypeError, match="ftm"):
        mpdu(frame)


def test_stations_have_unique_addresses():
    addresses = {address(station) for station in range(65_536)}
    assert len(addresses | {address(GROUP), NETWORK_ADDRESS}) == 65_538
    assert all(each[0] & 3 == 2 for each in addresses)  # locally administered, individual


# --- radiotap


@pytest.mark.parametrize("width_mhz", [20, 40, 80])
@pytest.mark.parametrize("name", NON_HT)
def test_a_non_ht_frame_has_its_rate_on_every_width(name, width_mhz):
    mode = phy_mode(name, width_mhz)
    header = Radiotap(mode, frequency_mhz=5210.0, power_dbm=16.4).header(5_000_000_123, 7)
    fields, rest = radiotap(header)
    assert rest == b""
    assert fields.pop("rate") == (2 * int(name.removeprefix("ofdm")),)
    # the MPDU begins 20 us after the preamble
    assert fields == {
        "tsft": (5_000_020,),
        "flags": (0x10,),
        "channel": (5210, 0x0140),
        "tx_power": (16,),
        "timestamp": (5_000_000_123, 1, 0x12, 0x02),
    }


@pytest.mark.parametrize(("width_mhz", "code"), [(20, 0), (40, 1), (80, 4)])
def test_a_vht_frame_has_its_mcs_and_width(width_mhz, code):
    for mcs in range(9 if width_mhz == 20 else 10):
        mode = phy_mode(f"vht_mcs{mcs}", width_mhz)
        fields, rest = radiotap(Radiotap(mode, frequency_mhz=5210.0, power_dbm=-3.0).header(999, 7))
        assert rest == b""
        known, flags, bandwidth, users, coding, group, partial_aid = fields["vht"]
        assert (known, flags, bandwidth) == (0x65, 0, code)
        assert users == bytes((mcs << 4 | 1, 0, 0, 0))
        assert (coding, group, partial_aid) == (0, 0, 0)
        # radiotap.org, "A-MPDU status": last subframe and its bit known, EOF and its bit known; CRC unknown
        assert fields["ampdu"] == (7, 0x04 | 0x08 | 0x40 | 0x80, 0, 0)
        assert "rate" not in fields
        assert fields["tsft"] == (40,)
        assert fields["tx_power"] == (-3,)


@pytest.mark.parametrize("name", ["ofdm6", "vht_mcs4"])
def test_a_received_frame_has_signal_and_noise_and_no_transmit_power(name):
    mode = phy_mode(name, 80)
    for bad_fcs, flags in ((False, 0x10), (True, 0x50)):
        header = Radiotap(
            mode, frequency_mhz=5210.0, power_dbm=-71.4, is_received=True, noise_dbm=-87.97, bad_fcs=bad_fcs
        ).header(1_000, 7)
        fields, rest = radiotap(header)
        assert rest == b""
        assert (fields["signal"], fields["noise"], fields["flags"]) == ((-71,), (-88,), (flags,))
        assert fields["timestamp"] == (1_000, 1, 0x12, 0x02)
        assert "tx_power" not in fields
        assert ("vht" in fields) == mode.vht


@pytest.mark.parametrize("name", ["ofdm6", "vht_mcs4"])
def test_a_receiver_without_noise_states_the_signal_alone(name):
    header = Radiotap(phy_mode(name, 80), frequency_mhz=5210.0, power_dbm=-71.4, is_received=True).header(
        1_000, 7
    )
    fields, rest = radiotap(header)
    assert rest == b""
    assert fields["signal"] == (-71,)
    assert fields["timestamp"] == (1_000, 1, 0x12, 0x02)
    assert not {"noise", "tx_power"} & set(fields)


def test_a_channel_is_of_its_band():
    for frequency_mhz, shown in (
        (2412.0, (2412, 0x00C0)),
        (5180.0, (5180, 0x0140)),
        (868.3, (868, 0x0040)),
        (1e5, (65_535, 0x0140)),
    ):
        header = Radiotap(OFDM24, frequency_mhz=frequency_mhz, power_dbm=0.0).header(0, 7)
        assert radiotap(header)[0]["channel"] == shown
