"""TAP interfaces: all frames that a vehicle's ``wlan0`` sends are read at one file, without a peer interface.

They need no kernel module for veth pairs, but the device file, and cost a third of a packet socket's read.
What is not read waits in the interface's transmit queue. All functions act in the calling thread's network
namespace. The interface is the same for `netsim.network.host` as a `netsim.network.packet_socket`.

Sources: linux/if_tun.h; Linux, Documentation/networking/tuntap.rst; proc_pid_net(5).
"""

import fcntl
import os
import struct
from pathlib import Path

from netsim.network.ethernet import HEADER_BYTES
from netsim.wire.packets import MAX_PACKET_BYTES

QUEUE_FRAMES = 2_000
"""Length of the transmit queue; frames beyond it are dropped."""
_DEVICE = Path("/dev/net/tun")
_TUNSETIFF = 0x400454CA
_IFF_TAP, _IFF_NO_PI = 0x0002, 0x1000
_LONGEST_BYTES = HEADER_BYTES + MAX_PACKET_BYTES + 1
"""Longer frames are cut to this length, which the bridge drops as too long."""
_TABLE_BYTES = 65_536
_TRANSMIT_DROPS = 11
"""Column of ``/proc/net/dev`` after the name: 8 of reception, then bytes, packets, errors, drops"""


def open_tap(name: str) -> tuple[int, int]:
    """Make an interface; return its file and that of the namespace's table of interfaces. Raises OSError."""
    tap = os.open(_DEVICE, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.ioctl(tap, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TAP | _IFF_NO_PI))
        return tap, os.open("/proc/thread-self/net/dev", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        os.close(tap)
        raise


class TapFile:
    """Frames of one interface, for one thread; of the descriptors of `open_tap`."""

    def __init__(self, name: str, tap: int, table: int) -> None:
        self._prefix, self._tap, self._table = f"{name}:", tap, table
        self.undelivered = 0
        """Frames that the interface has not taken, because it is down or out of memory."""

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._tap

    def read(self) -> bytes | None:
        """Return the next frame; None without any."""
        try:
            return os.read(self._tap, _LONGEST_BYTES)
        except OSError:  # none, or the interface is down
            return None

    def write(self, frame: bytes) -> None:
        """Let ``wlan0`` receive a frame."""
        try:
            os.write(self._tap, frame)
        except OSError:
            self.undelivered += 1

    @property
    def kernel_drops(self) -> int:
        """Number of frames so far for which the transmit queue had no room."""
        for line in os.pread(self._table, _TABLE_BYTES, 0).decode().splitlines():
            name, *columns = line.split()
            if name == self._prefix:
                return int(columns[_TRANSMIT_DROPS])
        return 0

    def close(self) -> None:
        """Close the files, by which the interface ends."""
        os.close(self._tap)
        os.close(self._table)
