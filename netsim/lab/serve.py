"""Run an emulator in real time for programs that join as guests."""

import contextlib
import signal
import sys
import threading
import time

import msgspec

from netsim.lab.bench import ring_ned_m
from netsim.model.config import GuestConfig, RadioConfig, ServerConfig
from netsim.transport.guest_access import FILE, write_guest_access
from netsim.transport.radio_users import new_passwords
from netsim.transport.server import Server
from netsim.transport.socket_folder import SOCKET, SocketFolder
from netsim.wire.lockstep import Advance

STEP_US = 4_000
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def with_guests(radio: RadioConfig, stations: int, radius_m: float) -> RadioConfig:
    """Return the settings with guests s0, s1, ... on a circle."""
    guests = tuple(
        GuestConfig(name=f"s{i}", pos_ned_m=place) for i, place in enumerate(ring_ned_m(stations, radius_m))
    )
    return msgspec.structs.replace(radio, guests=guests)


def serve_in_real_time(config: ServerConfig, *, speed: float, tcp: bool) -> None:
    """Serve until a signal, after one line with the folder of the guests' file and the stations.

    Listens at a Unix socket in that folder, or with ``tcp`` at the settings' host and port; the folder is
    removed at the end. Simulated time 0 is the present time of the host's clock, which captures show. Only
    for the main thread. Raises KeyboardInterrupt for Ctrl-C and SystemExit, with a status of 128 plus its
    number, for SIGTERM and SIGHUP; further signals are ignored then. Raises TransportError, OSError,
    ValueError.
    """
    wall_start_s = time.monotonic()
    with contextlib.ExitStack() as stack:
        for number in _SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:  # as after nohup
                signal.signal(number, _end)
        made = SocketFolder()
        stack.callback(made.remove)
        folder = made.path
        config = msgspec.structs.replace(
            config,
            epoch_unix_us=time.time_ns() // 1_000,
            socket_path=None if tcp else str(folder / SOCKET),
            passwords=new_passwords(len(config.radio.guests)),
        )
        server = stack.enter_context(contextlib.closing(Server(config)))
        write_guest_access(folder / FILE, config, server.endpoint)
        names = ", ".join(guest.name for guest in config.radio.guests)
        sys.stdout.write(f"{folder} stations {names}\n")
        sys.stdout.flush()
        _serve(server, config, wall_start_s=wall_start_s, speed=speed)


def _end(number: int, _frame: object) -> None:
    """End the process by an exception, so that its files are removed; ignore signals meanwhile."""
    for each in _SIGNALS:
        signal.signal(each, signal.SIG_IGN)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(128 + number)


def _serve(server: Server, config: ServerConfig, *, wall_start_s: float, speed: float) -> None:
    pause = threading.Event()
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
