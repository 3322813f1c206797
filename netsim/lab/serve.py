"""Run an emulator in real time for programs that join as guests."""

import contextlib
import sys
import threading
import time

import msgspec

from netsim.lab.bench import ring_ned_m
from netsim.model.config import GuestConfig, RadioConfig, ServerConfig
from netsim.transport.server import Server
from netsim.wire.lockstep import Advance

STEP_US = 4_000


def with_guests(radio: RadioConfig, stations: int, radius_m: float) -> RadioConfig:
    """Return the settings with guests s0, s1, ... on a circle."""
    guests = tuple(
        GuestConfig(name=f"s{i}", pos_ned_m=place) for i, place in enumerate(ring_ned_m(stations, radius_m))
    )
    return msgspec.structs.replace(radio, guests=guests)


def serve_in_real_time(config: ServerConfig, *, speed: float) -> None:
    """Serve until Ctrl-C, after one line with endpoint and stations.

    Simulated time 0 is the present time of the host's clock, which captures show. Raises TransportError,
    OSError, ValueError.
    """
    wall_start_s = time.monotonic()
    config = msgspec.structs.replace(config, epoch_unix_us=time.time_ns() // 1_000)
    pause = threading.Event()
    with contextlib.closing(Server(config)) as server:
        names = ", ".join(guest.name for guest in config.radio.guests)
        sys.stdout.write(f"{server.endpoint} stations {names}\n")
        sys.stdout.flush()
        to_us = 0
        while True:
            to_us += STEP_US
            request = Advance(
                to_us=to_us,
                release_us=to_us,
                at_us=to_us - STEP_US,
                pos_ned_m=b"",
                vel_ned_m_s=b"",
                q_ned_frd=b"",
                extra_attenuation_db=config.radio.extra_attenuation_db,
            )
            server.advance(request)
            ahead_s = to_us * 1e-6 / speed - (time.monotonic() - wall_start_s)
            if ahead_s > 0.0:
                pause.wait(ahead_s)
