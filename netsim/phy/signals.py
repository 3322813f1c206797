"""A frame on the air with its outcome, for observers of the whole channel."""

from netsim.phy.frames import Frame
from netsim.phy.path_loss import Doubles
from netsim.phy.propagation import LinkRow


class Transmission:
    """A frame that is or was on the air, and its outcome."""

    __slots__ = (
        "collided", "delays_ns", "delivered", "end_ns", "frame", "longest_delay_ns", "lost_to_noise",
        "powers_mw", "source", "start_ns",
    )  # fmt: skip

    def __init__(self, frame: Frame, start_ns: int, row: LinkRow, powers_mw: Doubles) -> None:
        self.frame = frame
        self.source = frame.source
        self.start_ns = start_ns
        self.end_ns = start_ns + frame.duration_ns
        self.powers_mw = powers_mw
        """Received powers by station; delays are also by station."""
        self.delays_ns = row.delays_ns
        self.longest_delay_ns = row.longest_delay_ns
        self.delivered: list[int] = []
        """Intended receivers that received it."""
        self.collided: list[int] = []
        """Intended receivers that would have received it without other signals."""
        self.lost_to_noise: list[int] = []

    def power_mw(self, station: int) -> float:
        """Return the received power at one station."""
        return self.powers_mw.item(station)

    def delay_ns(self, station: int) -> int:
        """Return the propagation delay to one station."""
        return self.delays_ns.item(station)
