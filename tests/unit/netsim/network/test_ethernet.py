"""Ethernet frames and access categories: round trips, tags, values of the standards, hostile bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netsim.network.ethernet import EthernetFrame, access_category, build, parse, tagged

ADDRESS = st.binary(min_size=6, max_size=6)
IPV4, IPV6, ARP, VLAN = 0x0800, 0x86DD, 0x0806, 0x8100


@given(destination=ADDRESS, source=ADDRESS, ether_type=st.integers(0x600, 0xFFFF), payload=st.binary())
def test_built_frame_has_its_parts(destination, source, ether_type, payload):
    frame = build(destination, source, ether_type, payload)
    assert parse(frame) == EthernetFrame(destination, source, ether_type, payload)


@given(st.binary(max_size=80))
def test_any_bytes_are_a_frame_or_none(frame):
    parts = parse(frame)
    if parts is None:
        assert len(frame) < 14 or frame[12] < 6
    else:
        assert access_category(parts.ether_type, parts.payload) in {"vo", "vi", "be", "bk"}


def test_tag_stands_before_the_ether_type():
    frame = build(b"D" * 6, b"S" * 6, IPV4, b"payload")
    assert parse(tagged(frame, VLAN, 0x6005)) == (b"D" * 6, b"S" * 6, VLAN, b"\x60\x05\x08\x00payload")


@pytest.mark.parametrize(
    ("dscp", "category"),
    # class selectors 0 to 7 are the user priorities of IEEE 802.11-2016, table 10-1; 46 is EF
    [
        (0, "be"), (8, "bk"), (16, "bk"), (24, "be"), (32, "vi"), (40, "vi"), (48, "vo"), (56, "vo"),
        (46, "vi"), (63, "vo"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("ecn", [0, 3])
def test_category_is_of_the_upper_bits_of_the_dscp(dscp, category, ecn):
    traffic_class = dscp << 2 | ecn
    assert access_category(IPV4, bytes((0x45, traffic_class)) + bytes(18)) == category
    assert access_category(IPV6, (6 << 28 | traffic_class << 20).to_bytes(4, "big") + bytes(36)) == category


def test_category_of_a_tag_precedes_that_of_its_packet():
    voice_packet = b"\x08\x00" + bytes((0x45, 48 << 2))
    assert access_category(VLAN, (1 << 13).to_bytes(2, "big") + voice_packet) == "bk"
    assert access_category(VLAN, bytes(2) + voice_packet) == "vo"


@pytest.mark.parametrize("payload", [b"", b"\x45", bytes(60)])
@pytest.mark.parametrize("ether_type", [IPV4, IPV6, ARP, VLAN, 0xFFFF])
def test_other_and_short_packets_are_best_effort(ether_type, payload):
    assert access_category(ether_type, payload) == "be"
