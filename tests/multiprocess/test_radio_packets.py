"""Packets of network interfaces at the emulator's process: pace, access of its user, malformed messages."""

import contextlib
import threading
import time

import numpy as np
import pytest
from radio_process import RUN, Radio

from netsim.model.config import GuestConfig
from netsim.transport.lockstep_radio import (
    directory_key,
    packets_received_key,
    packets_sent_key,
    receive_key,
    transmit_key,
)
from netsim.wire.addresses import GROUP_ADDRESS, mac_address
from netsim.wire.messages import Broadcast, TxBatch, encode
from netsim.wire.packets import ReceivedPackets, SentPacket, SentPackets, decode_received, encode_packets

pytestmark = pytest.mark.multiprocess

LIMIT_S = 30.0
STEP_US = 40_000
SENT, RECEIVED = packets_sent_key(RUN), packets_received_key(RUN)


@pytest.fixture
def radio(tmp_path):
    with contextlib.closing(Radio(tmp_path, packets=True, rician_k_db=None)) as each:
        yield each


def packet(read_ns, *, station=0, destination=GROUP_ADDRESS, payload=b"packet"):
    return SentPacket(
        station=station, destination=destination, ether_type=0x0800, category="be", read_ns=read_ns,
        payload=payload,
    )  # fmt: skip


def encoded(*packets):
    return encode_packets(SentPackets(packets=packets))


def declared(session):
    """Return sender and mailbox of the interfaces' host, once the router has their declarations."""
    sender, mailbox = session.sender(SENT), session.mailbox(RECEIVED)
    time.sleep(0.3)
    return sender, mailbox


class TimeMaster:
    """Requests intervals of simulated time in real time, in a thread."""

    def __init__(self, radio):
        self._radio = radio
        self._stop = threading.Event()
        self.start_ns = time.monotonic_ns()
        """Wall time of simulated time 0"""
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        to_us = 0
        while not self._stop.is_set():
            to_us += STEP_US
            due_ns = self.start_ns + 1_000 * to_us
            fields = {"at_us": to_us - STEP_US, "due_ns": due_ns, "speed": 1.0}
            assert self._radio.advance(to_us, **fields).to_us == to_us
            assert time.monotonic_ns() >= due_ns

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()


def test_packets_cross_the_channel_in_real_time(radio):
    rng = np.random.default_rng(3)
    delays_ms = []
    with radio.interfaces() as session:
        sender, mailbox = declared(session)
        with TimeMaster(radio):
            for number in range(50):
                time.sleep(float(rng.uniform(0.0, 0.03)))
                read_ns = time.monotonic_ns()
                payload = number.to_bytes(2, "big")
                sender.send(encoded(packet(read_ns, destination=mac_address(1), payload=payload)))
                message = decode_received(mailbox.take(LIMIT_S))
                delays_ms.append((time.monotonic_ns() - read_ns) / 1e6)
                if not message.ended:
                    message = ReceivedPackets(
                        packets=message.packets, ended=decode_received(mailbox.take(LIMIT_S)).ended
                    )
                (received,) = message.packets
                assert (received.payload, received.stations, received.source) == (payload, (1,), 0)
                assert received.due_ns > read_ns
                assert message.ended == ((0, 1),)
    details = radio.stop()
    # far below an interval of 40 ms; other processes delay some of them
    assert np.median(delays_ms) < 20.0
    assert details["influences"] == ["programs on the radio"]
    assert details["packets"]["sent"] == 50
    assert details["packets"]["receptions"]["packets"] == 50
    assert details["counters"]["packets"] == {
        "outcomes": {"acknowledged": 50}, "delivered": 50, "lost_by_hosts": 0,
    }  # fmt: skip


def test_without_a_pace_packets_are_placed_at_the_beginning_of_an_interval(radio):
    with (
        radio.interfaces() as session,
        contextlib.closing(radio.client(0)) as vehicle,
        contextlib.closing(radio.client(1)) as receiver,
    ):
        sender, mailbox = declared(session)
        vehicle.send(4_000, [Broadcast(seq=1, at_us=6_000, payload=b"datagram")])
        for to_us, station in ((8_000, 0), (12_000, 2)):
            sender.send(encoded(packet(1, station=station)))
            time.sleep(0.3)
            senders = (0,) if to_us == 8_000 else ()
            assert radio.advance(to_us, senders=senders).delivered == ((1, 2) if senders else ())
            message = decode_received(mailbox.take(LIMIT_S))
            (received,) = message.packets
            assert (received.source, received.due_ns) == (station, 0)
            assert received.stations == tuple({0, 1, 2} - {station})
            assert message.ended == ((station, 1),)
        assert receiver.receive(12_000)[0].payload == b"datagram"  # and no packet


