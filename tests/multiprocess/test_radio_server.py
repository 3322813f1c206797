"""The emulator's real process between real Zenoh clients.

What is handed over arrives, in time, whatever comes first.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys

import msgspec
import numpy as np
import pytest

from netsim.child import Stop
from netsim.config import RadioConfig
from netsim.logs import FRAME_LOG
from netsim.radio import RadioClient, RadioLost, advance_key, receive_key, transmit_key
from netsim.record_log import read
from netsim.server import ServerConfig
from netsim.transport import Transport, TransportError
from netsim.wire.messages import (
    Ack,
    Advance,
    Advanced,
    Broadcast,
    Delivery,
    FtmRequest,
    FtmResult,
    Survey,
    decode,
    encode,
    pack_rows,
)

pytestmark = pytest.mark.multiprocess

RUN = "test"
LEVEL = pack_rows(np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)))
POSES_M = ((0.0, 0.0, -10.0), (0.0, 8.5, -10.0), (2.5, 0.0, -10.0))


class Radio:
    """An emulator's process, and the time master that tells it how far to go."""

    def __init__(self, folder, stations=3, seed=1, **radio):
        self.frames_path = folder / "frames.bin"
        config = ServerConfig(
            run_id=RUN,
            stations=stations,
            seed=seed,
            radio=RadioConfig(**radio),
            frame_log_path=str(self.frames_path),
        )
        path = folder / "radio.json"
        path.write_bytes(msgspec.json.encode(config))
        self.process = subprocess.Popen(
            [sys.executable, "-m", "netsim", "--config", str(path), "--supervised"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        ready = json.loads(self.process.stdout.readline())
        assert ready["event"] == "ready"
        self.endpoint = ready["details"]["endpoint"]
        self.transport = Transport.connect(self.endpoint)
        self.asker = self.transport.asker(advance_key(RUN), timeout_s=10.0)

    def client(self, station):
        return RadioClient(endpoint=self.endpoint, run_id=RUN, station=station)

    def advance(self, to_us, **changes):
        request = Advance(
            to_us=to_us,
            release_us=to_us + 4000,
            at_us=to_us - 4000,
            pos_ned_m=pack_rows(np.array(POSES_M)),
            vel_ned_m_s=pack_rows(np.zeros((3, 3))),
            q_ned_frd=LEVEL,
            **changes,
        )
        return decode(Advanced, self.asker.ask(encode(request)).answer())

    def stop(self):
        """Ask it to end; returns what it said at last."""
        self.transport.close()
        self.process.stdin.write(msgspec.json.encode(Stop()) + b"\n")
        self.process.stdin.flush()
        finished = json.loads(self.process.stdout.readline())
        assert self.process.wait(10.0) == 0
        return finished["details"]

    def close(self):
        self.transport.close()
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                pipe.close()


STATION = """
import sys
from netsim.radio import RadioClient
client = RadioClient(endpoint=sys.argv[1], run_id=sys.argv[2], station=int(sys.argv[3]))
print("here", flush=True)
for line in sys.stdin:
    print(len(client.receive(int(line))), flush=True)
client.close()
"""


@contextlib.contextmanager
def station_process(endpoint, station):
    """A station in a process of its own; for a time on its stdin it prints how many items it has."""
    command = [sys.executable, "-c", STATION, endpoint, RUN, str(station)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline() == b"here\n"
            yield process
        finally:
            process.kill()


@pytest.fixture
def radio(tmp_path):
    with contextlib.closing(Radio(tmp_path)) as each:
        yield each


def test_a_broadcast_and_a_distance_come_to_those_they_are_for_and_not_before_their_time(radio):
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(contextlib.closing(radio.client(i))) for i in range(3)]
        clients[0].send(
            4000, [Broadcast(seq=1, at_us=5000, payload=b"hello"), FtmRequest(seq=2, at_us=5200, peer=1)]
        )
        for to_us in range(8000, 60_000, 4000):
            assert radio.advance(to_us).unresponsive == ()
        heard = [client.receive(11_999) for client in clients]
        assert heard == [[], [], []]  # the interval up to 8000 us is released at 12000 us
        for station in (1, 2):
            delivery, survey = clients[station].receive(64_000)
            assert isinstance(delivery, Delivery)
            assert (delivery.source, delivery.seq, delivery.payload) == (0, 1, b"hello")
            assert 5_000_000 < delivery.received_ns < 8_000_000
            assert isinstance(survey, Survey)
            assert survey.ended_ns == 8_000_000
        result, survey = clients[0].receive(64_000)
        assert isinstance(result, FtmResult)
        # a request and eight measurement frames with their ACKs last longer than the 44 us of the broadcast
        assert survey.busy_ns > 9 * 44_000
        assert (result.status, result.seq, result.peer) == ("ok", 2, 1)
        assert result.distance_m == pytest.approx(8.5, abs=1.0)


def test_what_belongs_to_a_later_step_waits_even_if_it_comes_first(radio):
    with contextlib.closing(radio.client(0)) as sender, contextlib.closing(radio.client(1)) as receiver:
        # handed over in the step at 8000 us, before the interval that ends there is simulated
        sender.send(8000, [Broadcast(seq=1, at_us=8000, payload=b"x")])
        radio.advance(8000)
        assert radio.advance(12_000).to_us == 12_000
        delivery, _ = receiver.receive(16_000)
        assert delivery.received_ns > 8_000_000


def test_a_quiet_air_says_until_when(radio):
    quiet = radio.advance(8000)
    assert quiet.quiet_until_us > 10**12
    assert quiet.busy_ns == 0
    with contextlib.closing(radio.client(0)) as sender:
        sender.send(8000, [Broadcast(seq=1, at_us=30_000, payload=b"x")])
        assert 12_000 < radio.advance(12_000).quiet_until_us <= 30_200
        radio.advance(40_000)
        assert radio.advance(44_000).busy_ns > 0


def test_hostile_bytes_change_nothing_and_are_counted(radio):
    rng = np.random.default_rng(5)
    with (
        contextlib.closing(Transport.connect(radio.endpoint)) as stranger,
        contextlib.closing(radio.client(1)) as client,
    ):
        for key in (transmit_key(RUN), advance_key(RUN), receive_key(RUN, 1)):
            asker = stranger.asker(key, timeout_s=0.05)
            for size in (0, 1, 7, 300):
                assert asker.ask(rng.bytes(size)).answer() is None
        # well formed, and for another number of stations or from none of them
        asker = stranger.asker(advance_key(RUN), timeout_s=0.05)
        assert (
            asker.ask(
                encode(Advance(to_us=1, release_us=2, at_us=0, pos_ned_m=b"", vel_ned_m_s=b"", q_ned_frd=b""))
            ).answer()
            is None
        )
        nowhere, still = pack_rows(np.full((3, 3), np.nan)), pack_rows(np.zeros((3, 3)))
        askew = pack_rows(np.full((3, 4), np.inf))
        far = pack_rows(np.full((3, 3), 1e308))
        for senseless in (
            {"pos_ned_m": nowhere},
            {"pos_ned_m": far},
            {"vel_ned_m_s": nowhere},
            {"vel_ned_m_s": far},
            {"q_ned_frd": askew},
            {"q_ned_frd": pack_rows(np.full((3, 4), 1e200))},
            {"silent": (3,)},
            {"range_offsets_m": ((3, 1.0),)},
            {"extra_attenuation_db": -1e6},
            {"extra_attenuation_db": float("nan")},
        ):
            state = {"pos_ned_m": still, "vel_ned_m_s": still, "q_ned_frd": LEVEL, **senseless}
            request = Advance(to_us=1, release_us=2, at_us=0, **state)
            assert asker.ask(encode(request)).answer() is None
        assert radio.advance(8000).to_us == 8000
        assert client.malformed == 4
    assert radio.stop()["malformed"] == 19


def test_a_station_that_is_gone_does_not_hold_up_the_others(radio):
    with contextlib.closing(radio.client(0)) as sender, contextlib.closing(radio.client(1)) as receiver:
        radio.client(2).close()
        sender.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"x")])
        assert radio.advance(8000).unresponsive == (2,)
        assert len(receiver.receive(12_000)) == 2  # and a survey
        sender.send(8000, [Broadcast(seq=2, at_us=8000, payload=b"x")])
        assert radio.advance(12_000, silent=(2,)).unresponsive == ()


