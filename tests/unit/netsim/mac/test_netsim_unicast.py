"""Unicast datagrams, from submission by the host to the reported outcome."""

import pytest
from netsim_swarm import Swarm

from netsim.model.config import StationConfig
from netsim.wire.messages import Broadcast, Delivery, FtmResult, Sent, Unicast

HERE, NEAR = (0.0, 0.0, -10.0), (10.0, 0.0, -10.0)


def swarm(*places, **settings):
    return Swarm([HERE, NEAR, *places], rician_k_db=None, **settings)


def send(air, station, destination, seq=1, at_us=0, payload=b"x" * 100):
    air.submit(station, Unicast(seq=seq, at_us=at_us, destination=destination, payload=payload))


def only(arrived, kind):
    (found,) = [(station, item) for station, item in arrived if isinstance(item, kind)]
    return found


def test_datagram_arrives_once_and_its_outcome_is_reported():
    air = swarm((20.0, 0.0, -10.0))
    send(air, 0, 1, seq=7, payload=b"to one")
    arrived = air.run(8_000)
    station, delivery = only(arrived, Delivery)
    assert (station, delivery.source, delivery.seq, delivery.payload) == (1, 0, 7, b"to one")
    station, sent = only(arrived, Sent)
    assert (station, sent.destination, sent.seq, sent.status, sent.attempts) == (0, 1, 7, "acknowledged", 1)
    assert air.emulator.counters.unicasts == {"acknowledged": 1}
    assert sum(air.emulator.counters.broadcasts_delivered) == 0


def test_results_do_not_depend_on_an_uninvolved_distant_station():
    """Both ends are at the sender's antenna: of the ACK, and of the last measurement frame."""
    times = set()
    for bystander_m in (20.0, 3_000.0):
        air = swarm((bystander_m, 0.0, -10.0), tx_power_dbm=40.0)
        send(air, 0, 1)
        air.request(0, 1, 50_000)
        arrived = air.run(120_000)
        frames = air.emulator.take_frames()
        (ack, *_) = (frame for frame in frames if frame.kind == "ack")
        last = max(frame.end_ns for frame in frames if frame.kind == "ftm")
        _, sent = only(arrived, Sent)
        _, ranged = only(arrived, FtmResult)
        times.add((sent.ended_ns - ack.end_ns, ranged.ended_ns - last))
    assert times == {(33, 33)}  # 10 m


@pytest.mark.parametrize("destination", [0, 3, 65_535])
def test_invalid_destination_is_rejected_at_once_without_airtime(destination):
    air = swarm()
    send(air, 0, destination)
    _, sent = only(air.run(4_000), Sent)
    assert (sent.status, sent.attempts) == ("rejected", 0)
    assert air.emulator.take_frames() == []


def test_frames_to_an_unresponsive_station_are_dropped_at_the_retry_limit():
    air = swarm(retry_limit=3)
    air.emulator.set_silent(1)
    send(air, 0, 1)
    _, sent = only(air.run(40_000), Sent)
    assert (sent.status, sent.attempts) == ("retry_limit", 4)
    assert [frame.kind for frame in air.emulator.take_frames()] == ["data"] * 4


def test_rts_precedes_frames_above_the_threshold():
    air = swarm(rts_threshold_bytes=164)
    send(air, 0, 1, seq=1, payload=b"x" * 100)  # 164 bytes with all headers
    send(air, 0, 1, seq=2, payload=b"x" * 101)
    air.run(8_000)
    kinds = [frame.kind for frame in air.emulator.take_frames()]
    assert kinds == ["data", "ack", "rts", "cts", "data", "ack"]


def test_a_host_keeps_the_order_of_its_datagrams():
    air = swarm(host_jitter_us=1_000)
    for seq in range(200):
        air.submit(0, Broadcast(seq=seq, at_us=air.now_us, payload=b"x"))
        if seq % 5 == 4:
            air.run(air.now_us + 4_000)
    air.run(air.now_us + 20_000)
    received = [item.seq for station, item in air.received if station == 1 and isinstance(item, Delivery)]
    assert received == list(range(200))


def test_station_may_override_its_mode_or_adapt_it():
    own = (
        StationConfig(station=0, data_mode="ofdm6"),
        StationConfig(station=1, data_mode="adaptive"),
    )
    air = swarm(stations=own, bandwidth_mhz=20, data_mode="ofdm12")
    for seq in range(400):
        send(air, 0, 1, seq=seq, at_us=air.now_us)
        send(air, 1, 0, seq=seq, at_us=air.now_us + 2_000)
        air.run(air.now_us + 4_000)
    frames = [frame for frame in air.emulator.take_frames() if frame.kind == "data"]
    assert {frame.mode for frame in frames if frame.source == 0} == {"ofdm6"}
    late = [frame.mode for frame in frames if frame.source == 1][-100:]
    # 10 m: 43 dB over the noise, where the fastest mode cannot fail
    assert late.count("vht_mcs8") > 85
