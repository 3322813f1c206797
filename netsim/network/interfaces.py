"""Interfaces of vehicles, by netlink: veth pairs or TAPs, configured without configuration files.

The end ``wlan0`` is in the vehicle's namespace. Its peer is in the bridge's, where packet sockets read it
(`netsim.network.packet_socket`); the peer has neither addresses nor IPv6. The end ``eth0`` is there too; its
peer has the autopilot's address (`netsim.network.companion_interface`). The only module that imports
pyroute2, which takes 0.4 s. All functions act in the calling thread's network namespace.

Sources: veth(4), ip-link(8), packet(7), linux/ethtool.h, linux/sockios.h, netdevice(7); RFC 4291, appendix A
(interface identifiers).
"""

import contextlib
import ctypes
import errno
import fcntl
import os
import socket
import struct
from ipaddress import IPv4Address, IPv6Address
from pathlib import Path

from pyroute2 import IPRoute, NetlinkError

from netsim.network.messages import INTERFACE
from netsim.wire.addresses import GROUP_IPV4_ADDRESS, ipv4_address, mac_address
from netsim.wire.messages import Station

COMPANION_INTERFACE = "eth0"
MTU_BYTES = 1_500
COMPANION_PREFIX_BITS = 24
IPV4_PREFIX_BITS = 8
"""So that the broadcast address is 10.255.255.255, as of `netsim.wire.addresses`."""
_LOOPBACK_INDEX = 1
_NO_ADDRESS = {"attrs": [("AF_INET6", {"attrs": [("IFLA_INET6_ADDR_GEN_MODE", 1)]})]}
"""IN6_ADDR_GEN_MODE_NONE: the address is given here, without the second of duplicate address detection."""
_IFA_F_NODAD = 0x02
_MULTICAST_IPV4, _LIMITED_BROADCAST = "224.0.0.0/4", "255.255.255.255/32"
"""Destinations that need routes, which a host on a network has by its default route."""
_SIOCGIFFLAGS, _SIOCETHTOOL = 0x8913, 0x8946
_IFF_RUNNING = 0x40
_OFFLOADS = {
    "receive checksums": 0x15,
    "transmit checksums": 0x17,
    "scatter-gather": 0x19,
    "TCP segmentation": 0x1F,
    "generic segmentation": 0x24,
    "generic receive": 0x2C,
}
"""ETHTOOL_SRXCSUM, STXCSUM, SSG, STSO, SGSO, SGRO: a veth leaves all of it to a device behind it."""


class InterfaceError(OSError):
    """An interface cannot be made or configured; the text is one line."""


class NoVeth(InterfaceError):
    """The kernel makes no veth pairs."""


def peer_name(station: Station) -> str:
    """Return the name of the bridge's end."""
    return f"radio{station}"


def link_local_address(station: Station) -> IPv6Address:
    """Return the IPv6 link-local address, fe80::ff:fe00:hilo, whose identifier is the modified EUI-64."""
    mac = mac_address(station)
    identifier = bytes((mac[0] ^ 0x02,)) + mac[1:3] + b"\xff\xfe" + mac[3:]
    return IPv6Address(b"\xfe\x80" + bytes(6) + identifier)


def disable_ipv6() -> None:
    """Disable IPv6 for interfaces that are made later, where ``/proc/sys`` can be written."""
    for scope in ("all", "default"):
        with contextlib.suppress(OSError):
            Path(f"/proc/sys/net/ipv6/conf/{scope}/disable_ipv6").write_text("1", encoding="ascii")


def make_pair(station: Station, namespace_fd: int) -> None:
    """Make the pair of a vehicle: the peer here and up, ``wlan0`` in another namespace.

    Raises InterfaceError.
    """
    name = peer_name(station)
    try:
        with IPRoute() as netlink:
            netlink.link(
                "add", kind="veth", ifname=name, mtu=MTU_BYTES,
                peer={
                    "ifname": INTERFACE, "net_ns_fd": namespace_fd, "mtu": MTU_BYTES,
                    "address": mac_address(station).hex(":"),
                },
            )  # fmt: skip
            (index,) = netlink.link_lookup(ifname=name)
            with contextlib.suppress(NetlinkError):  # a kernel without IPv6
                netlink.link("set", index=index, IFLA_AF_SPEC=_NO_ADDRESS)
            netlink.link("set", index=index, arp=False, state="up")
    except NetlinkError as error:
        raise _explained(station, error) from None


