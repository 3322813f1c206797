"""The process that hosts vehicles' programs, with a stand-in for the emulator that loses no packet."""

import contextlib
import json
import os
import queue
import shutil
import site
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import msgspec
import pytest
from other_user import OTHER_UID
from paths import ROOT
from radio_access import TCP

from foundation.processes.child_protocol import Finished, Ready
from netsim.network.messages import NetworkConfig, ProgramConfig, ProgramEnded, ProgramStarted
from netsim.network.namespaces import why_not
from netsim.transport.access_control import Rights, User
from netsim.transport.lockstep_radio import packets_received_key, packets_sent_key
from netsim.transport.zenoh_session import Transport
from netsim.wire.addresses import is_group, station_of
from netsim.wire.packets import ReceivedPacket, ReceivedPackets, decode_sent, encode_packets

RUN, USER = "test", User("packets", "1234")
LIMIT_S = 20.0
_CHECK = (
    "import os, sys, netsim.network.host, netsim.network.interfaces; "
    "sys.exit(not os.access(sys.executable, os.X_OK))"
)
_event = msgspec.json.Decoder(Ready | Finished | ProgramStarted | ProgramEnded)


@pytest.fixture
def namespaces():
    """Skip the test where the system permits no namespaces."""
    if reason := why_not():
        pytest.skip(reason)


def needs(*programs):
    """Return a mark that skips a test without these programs."""
    missing = [program for program in programs if shutil.which(program) is None]
    return pytest.mark.skipif(bool(missing), reason=f"not installed: {', '.join(missing)}")


def python_of_others():
    """Return an interpreter of this version that another user may run, and its environment; or skip."""
    packages = os.pathsep.join([str(ROOT), *site.getsitepackages()])
    environment = os.environ | {"PYTHONPATH": packages, "PYTHONDONTWRITEBYTECODE": "1"}
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    for python in (sys.executable, f"/usr/bin/{version}"):
        command = [*as_other(), python, "-c", _CHECK]
        with contextlib.suppress(OSError):
            if subprocess.run(command, env=environment, capture_output=True, check=False).returncode == 0:
                return python, environment
    pytest.skip("another user cannot run this checkout")


def as_other():
    """Return the beginning of a command that runs as another user."""
    return ["setpriv", "--reuid", str(OTHER_UID), "--regid", str(OTHER_UID), "--clear-groups"]


class Channel:
    """The emulator's end: a router that passes each packet to its receivers at once, and reports its end.

    With ``hold`` it reports no ends before `release`.
    """

    def __init__(self, stations, *, hold=False):
        self.stations, self.packets, self._held = stations, [], [] if hold else None
        self._transport = Transport.listen(TCP, [Rights(USER, shares=("**",))])
        self.endpoint = self._transport.endpoint
        self._sender = self._transport.sender(packets_received_key(RUN))
        self._lock = threading.Lock()
        self._transport.subscribe(packets_sent_key(RUN), self._on_sent)

    def release(self):
        """Report the ends of the packets so far, and of all later ones at once."""
        with self._lock:
            ended, self._held = self._held, None
        self.publish(ReceivedPackets(packets=(), ended=tuple(ended)))

    def publish(self, message):
        self._sender.send(encode_packets(message))

    def publish_bytes(self, payload):
        self._sender.send(payload)

    def close(self):
        self._transport.close()

    def _on_sent(self, payload):
        message = decode_sent(payload)
        received = tuple(self._received(packet) for packet in message.packets)
        ended = tuple((packet.station, 1) for packet in message.packets)
        with self._lock:
            self.packets += message.packets
            if self._held is not None:
                self._held += ended
                ended = ()
        self.publish(ReceivedPackets(packets=received, ended=ended))

    def _received(self, packet):
        if is_group(packet.destination):
            stations = tuple(each for each in self.stations if each != packet.station)
        else:
            stations = (station_of(packet.destination),)
        return ReceivedPacket(
            stations=stations, source=packet.station, destination=packet.destination,
            ether_type=packet.ether_type, due_ns=time.monotonic_ns(), payload=packet.payload,
        )  # fmt: skip


