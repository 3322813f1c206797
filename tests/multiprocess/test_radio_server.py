"""The emulator's process with real Zenoh clients: deliveries, order, errors, determinism."""

import contextlib
import queue
import socket
import subprocess
import sys

import msgspec
import numpy as np
import pytest
from radio_process import LEVEL, RUN, Radio

from foundation.records.record_log import read
from netsim.emulator.log_layout import FRAME_LOG
from netsim.emulator.service import EmulatorService
from netsim.model.config import GuestConfig
from netsim.transport.asynchronous_radio import AsynchronousRadio
from netsim.transport.lockstep_radio import (
    MOST_ITEMS,
    RadioLost,
    receive_key,
    transmit_key,
    vehicles_user,
)
from netsim.transport.radio_users import new_passwords
from netsim.transport.server import ServerConfig
from netsim.transport.zenoh_session import Transport, TransportError
from netsim.wire.lockstep import Advance, pack_rows
from netsim.wire.messages import (
    Ack,
    Broadcast,
    Delivery,
    FtmRequest,
    FtmResult,
    Survey,
    TxBatch,
    decode,
    encode,
)

pytestmark = pytest.mark.multiprocess

SENDER = """
import sys
from netsim.transport.lockstep_radio import RadioClient
from netsim.wire.messages import Broadcast
endpoint, password, run_id, station = sys.argv[1:]
client = RadioClient(endpoint=endpoint, password=password, run_id=run_id, station=int(station))
print("ready", flush=True)
for line in sys.stdin:
    client.send(int(line), [Broadcast(seq=1, at_us=int(line), payload=b"last words")])
    print("sent", flush=True)
"""


@contextlib.contextmanager
def sender_process(radio, station):
    """A vehicle's radio in a separate process; broadcasts at each time on its stdin and prints ``sent``."""
    command = [sys.executable, "-c", SENDER, radio.endpoint, radio.passwords.vehicles, RUN, str(station)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout.readline() == b"ready\n"
            yield process
        finally:
            process.kill()


@pytest.fixture
def radio(tmp_path):
    with contextlib.closing(Radio(tmp_path)) as each:
        yield each


def test_broadcasts_and_distances_are_delivered_at_their_time(radio):
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(contextlib.closing(radio.client(i))) for i in range(3)]
        clients[0].send(
            4000, [Broadcast(seq=1, at_us=5000, payload=b"hello"), FtmRequest(seq=2, at_us=5200, peer=1)]
        )
        # 44 us of the broadcast, and a request and eight measurement frames at least 200 us apart
        assert radio.advance(8000, senders=(0,)).delivered == (0, 1, 2)
        assert radio.advance(12_000).delivered == ()
        for station in (1, 2):
            delivery, survey = clients[station].receive(12_000)  # the interval up to 8000 us is released then
            assert isinstance(delivery, Delivery)
            assert (delivery.source, delivery.seq, delivery.payload) == (0, 1, b"hello")
            assert 5_000_000 < delivery.received_ns < 8_000_000
            assert isinstance(survey, Survey)
            assert survey.ended_ns == 8_000_000
        result, survey = clients[0].receive(12_000)
        assert isinstance(result, FtmResult)
        # each of the frames with its ACK lasts longer than the broadcast
        assert survey.busy_ns > 9 * 44_000
        assert (result.status, result.seq, result.peer) == ("ok", 2, 1)
        assert result.distance_m == pytest.approx(8.5, abs=1.0)


def test_batch_of_a_later_step_waits(radio):
    with contextlib.closing(radio.client(0)) as sender, contextlib.closing(radio.client(1)) as receiver:
        # sent in the step at 8000 us, before the interval that ends there is simulated
        sender.send(8000, [Broadcast(seq=1, at_us=8000, payload=b"x")])
        assert radio.advance(8000).delivered == ()
        assert radio.advance(12_000, senders=(0,)).delivered == (1, 2)
        delivery, _ = receiver.receive(16_000)
        assert delivery.received_ns > 8_000_000


def test_quiet_channel_reports_its_next_event(radio):
    quiet = radio.advance(8000)
    assert quiet.quiet_until_us > 10**12
    assert quiet.busy_ns == 0
    with contextlib.closing(radio.client(0)) as sender:
        sender.send(8000, [Broadcast(seq=1, at_us=30_000, payload=b"x")])
        assert 12_000 < radio.advance(12_000, senders=(0,)).quiet_until_us <= 30_200
        radio.advance(40_000)
        assert radio.advance(44_000).busy_ns > 0


