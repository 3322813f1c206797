"""Row layouts of the emulator's binary logs: the fields of `netsim.emulator.records`, in the same order."""

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