def prepare_tap(station: Station, queue_frames: int) -> None:
    """Give ``wlan0``, a TAP interface, its MAC address and a transmit queue. Raises InterfaceError."""
    try:
        with IPRoute() as netlink:
            (index,) = netlink.link_lookup(ifname=INTERFACE)
            address = mac_address(station).hex(":")
            netlink.link("set", index=index, address=address, mtu=MTU_BYTES, txqlen=queue_frames)
    except NetlinkError as error:
        raise _explained(station, error) from None


def configure(station: Station) -> None:
    """Give ``wlan0`` its addresses and routes, and let it and the loopback up. Raises InterfaceError."""
    address, broadcast = IPv4Address(ipv4_address(station)), IPv4Address(GROUP_IPV4_ADDRESS)
    try:
        set_offloads_off(INTERFACE)
        with IPRoute() as netlink:
            netlink.link("set", index=_LOOPBACK_INDEX, state="up")
            index = _set_up(netlink, INTERFACE, str(address), IPV4_PREFIX_BITS, broadcast=str(broadcast))
            for destination in (_MULTICAST_IPV4, _LIMITED_BROADCAST):
                netlink.route("add", dst=destination, oif=index, scope="link")
            with contextlib.suppress(NetlinkError):
                local = str(link_local_address(station))
                netlink.addr("add", index=index, address=local, prefixlen=64, flags=_IFA_F_NODAD)
    except NetlinkError as error:
        raise _explained(station, error) from None


def make_companion_pair(station: Station, namespace_fd: int, address: str) -> None:
    """Make a vehicle's second pair: the autopilot's end here, and ``eth0`` in another namespace.

    The autopilot's end is up and has an IPv4 address. Raises InterfaceError.
    """
    name = COMPANION_INTERFACE
    try:
        with IPRoute() as netlink:
            netlink.link(
                "add", kind="veth", ifname=name, mtu=MTU_BYTES,
                peer={"ifname": name, "net_ns_fd": namespace_fd, "mtu": MTU_BYTES},
            )  # fmt: skip
            _set_up(netlink, name, address, COMPANION_PREFIX_BITS)
    except NetlinkError as error:
        raise _explained(station, error, name) from None


def configure_companion(station: Station, address: str) -> None:
    """Give ``eth0`` an IPv4 address and let it up. Raises InterfaceError."""
    try:
        with IPRoute() as netlink:
            _set_up(netlink, COMPANION_INTERFACE, address, COMPANION_PREFIX_BITS)
    except NetlinkError as error:
        raise _explained(station, error, COMPANION_INTERFACE) from None


def _set_up(netlink: IPRoute, name: str, address: str, prefix_bits: int, **settings: str) -> int:
    """Let an interface up with one IPv4 address and no IPv6; return its index."""
    (index,) = netlink.link_lookup(ifname=name)
    with contextlib.suppress(NetlinkError):  # a kernel without IPv6
        netlink.link("set", index=index, IFLA_AF_SPEC=_NO_ADDRESS)
    netlink.link("set", index=index, state="up")
    netlink.addr("add", index=index, address=address, prefixlen=prefix_bits, **settings)
    return int(index)


def is_running(name: str) -> bool:
    """Whether an interface is up and can send: the kernel reports it some time after its configuration."""
    request = bytearray(struct.pack("16sH22x", name.encode(), 0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, _SIOCGIFFLAGS, request)
    return bool(struct.unpack_from("16xH", request)[0] & _IFF_RUNNING)


def set_offloads_off(name: str) -> None:
    """Let the kernel complete packets before it passes them to an interface: checksums and segments.

    What the interface does not have cannot be switched, and is skipped. Raises OSError without the interface.
    """
    socket.if_nametoindex(name)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for command in _OFFLOADS.values():
            value = ctypes.create_string_buffer(struct.pack("II", command, 0))
            request = struct.pack("16sP16x", name.encode(), ctypes.addressof(value))
            with contextlib.suppress(OSError):
                fcntl.ioctl(any_socket, _SIOCETHTOOL, request)


def _explained(station: Station, error: NetlinkError, interface: str = INTERFACE) -> InterfaceError:
    line = f"station {station}: cannot make {interface}: {os.strerror(error.code)}"
    if error.code == errno.EOPNOTSUPP:
        return NoVeth(f"{line}; is the kernel module `veth` available?")
    return InterfaceError(line)
