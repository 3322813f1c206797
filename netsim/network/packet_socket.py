"""Packet sockets: all frames that a vehicle's ``wlan0`` sends, read at the bridge's end of its pair.

Sources: packet(7), linux/if_packet.h.
"""

import contextlib
import socket
import struct

from netsim.network.ethernet import HEADER_BYTES, tagged
from netsim.wire.packets import MAX_PACKET_BYTES

BUFFER_BYTES = 4_194_304
"""Kernel's receive buffer, a packet of 1500 bytes takes some 2.3 kB; frames beyond it are dropped."""
_SOL_PACKET, _PACKET_STATISTICS, _PACKET_AUXDATA, _PACKET_IGNORE_OUTGOING = 263, 6, 8, 23
_ETH_P_ALL = 3
_SO_RCVBUFFORCE = 33
_AUXDATA = struct.Struct("=IIIHHHH")
"""status, length, captured length, offsets of MAC and network header, VLAN control, VLAN EtherType."""
_VLAN_VALID = 0x10
_LONGEST_BYTES = HEADER_BYTES + MAX_PACKET_BYTES + 1
"""Longer frames are cut to this length, which the bridge drops as too long."""
_CONTROL_BYTES = socket.CMSG_SPACE(_AUXDATA.size) if hasattr(socket, "CMSG_SPACE") else 0


def open_packet_socket(interface: str) -> socket.socket:
    """Return a non-blocking socket for the frames that arrive at an interface. Raises OSError."""
    # without a protocol until it is bound, or it would receive from all interfaces
    opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
    try:
        opened.setblocking(False)  # noqa: FBT003
        opened.setsockopt(_SOL_PACKET, _PACKET_IGNORE_OUTGOING, 1)
        opened.setsockopt(_SOL_PACKET, _PACKET_AUXDATA, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)  # at most net.core.rmem_max
        with contextlib.suppress(OSError):  # beyond this limit, where the kernel permits it
            opened.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, BUFFER_BYTES)
        opened.bind((interface, _ETH_P_ALL))
    except BaseException:
        opened.close()
        raise
    return opened


class PacketSocket:
    """Frames of one interface, for one thread."""

    def __init__(self, opened: socket.socket) -> None:
        self._socket = opened
        self._kernel_drops = 0
        self.undelivered = 0
        """Frames that the interface has not taken, because it is down or out of memory."""

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._socket.fileno()

    def read(self) -> bytes | None:
        """Return the next frame, with its VLAN tag; None without any."""
        try:
            frame, ancillary, _, _ = self._socket.recvmsg(_LONGEST_BYTES, _CONTROL_BYTES)
        except OSError:  # none, or the interface is down
            return None
        for level, kind, data in ancillary:
            if level == _SOL_PACKET and kind == _PACKET_AUXDATA and len(data) >= _AUXDATA.size:
                status, *_, control, tag_ether_type = _AUXDATA.unpack_from(data)
                if status & _VLAN_VALID:
                    return tagged(frame, tag_ether_type, control)
        return frame

    def write(self, frame: bytes) -> None:
        """Let ``wlan0`` receive a frame."""
        try:
            self._socket.send(frame)
        except OSError:
            self.undelivered += 1

    @property
    def kernel_drops(self) -> int:
        """Number of frames so far for which the receive buffer had no room."""
        statistics = self._socket.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8)
        _, drops = struct.unpack("=II", statistics)  # since the last call
        self._kernel_drops += drops
        return self._kernel_drops

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