def test_a_station_that_sleeps_through_a_delivery_gets_it_once_when_it_wakes(radio):
    with contextlib.ExitStack() as stack:
        sender, awake = (stack.enter_context(contextlib.closing(radio.client(i))) for i in range(2))
        sleeper = stack.enter_context(station_process(radio.endpoint, 2))
        os.kill(sleeper.pid, signal.SIGSTOP)
        sender.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"x")])
        assert radio.advance(8000).unresponsive == (2,)
        assert radio.advance(8000).unresponsive == (2,)  # asked again, and simulated no second time
        assert len(awake.receive(12_000)) == 2  # and a survey
        os.kill(sleeper.pid, signal.SIGCONT)
        assert radio.advance(8000).unresponsive == ()
        sleeper.stdin.write(b"12000\n")
        sleeper.stdin.flush()
        assert sleeper.stdout.readline() == b"2\n"
        # and one that is called gone is waited for no longer
        os.kill(sleeper.pid, signal.SIGSTOP)
        sender.send(8000, [Broadcast(seq=2, at_us=8000, payload=b"x")])
        assert radio.advance(12_000).unresponsive == (2,)
        assert radio.advance(12_000, silent=(2,)).unresponsive == ()


def test_a_cut_channel_delivers_nothing(radio):
    with contextlib.closing(radio.client(0)) as sender, contextlib.closing(radio.client(1)) as receiver:
        sender.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"x"), FtmRequest(seq=2, at_us=4500, peer=1)])
        for to_us in range(8000, 300_000, 4000):
            radio.advance(to_us, extra_attenuation_db=200.0)
        assert receiver.receive(400_000) == []
        result, _ = sender.receive(400_000)
        assert result.status in {"no_response", "timeout"}


