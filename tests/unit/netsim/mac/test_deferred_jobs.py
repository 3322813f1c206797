"""Deferred jobs: their ends and receptions are reported in blocks, jobs that repeat are counted."""

import pytest
from netsim_air import Air

from netsim.lab.bench import CLOSE_M, RadioBench, ring_ned_m
from netsim.mac.jobs import Job, JobOutcome
from netsim.model.codes import RECORD_ROWS
from netsim.model.config import RadioConfig
from netsim.phy.frames import GROUP, FrameKind
from netsim.phy.modes import phy_mode
from netsim.wire.messages import Broadcast, Delivery, Sent, Unicast


class Deferred(Air):
    """Air with deferred jobs; ``seen`` has their receptions and ends as they are reported."""

    def __init__(self, stations, **settings):
        super().__init__(stations, **settings)
        self.seen = []
        self.radios._on_datagram = lambda received: self.seen.append(("received", received))

    def plan(self, at_us, source, to=GROUP, *, seq=0, repeats=False, retry_limit=7, lifetime_us=1_000_000):
        job = Job(
            kind=FrameKind.DATA,
            destination=to,
            mode=phy_mode("ofdm6", 20),
            frame_bytes=100,
            expires_ns=1_000 * (at_us + lifetime_us),
            retry_limit=retry_limit,
            done=lambda job, outcome: self.seen.append((outcome, job)),
            seq=seq,
            deferred=True,
            repeats=repeats,
        )
        self.stations[source].enqueue_at(1_000 * at_us, "be", job)
        return job


def test_frames_have_the_times_of_jobs_that_are_not_deferred():
    deferred, at_once = Deferred(3), Air(3)
    for air, send in ((deferred, deferred.plan), (at_once, at_once.send)):
        for at_us, source, to in ((100, 0, 1), (100, 1, 2), (130, 2, GROUP), (4_000, 1, 0)):
            send(at_us, source, to)
        air.run(1_000_000)
    assert deferred.run() == at_once.run()
    assert [what for what, _ in deferred.seen if what != "received"] == at_once.outcomes


def test_receptions_and_ends_are_reported_by_the_end_of_the_time_span():
    """100 bytes at 6 Mbit/s take 160 us."""
    air = Deferred(3)
    job = air.plan(1_000, 0, seq=7)
    air.run(2_000)
    (_, received), (outcome, ended) = air.seen
    assert (received.source, received.seq, list(received.stations)) == (0, 7, [1, 2])
    assert list(received.ends_ns) == [1_160_000] * 2
    assert (outcome, ended, ended.ended_ns, ended.attempts) == (JobOutcome.SENT, job, 1_160_000, 1)


def test_end_of_a_unicast_is_that_of_its_ack():
    air = Deferred(2, delays_ns={(0, 1): 1_000, (1, 0): 1_000})
    air.plan(1_000, 0, 1)
    air.run(10_000)
    (_, received), (outcome, job) = air.seen
    assert list(received.ends_ns) == [1_161_000]
    # SIFS, an ACK of 14 bytes at 6 Mbit/s (44 us) and both ways
    assert (outcome, job.ended_ns) == (JobOutcome.ACKNOWLEDGED, 1_162_000 + 16_000 + 44_000)


def test_a_repeated_unicast_is_received_once():
    """No ACK returns: the frame is sent again, and its receiver takes one datagram."""
    air = Deferred(2, powers_dbm={(1, 0): -200.0})
    air.plan(1_000, 0, 1, retry_limit=3)
    air.run(100_000)
    (what, received), (outcome, job) = air.seen
    assert (what, outcome, job.attempts) == ("received", JobOutcome.RETRY_LIMIT, 4)
    assert list(received.stations) == [1]


def test_a_radio_that_is_off_takes_no_job():
    air = Deferred(2)
    air.plan(1_000, 0, 1)
    air.queue.at(500_000, lambda _: air.stations[0].silence(), None)
    assert air.run(10_000) == []
    assert air.seen == []
    job = air.plan(20_000, 1)  # the row of the first one is free again
    assert job.row == 0
    air.run(30_000)
    assert [what for what, _ in air.seen] == [JobOutcome.SENT]


def test_jobs_that_repeat_keep_the_queue_filled_and_are_counted():
    air = Deferred(2)
    for _ in range(2):
        air.plan(1_000, 0, 1, repeats=True)
    acks = sum(kind == "ack" for *_, kind in air.run(1_000_000))
    acknowledged = air.radios.repeated()[0, list(JobOutcome).index(JobOutcome.ACKNOWLEDGED)]
    # DIFS, 7.5 slots on average, 160 us, SIFS, 44 us: 321.5 us
    assert acks == acknowledged == pytest.approx(999_000 / 321.5, rel=0.02)
    assert air.seen == []
    air.stations[0].silence()
    assert [what for what, _ in air.seen] == [JobOutcome.EXPIRED] * 2
    assert sum(kind == "data" for *_, kind in air.run(2_000_000)) <= acks + 1


def test_more_receptions_than_buffered_are_all_delivered_in_order():
    config = RadioConfig(
        bandwidth_mhz=20, frequency_mhz=5180.0, rician_k_db=None, broadcast_rts=False, queue_frames=1_000,
        queue_lifetime_us=10_000_000, host_jitter_us=0,
    )  # fmt: skip
    bench = RadioBench(config, ring_ned_m(4, CLOSE_M), 1)
    count = RECORD_ROWS
    bench.submit(0, *(Broadcast(seq=seq, at_us=0, payload=bytes(4)) for seq in range(1, count + 1)))
    later = (Unicast(seq=seq, at_us=500_000, destination=2, payload=bytes(4)) for seq in range(1, 100))
    bench.submit(1, *later)
    items = bench.run(1_000_000)
    for station in (1, 2, 3):
        received = [(i.source, i.seq) for to, i in items if to == station and isinstance(i, Delivery)]
        of_unicasts = [(1, seq) for seq in range(1, 100)] if station == 2 else []
        assert received == [(0, seq) for seq in range(1, count + 1)] + of_unicasts
    reports = [item for to, item in items if to == 1 and isinstance(item, Sent)]
    assert [(item.seq, item.status) for item in reports] == [(seq, "acknowledged") for seq in range(1, 100)]


def test_saturating_needs_a_queue_and_a_fixed_mode():
    places = ring_ned_m(2, CLOSE_M)
    with pytest.raises(ValueError, match="ideal"):
        RadioBench(RadioConfig(channel="ideal"), places, 1).emulator.saturate(0, 1, 100)
    with pytest.raises(ValueError, match="adaptive"):
        RadioBench(RadioConfig(data_mode="adaptive"), places, 1).emulator.saturate(0, 1, 100)
