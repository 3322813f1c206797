"""Row layouts of the emulator's binary logs, which `netsim.emulator.records` fills in the same order."""

import numpy as np

FRAME_LOG = np.dtype(
    [
        ("start_ns", "i8"), ("end_ns", "i8"), ("source", "i4"), ("destination", "i4"), ("kind", "S16"),
        ("mode", "S16"), ("bytes", "i4"), ("seq", "i8"),
        ("delivered", "i4"), ("collided", "i4"), ("lost_to_noise", "i4"),
    ]
)  # fmt: skip
"""One `FrameRecord`."""

SESSION_LOG = np.dtype(
    [
        ("measured_ns", "i8"), ("initiator", "i4"), ("peer", "i4"), ("status", "S16"),
        ("distance_m", "f8"), ("true_distance_m", "f8"), ("distance_std_m", "f8"),
        ("round_trips", "i4"), ("rssi_dbm", "f8"),
    ]
)  # fmt: skip
"""One `netsim.ftm.initiator.Ranging`: the result of a ranging request."""

RECEPTION_LOG = np.dtype(
    [
        ("frame", "i8"), ("start_ns", "i8"), ("source", "i4"), ("receiver", "i4"),
        ("rx_power_dbm", "f4"), ("sinr_db", "f4"), ("outcome", "u1"), ("reception", "u1"),
    ]
)  # fmt: skip
"""A frame at one station: the frame's number among the rows of `FRAME_LOG`, and the codes of
`netsim.phy.receptions.OUTCOMES` and ``STATES``."""