def test_its_frames_are_logged_and_the_same_run_gives_the_same_bytes(tmp_path):
    logs = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        with contextlib.closing(Radio(folder, seed=9)) as radio, contextlib.ExitStack() as stack:
            clients = [stack.enter_context(contextlib.closing(radio.client(i))) for i in range(3)]
            for step in range(1, 50):
                order = clients if folder.name == "a" else clients[::-1]  # who comes first must not matter
                for client in order:
                    client.send(4000 * step, [Broadcast(seq=step, at_us=4000 * step, payload=b"x" * 100)])
                radio.advance(4000 * (step + 1))
            radio.stop()
            logs.append(radio.frames_path.read_bytes())
    assert logs[0] == logs[1]
    frames = read(tmp_path / "a" / "frames.bin", FRAME_LOG)
    assert {b"data"} <= set(frames["kind"].tolist())


def test_an_endpoint_where_nobody_listens_and_a_radio_that_died_are_clear_errors(radio):
    with pytest.raises(TransportError, match=r"cannot connect to tcp/127\.0\.0\.1:1"):
        Transport.connect("tcp/127.0.0.1:1")
    with contextlib.closing(radio.client(0)) as client:
        radio.process.kill()
        radio.process.wait()
        with pytest.raises(RadioLost, match=r"station 0: the 802\.11 emulator does not acknowledge"):
            client.send(4000, [])


def test_the_process_ends_when_its_parent_lets_go(radio):
    radio.process.stdin.close()
    assert radio.process.wait(10.0) == 0


def test_a_port_in_use_is_one_line(radio, tmp_path):
    port = int(radio.endpoint.rpartition(":")[2])
    config = ServerConfig(run_id=RUN, stations=1, seed=1, port=port)
    (tmp_path / "second.json").write_bytes(msgspec.json.encode(config))
    second = subprocess.run(
        [sys.executable, "-m", "netsim", "--config", str(tmp_path / "second.json")],
        check=False,
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert second.returncode == 2
    assert second.stderr.count("\n") == 1
    assert f"cannot listen on 127.0.0.1:{port}" in second.stderr


def test_acks_are_what_they_say():
    assert decode(Ack, encode(Ack())) == Ack()