def network_config(channel, programs, **settings):
    """Return settings of the process for the stations of a channel."""
    return NetworkConfig(
        run_id=RUN, endpoint=channel.endpoint, user=USER.name, password=USER.password,
        stations=tuple(channel.stations), programs=programs, **settings,
    )  # fmt: skip


class HostProcess:
    """``python -m netsim.network`` as a child; its folder and logs are removed by `close`.

    ``programs`` are pairs of a station and a command, or with a dictionary of further settings. ``before``
    is the beginning of its command.
    """

    def __init__(self, channel, programs, *, other_user=False, before=(), **settings):
        self.folder = Path(tempfile.mkdtemp(prefix="coflight-test-"))
        self.folder.chmod(0o777)
        self._events: queue.SimpleQueue = queue.SimpleQueue()
        python, environment = python_of_others() if other_user else (sys.executable, None)
        configs = tuple(self._program(index, *each) for index, each in enumerate(programs))
        path = self.folder / "network.json"
        path.write_bytes(msgspec.json.encode(network_config(channel, configs, **settings)))
        user = as_other() if other_user else ()
        self.process = subprocess.Popen(
            [*before, *user, python, "-m", "netsim.network", "--config", path, "--supervised"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment,
        )  # fmt: skip
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _program(self, index, station, command, more=None):
        settings = {"log_path": str(self.folder / f"{index}.log"), "folder": str(self.folder)} | (more or {})
        return ProgramConfig(name="program", station=station, command=tuple(command), **settings)

    def _read(self):
        for line in self.process.stdout:
            self._events.put(_event.decode(line))
        self._events.put(None)

    def event(self, kind, **values):
        """Return the next event of a kind with these values; others are skipped."""
        deadline_s = time.monotonic() + LIMIT_S
        while True:
            try:
                event = self._events.get(timeout=deadline_s - time.monotonic())
            except (queue.Empty, ValueError):
                raise AssertionError(f"no {kind.__name__} in time") from None
            if event is None:
                raise AssertionError(f"no {kind.__name__}: {self.process.stderr.read().decode()}")
            if isinstance(event, kind) and all(getattr(event, key) == each for key, each in values.items()):
                return event

    def command(self, **command):
        self.process.stdin.write(json.dumps(command).encode() + b"\n")
        self.process.stdin.flush()

    def start(self, programs=None):
        self.command(command="start programs", programs=programs)

    def stop(self):
        """Stop the process and return its counters."""
        self.command(command="stop")
        details = self.event(Finished).details
        assert self.process.wait(LIMIT_S) == 0
        return details

    def log(self, index):
        path = self.folder / f"{index}.log"
        return path.read_text() if path.exists() else ""

    def wait_for_log(self, index, text):
        """Wait until the log of a program contains a text; return the log."""
        deadline_s = time.monotonic() + LIMIT_S
        while text not in (log := self.log(index)):
            assert time.monotonic() < deadline_s, f"no {text!r} in time in {log!r}"
            time.sleep(0.005)
        return log

    def close(self):
        self.process.kill()
        self.process.wait()
        self._reader.join(LIMIT_S)
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            pipe.close()
        shutil.rmtree(self.folder)


@contextlib.contextmanager
def programs_on_vehicles(programs, *, stations=(0, 1, 3), hold=False, **settings):
    """Yield a channel and the process that hosts programs on its stations, when the process is ready."""
    with contextlib.ExitStack() as stack:
        channel = stack.enter_context(contextlib.closing(Channel(stations, hold=hold)))
        host = stack.enter_context(contextlib.closing(HostProcess(channel, programs, **settings)))
        host.ready = host.event(Ready)
        yield channel, host