def test_malformed_bytes_are_dropped_and_counted(radio):
    rng = np.random.default_rng(5)
    with (
        radio.session() as stranger,
        contextlib.closing(radio.client(1)) as client,
    ):
        for size in (0, 1, 7, 300):
            data = rng.bytes(size)
            assert stranger.asker(transmit_key(RUN), timeout_s=0.05).ask(data).answer() is None
            for key in (transmit_key(RUN), receive_key(RUN, 1)):
                stranger.sender(key).send(data)
        # well formed, of a station that does not exist
        stranger.sender(transmit_key(RUN)).send(encode(TxBatch(station=3, now_us=0, items=())))
        # a later query is answered after all of it has arrived
        assert stranger.asker(transmit_key(RUN), timeout_s=0.05).ask(b"").answer() is None
        with contextlib.closing(radio.client(0)) as sender:
            sender.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"x")])
            assert radio.advance(8000, senders=(0,)).delivered == (1, 2)
        assert len(client.receive(12_000)) == 2  # and a survey
        assert client.malformed == 4
    details = radio.stop()
    assert details["malformed"] == {"vehicles": 4 + 4 + 1 + 1}
    assert details["influences"] == ["a program that uses the vehicles' password"]


@pytest.mark.parametrize(
    "invalid",
    [
        {"pos_ned_m": pack_rows(np.full((3, 3), np.nan))},
        {"pos_ned_m": pack_rows(np.full((3, 3), 1e308))},
        {"pos_ned_m": b""},
        {"vel_ned_m_s": pack_rows(np.full((3, 3), np.nan))},
        {"vel_ned_m_s": pack_rows(np.full((3, 3), 1e308))},
        {"q_ned_frd": pack_rows(np.full((3, 4), np.inf))},
        {"q_ned_frd": pack_rows(np.full((3, 4), 1e200))},
        {"senders": (3,)},
        {"silent": (3,)},
        {"range_offsets_m": ((3, 1.0),)},
        {"to_us": 4000},
    ],
    ids="-".join,
)
def test_invalid_advance_is_refused(invalid):
    hosted = EmulatorService(ServerConfig(run_id=RUN, stations=3, seed=1))
    still = pack_rows(np.zeros((3, 3)))
    state = {"pos_ned_m": still, "vel_ned_m_s": still, "q_ned_frd": LEVEL, "extra_attenuation_db": 0.0}
    hosted.advance(Advance(to_us=4000, release_us=8000, at_us=0, **state))
    with pytest.raises(ValueError, match="rejects the request to advance"):
        hosted.advance(Advance(**({"to_us": 8000, "release_us": 12_000, "at_us": 4000} | state | invalid)))


def test_lost_station_does_not_block_others(radio):
    with contextlib.closing(radio.client(0)) as sender, contextlib.closing(radio.client(1)) as receiver:
        radio.client(2).close()
        sender.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"x")])
        assert radio.advance(8000, senders=(0,)).delivered == (1, 2)
        assert len(receiver.receive(12_000)) == 2  # and a survey
        sender.send(8000, [Broadcast(seq=2, at_us=8000, payload=b"x")])
        assert radio.advance(12_000, senders=(0,), silent=(2,)).delivered == (1,)


def test_missing_batch_blocks_the_channel_until_it_arrives_or_its_sender_is_lost(radio):
    with contextlib.closing(radio.client(0)) as sender, contextlib.closing(radio.client(1)) as late:
        sender.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"x")])
        for _ in range(2):
            waiting = radio.advance(8000, senders=(0, 1, 2))
            assert (waiting.to_us, waiting.missing, waiting.delivered) == (0, (1, 2), ())
        late.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"y")])
        assert radio.advance(8000, senders=(0, 1, 2)).missing == (2,)
        done = radio.advance(8000, senders=(0, 1, 2), silent=(2,))
        assert (done.to_us, done.missing, done.delivered) == (8000, (), (0, 1))


def test_requests_behind_one_with_a_missing_batch_wait_for_its_repetition(radio):
    with contextlib.closing(radio.client(0)) as sender:
        radio.request(8000, senders=(0,))
        radio.request(12_000, senders=(0,))
        assert radio.clock.receive().missing == (0,)
        sender.send(8000, [Broadcast(seq=2, at_us=8000, payload=b"y")])
        sender.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"x")])
        replies = [radio.advance(8000, senders=(0,)), radio.clock.receive(), radio.advance(16_000)]
        assert [(each.to_us, each.missing, each.delivered) for each in replies] == [
            (8000, (), (1, 2)), (12_000, (), (1, 2)), (16_000, (), ()),
        ]  # fmt: skip


def test_last_batch_of_a_killed_vehicle_is_delivered(radio):
    with (
        contextlib.closing(radio.client(1)) as receiver,
        sender_process(radio, 0) as sender,
    ):
        sender.stdin.write(b"4000\n")
        sender.stdin.flush()
        assert sender.stdout.readline() == b"sent\n"
        sender.kill()
        sender.wait()
        assert radio.advance(8000, senders=(0,)).delivered == (1, 2)
        assert receiver.receive(12_000)[0].payload == b"last words"


def test_batch_of_several_messages_is_delivered_completely(radio):
    """64 datagrams of maximum length in one step, the capacity of the radio's queue: 94 kB."""
    with contextlib.closing(radio.client(0)) as sender, contextlib.closing(radio.client(1)) as receiver:
        items = [Broadcast(seq=i, at_us=4000, payload=bytes([i]) * 1472) for i in range(64)]
        assert len(items) > 2 * MOST_ITEMS
        sender.send(4000, items)
        received = []
        if 1 in radio.advance(100_000, at_us=4000, senders=(0,)).delivered:
            received = [item for item in receiver.receive(104_000) if isinstance(item, Delivery)]
        assert [(item.seq, item.payload) for item in received] == [(i.seq, i.payload) for i in items]


