"""The emulator's process without a flight: the test is its launcher and its time master."""

import contextlib
import json
import socket
import subprocess
import sys

import msgspec
import numpy as np
from radio_access import unix_socket

from foundation.processes.child_protocol import Stop
from netsim.model.config import RadioConfig, ServerConfig
from netsim.transport.interval_stream import time_masters_end
from netsim.transport.lockstep_radio import RadioClient, vehicles_user
from netsim.transport.radio_users import guest_user, new_passwords, packets_user
from netsim.transport.zenoh_session import Transport
from netsim.wire.lockstep import Advance, pack_rows

RUN = "test"
LEVEL = pack_rows(np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)))
POSES_M = ((0.0, 0.0, -10.0), (0.0, 8.5, -10.0), (2.5, 0.0, -10.0))


class Radio:
    """An emulator's process, and the time master's end of its socket."""

    def __init__(self, folder, stations=3, seed=1, *, packets=False, **radio):
        self.frames_path = folder / "frames.bin"
        self.vehicles = stations
        self.files = contextlib.ExitStack()
        self.socket_path = self.files.enter_context(unix_socket())
        self.passwords = new_passwords(len(radio.get("guests", ())), packets=packets)
        config = ServerConfig(
            run_id=RUN,
            socket_path=self.socket_path,
            passwords=self.passwords,
            stations=stations,
            seed=seed,
            packets=packets,
            radio=RadioConfig(**radio),
            frame_log_path=str(self.frames_path),
        )
        path = folder / "radio.json"
        path.write_bytes(msgspec.json.encode(config))
        own, its = socket.socketpair()
        with its:
            self.process = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "netsim",
                    "--config",
                    path,
                    "--interval-fd",
                    str(its.fileno()),
                    "--supervised",
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                pass_fds=[its.fileno()],
            )
        self.connection, self.clock = own, time_masters_end(own)
        ready = json.loads(self.process.stdout.readline())
        assert ready["event"] == "ready"
        self.endpoint = ready["details"]["endpoint"]

    def client(self, station):
        return RadioClient(
            endpoint=self.endpoint, password=self.passwords.vehicles, run_id=RUN, station=station
        )

    def session(self, guest=None):
        """Return a session as a guest's station or as a vehicle, to be closed in a ``with``."""
        user = vehicles_user(self.passwords.vehicles)
        if guest is not None:
            user = guest_user(guest, self.passwords.guests[guest - self.vehicles])
        return contextlib.closing(Transport.connect(self.endpoint, user))

    def interfaces(self):
        """Return a session as the host of network interfaces, to be closed in a ``with``."""
        user = packets_user(self.passwords.packets)
        return contextlib.closing(Transport.connect(self.endpoint, user))

    def advance(self, to_us, **changes):
        """Request an interval and return its reply."""
        self.request(to_us, **changes)
        return self.clock.receive()

    def request(self, to_us, **changes):
        """Request an interval, whose reply is to be received from `clock`."""
        fields = {"release_us": to_us + 4000, "at_us": to_us - 4000, "extra_attenuation_db": 0.0} | changes
        request = Advance(
            to_us=to_us,
            pos_ned_m=pack_rows(np.array(POSES_M)),
            vel_ned_m_s=pack_rows(np.zeros((3, 3))),
            q_ned_frd=LEVEL,
            **fields,
        )
        self.clock.send(request)

    def stop(self):
        """Stop the process; returns the details of its last message and what influenced the run."""
        self.connection.close()
        self.process.stdin.write(msgspec.json.encode(Stop()) + b"\n")
        self.process.stdin.flush()
        influences = []
        while (finished := json.loads(self.process.stdout.readline()))["event"] == "influenced":
            influences.append(finished["by"])
        finished["details"]["influences"] = influences
        assert self.process.wait(10.0) == 0
        return finished["details"]

    def close(self):
        self.connection.close()
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                pipe.close()
        self.files.close()
