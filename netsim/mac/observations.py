"""Convert a frame that has ended at all stations to a `Transmission` for observers of the channel."""

from netsim.mac.initial_state import MODE_NAMES
from netsim.model import codes as c
from netsim.model.config import BandwidthMhz
from netsim.model.tables import Tables
from netsim.phy.frames import Frame, FrameKind
from netsim.phy.modes import phy_mode
from netsim.phy.propagation import LinkRow
from netsim.phy.signals import Transmission

KINDS = list(FrameKind)
"""Frame kinds in the order of `netsim.model.codes`."""


def transmission_of(tables: Tables, row: int, bandwidth_mhz: BandwidthMhz, body: object) -> Transmission:
    """Return the transmission of a row of signals whose outcomes have just been determined."""
    signal, paths = tables.signals[row], tables.paths[row]
    frame = Frame(
        kind=KINDS[signal.kind],
        source=int(signal.source),
        destination=int(signal.to),
        mode=phy_mode(MODE_NAMES[signal.mode], bandwidth_mhz),
        frame_bytes=int(signal.frame_bytes),
        nav_ns=int(signal.nav_ns),
        seq=int(signal.seq),
        sequence=int(signal.sequence),
        body=body,
    )
    powers_mw = tables.budgets["power_mw"][frame.source].copy()
    budget = LinkRow(powers_mw, paths["delay_ns"].copy(), int(signal.longest_delay_ns))
    transmission = Transmission(frame, int(signal.start_ns), budget, paths["power_mw"].copy())
    outcomes = tables.ends["receiver_outcome"]
    transmission.delivered = (outcomes == c.DELIVERED).nonzero()[0].tolist()
    transmission.collided = (outcomes == c.COLLIDED).nonzero()[0].tolist()
    transmission.lost_to_noise = (outcomes == c.LOST).nonzero()[0].tolist()
    return transmission