def test_a_guest_receives_and_sends_without_lockstep(tmp_path):
    places = [GuestConfig(name="car", pos_ned_m=(0.0, 8.5, -10.0))]
    with (
        contextlib.closing(Radio(tmp_path, guests=places)) as radio,
        contextlib.closing(radio.client(0)) as vehicle,
        radio.session(guest=3) as transport,
    ):
        batches = queue.SimpleQueue()
        guest = AsynchronousRadio(transport, run_id=RUN, station=3, put=batches.put)
        vehicle.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"x")])
        assert radio.advance(8000, senders=(0,)).delivered == (1, 2)
        batch = batches.get(timeout=10.0)
        assert (batch.release_us, batch.items[0].payload) == (12_000, b"x")
        guest.hand_over([Broadcast(seq=1, at_us=8000, payload=b"y")], now_us=8000)
        assert radio.advance(12_000).delivered == (0, 1, 2)
        assert vehicle.receive(16_000)[0].payload == b"y"


def test_cut_channel_has_no_deliveries(radio):
    with contextlib.closing(radio.client(0)) as sender, contextlib.closing(radio.client(1)) as receiver:
        sender.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"x"), FtmRequest(seq=2, at_us=4500, peer=1)])
        delivered = {}
        for to_us in range(8000, 300_000, 4000):
            senders = (0,) if to_us == 8000 else ()
            advanced = radio.advance(to_us, senders=senders, extra_attenuation_db=200.0)
            delivered |= dict.fromkeys(advanced.delivered, to_us)
        assert delivered.keys() == {0}
        assert receiver.malformed == 0
        result, _ = sender.receive(delivered[0] + 4000)
        assert result.status in {"no_response", "timeout"}


def test_frame_log_does_not_depend_on_the_order_of_senders(tmp_path):
    logs = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        with contextlib.closing(Radio(folder, seed=9)) as radio, contextlib.ExitStack() as stack:
            clients = [stack.enter_context(contextlib.closing(radio.client(i))) for i in range(3)]
            for step in range(1, 50):
                order = clients if folder.name == "a" else clients[::-1]  # the order must not matter
                for client in order:
                    client.send(4000 * step, [Broadcast(seq=step, at_us=4000 * step, payload=b"x" * 100)])
                assert radio.advance(4000 * (step + 1), senders=(0, 1, 2)).missing == ()
            radio.stop()
            logs.append(radio.frames_path.read_bytes())
    assert logs[0] == logs[1]
    frames = read(tmp_path / "a" / "frames.bin", FRAME_LOG)
    assert {b"data"} <= set(frames["kind"].tolist())


def test_unreachable_endpoint_and_dead_emulator_are_errors(radio):
    with pytest.raises(TransportError, match=r"cannot connect to tcp/127\.0\.0\.1:1: Connection refused"):
        Transport.connect("tcp/127.0.0.1:1", vehicles_user("1234"))
    radio.process.kill()
    radio.process.wait()
    assert radio.advance(8000) is None
    with pytest.raises(TransportError, match="cannot connect"):
        radio.client(0)


def test_invalid_transmission_raises_at_the_sender(radio):
    with (
        contextlib.closing(radio.client(0)) as client,
        pytest.raises(ValueError, match=r"station 0: the 802\.11 emulator rejects"),
    ):
        client.send(4000, [Broadcast(seq=1, at_us=4000, payload=b"x" * 1473)])


def test_missing_delivery_raises_radio_lost(radio, monkeypatch):
    monkeypatch.setattr("netsim.transport.lockstep_radio.ANSWER_LIMIT_S", 0.2)
    with (
        contextlib.closing(radio.client(0)) as client,
        pytest.raises(RadioLost, match=r"station 0: the 802\.11 emulator does not deliver"),
    ):
        client.receive(4000)


def test_process_ends_when_its_stdin_is_closed(radio):
    radio.process.stdin.close()
    assert radio.process.wait(10.0) == 0


def test_port_in_use_is_one_line(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as holder:
        port = holder.getsockname()[1]
        config = ServerConfig(run_id=RUN, stations=1, seed=1, port=port, passwords=new_passwords(0))
        (tmp_path / "second.json").write_bytes(msgspec.json.encode(config))
        own, its = socket.socketpair()
        with own, its:
            second = subprocess.run(
                [
                    sys.executable,
                    "-m",
                    "netsim",
                    "--config",
                    tmp_path / "second.json",
                    "--interval-fd",
                    str(its.fileno()),
                ],
                check=False,
                capture_output=True,
                text=True,
                timeout=30,
                pass_fds=[its.fileno()],
            )
    assert second.returncode == 2
    assert second.stderr.count("\n") == 1
    assert f"cannot listen on tcp/127.0.0.1:{port}" in second.stderr


def test_ack_is_decoded():
    assert decode(Ack, encode(Ack())) == Ack()
