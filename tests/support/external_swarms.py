"""Swarms whose autopilots are other programs: a calm scenario, free ports, heights that were flown."""

import random
import socket
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

CALM = """
[run]
silence_limit_s = 3.0
[formation]
height_m = 3.0
columns = 1
[antenna]
wavelength_m = 10.0
[wind]
mean_n = 0.0
[sensors]
profile = "ideal"
[onboard]
localisation = "gps"
[radio]
bandwidth_mhz = 80
"""
_BELOW_EPHEMERAL = range(20_000, 32_000, 16)


def free_base(count: int, kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """Return the first of ``count`` free ports, at most 16, which the system gives to no other socket.

    Tests of several processes at once start their search anywhere.
    """
    bases = list(_BELOW_EPHEMERAL)
    random.SystemRandom().shuffle(bases)
    for base in bases:
        try:
            for port in range(base, base + count):
                with socket.socket(socket.AF_INET, kind) as probe:
                    probe.bind(("127.0.0.1", port))
        except OSError:
            continue
        return base
    raise AssertionError("no ports")


def heights_m(folder: Path, since_s: float) -> list[float]:
    """Return the mean true height of each vehicle in a run's table from a time on."""
    rows = pq.read_table(folder / "flight.parquet", columns=["time_us", "uav", "pos_ned_m.d"]).to_pydict()
    times_s, vehicles = np.array(rows["time_us"]) * 1e-6, np.array(rows["uav"])
    down_m = np.array(rows["pos_ned_m.d"])
    return [-down_m[(vehicles == i) & (times_s >= since_s)].mean() for i in sorted(set(vehicles.tolist()))]
