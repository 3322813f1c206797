"""Convert a frame that has ended at all stations to a `Transmission` for observers of the channel."""

from netsim.mac.initial_state import MODE_NAMES
from netsim.model import columns as c
from netsim.model.config import BandwidthMhz
from netsim.model.tables import Tables
from netsim.phy.frames import Frame, FrameKind
from netsim.phy.modes import phy_mode
from netsim.phy.propagation import LinkRow
from netsim.phy.signals import Transmission

KINDS = list(FrameKind)
"""Frame kinds in the order of `netsim.model.columns`."""


def transmission_of(tables: Tables, row: int, bandwidth_mhz: BandwidthMhz, body: object) -> Transmission:
    """Return the transmission of a row of signals whose outcomes have just been determined."""
    signal = tables.signals[row].tolist()
    frame = Frame(
        kind=KINDS[signal[c.KIND]],
        source=signal[c.SOURCE],
        destination=signal[c.TO],
        mode=phy_mode(MODE_NAMES[signal[c.MODE]], bandwidth_mhz),
        frame_bytes=signal[c.BYTES],
        nav_ns=signal[c.NAV],
        seq=signal[c.SEQ],
        sequence=signal[c.FRAME_SEQUENCE],
        body=body,
    )
    budget = LinkRow(
        tables.budgets_mw[frame.source].copy(), tables.delays_ns[row].copy(), signal[c.LONGEST_DELAY]
    )
    transmission = Transmission(frame, signal[c.START], budget, tables.powers_mw[row].copy())
    notes = tables.ends[c.NOTES]
    transmission.delivered = (notes == c.DELIVERED).nonzero()[0].tolist()
    transmission.collided = (notes == c.COLLIDED).nonzero()[0].tolist()
    transmission.lost_to_noise = (notes == c.LOST).nonzero()[0].tolist()
    return transmission
