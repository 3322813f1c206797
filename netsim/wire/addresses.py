"""Addresses of stations: of their frames and of their interfaces ``wlan0``.

A MAC address is locally administered, 02:00:00:00:hi:lo; an IPv4 address is 10.1.hi.lo of 10.0.0.0/8, where
hi and lo are the bytes of the station's number.
"""

GROUP_ADDRESS = bytes.fromhex("ffffffffffff")
"""MAC address of all stations."""
GROUP_IPV4_ADDRESS = bytes((10, 255, 255, 255))
_MAC_PREFIX, _IPV4_PREFIX = bytes.fromhex("02000000"), bytes((10, 1))
_GROUP_BIT = 0x01
"""Individual/Group bit of an address's first byte (IEEE 802-2014, 8.2.2)."""


def mac_address(station: int) -> bytes:
    """Return the MAC address of a station. Raises OverflowError unless it is in 0..65535."""
    return _MAC_PREFIX + station.to_bytes(2, "big")


def ipv4_address(station: int) -> bytes:
    """Return the IPv4 address of a station. Raises OverflowError unless it is in 0..65535."""
    return _IPV4_PREFIX + station.to_bytes(2, "big")


def is_group(address: bytes) -> bool:
    """Whether a MAC address is one of a group: multicast or broadcast."""
    return bool(address[0] & _GROUP_BIT)


def station_of(address: bytes) -> int | None:
    """Return the station of a MAC address, None if it is not an address of `mac_address`."""
    prefix, number = address[:-2], address[-2:]
    return int.from_bytes(number, "big") if prefix == _MAC_PREFIX else None