def test_malformed_messages_are_counted_and_named(radio):
    with radio.interfaces() as session:
        sender, mailbox = declared(session)
        for payload in (b"", b"\xff" * 100, encoded(packet(1, station=3)), b"\xff" * 10**6):
            sender.send(payload)
        time.sleep(0.3)
        radio.advance(8_000)
        sender.send(encoded(packet(1)))
        time.sleep(0.3)
        radio.advance(12_000)
        assert len(decode_received(mailbox.take(LIMIT_S)).packets) == 1
    details = radio.stop()
    assert details["malformed"] == {"interfaces": 4}
    assert details["influences"] == [
        "a program that uses the vehicles' password",
        "programs on the radio",
    ]


def test_the_host_of_interfaces_has_no_other_rights(radio):
    """It neither acts as a vehicle nor receives what vehicles send and receive, nor forges receptions."""
    keys = [
        transmit_key(RUN),
        *(receive_key(RUN, i) for i in range(3)),
        SENT,
        f"coflight/{RUN}/radio/**",
        "**",
    ]
    with (
        radio.interfaces() as session,
        radio.interfaces() as spy,  # another session: within one, messages do not pass the router
        contextlib.closing(radio.client(1)) as one,
    ):
        spies = [spy.mailbox(key) for key in keys]
        _, forged = declared(spy)
        batch = TxBatch(station=0, now_us=4_000, items=(Broadcast(seq=1, at_us=4_000, payload=b"forged"),))
        for key in (transmit_key(RUN), receive_key(RUN, 1), RECEIVED):
            session.sender(key).send(encode(batch))
        for key in (transmit_key(RUN), directory_key(RUN)):
            assert session.asker(key, timeout_s=0.5).ask(encode(batch)).answer() is None
        time.sleep(0.3)
        with contextlib.closing(radio.client(0)) as vehicle:
            vehicle.send(4_000, [Broadcast(seq=2, at_us=4_000, payload=b"own")])
            assert radio.advance(8_000, senders=(0,)).delivered == (1, 2)
        assert [each.payload for each in one.receive(12_000)[:-1]] == [b"own"]
        assert one.malformed == 0
        assert [each.take(0.0) for each in spies] == [None] * len(spies)
        assert forged.take(0.0) is None
    details = radio.stop()
    assert (details["malformed"], details["influences"]) == ({}, [])


def test_a_guest_has_no_access_to_packets(tmp_path):
    places = [GuestConfig(name="car", pos_ned_m=(0.0, 8.5, -10.0))]
    with (
        contextlib.closing(Radio(tmp_path, packets=True, rician_k_db=None, guests=places)) as radio,
        radio.interfaces() as session,
        radio.session(guest=3) as guest,
        radio.session(guest=3) as spy,
    ):
        sender, mailbox = declared(session)
        spies = [spy.mailbox(key) for key in (SENT, RECEIVED, f"coflight/{RUN}/radio/packets/*")]
        for key in (SENT, RECEIVED):
            guest.sender(key).send(encoded(packet(1, payload=b"forged")))
        time.sleep(0.3)
        radio.advance(8_000)
        assert mailbox.take(0.0) is None
        sender.send(encoded(packet(1)))
        time.sleep(0.3)
        radio.advance(12_000)
        (received,) = decode_received(mailbox.take(LIMIT_S)).packets
        assert received.payload == b"packet"
        assert received.stations == (1, 2, 3)
        assert [each.take(0.0) for each in spies] == [None] * 3
        assert radio.stop()["influences"] == ["programs on the radio"]


def test_a_radio_without_packets_has_no_user_of_theirs(tmp_path):
    with contextlib.closing(Radio(tmp_path)) as radio, radio.session() as vehicle:
        vehicle.sender(SENT).send(encoded(packet(1)))
        time.sleep(0.3)
        radio.advance(8_000)
        details = radio.stop()
    assert details["influences"] == []
    assert "packets" not in details
    assert "packets" not in details["counters"]
