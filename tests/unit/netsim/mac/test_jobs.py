"""How a station's jobs end, by lifetime or silence, and how often they were sent: timelines in microseconds.

100 bytes at 6 Mbit/s last 160 us, 1000 bytes 1360 us; RTS at 24 Mbit/s last 28 us. The file runs in under a
second.
"""

import pytest
from netsim_air import UNDETECTED_DBM, A, Air, B, C

from netsim.mac.access_parameters import EDCA
from netsim.mac.jobs import JobOutcome
from netsim.model.event_queue import NEVER_NS

TIMEOUT_US = 16 + 9 + 20
"""SIFS, slot and preamble, after which an answer that has not begun is missing."""


def outcomes_at(air, at_us):
    """How jobs had ended just before that moment, and at it."""
    air.queue.run_until(1_000 * at_us - 1)
    before = list(air.outcomes)
    air.queue.run_until(1_000 * at_us)
    return before, air.outcomes


def test_lifetime_ends_on_a_busy_medium():
    #  1000            1610     2360
    #  A data          |        |
    #    ^ 1010 B's    ^ is over
    air = Air(2)
    air.send(1000, A, frame_bytes=1000)
    air.send(1010, B, lifetime_us=600)
    assert outcomes_at(air, 1610) == ([], [JobOutcome.EXPIRED])
    assert [source for _, _, source, _ in air.run()] == [A]


def test_lifetimes_end_independently_of_the_queue_order():
    # in the queue: to 2010, to 1310, to 1620, to 1310, and one that lives on, behind A's frame up to 2360
    air = Air(2, backoffs={B: [(0, 15)]})
    air.send(1000, A, frame_bytes=1000)
    for lifetime_us in (1000, 300, 610, 300, 5000):
        air.send(1010, B, lifetime_us=lifetime_us)
    ended = [tuple(map(len, outcomes_at(air, 1010 + us))) for us in (300, 610, 1000)]
    assert ended == [(0, 2), (2, 3), (3, 4)]
    assert air.run()[1] == (2360 + 34, 2554, B, "data")
    assert air.outcomes == [JobOutcome.EXPIRED] * 4 + [JobOutcome.SENT] * 2


def test_lifetimes_end_in_every_queue_of_a_station():
    air = Air(2, access="edca")
    air.send(1000, A, frame_bytes=1000, category="be")
    for category in EDCA:
        air.send(1010, B, lifetime_us=600, category=category)
    assert outcomes_at(air, 1610) == ([], [JobOutcome.EXPIRED] * 4)


def test_frames_queued_after_an_expiry_also_expire():
    # the second comes in the same instant in which the first ends, the third when the queue is empty
    air = Air(2)
    air.send(1000, A, frame_bytes=1000)
    for at_us in (1010, 1210, 1500):
        air.send(at_us, B, lifetime_us=200)
    ended = [tuple(map(len, outcomes_at(air, at_us))) for at_us in (1210, 1410, 1700)]
    assert ended == [(0, 1), (1, 2), (2, 3)]


def test_exchange_that_has_begun_outlives_its_frame():
    #  1000  1100     1160 1176 1220
    #  A data  ^ over |    B ack |
    air = Air(2)
    air.send(1000, A, B, lifetime_us=100)
    air.run()
    assert air.outcomes == [JobOutcome.ACKNOWLEDGED]


def test_expired_frame_is_not_retried():
    # no answer to a frame that ends at 1160; its lifetime was over at 1100
    air = Air(2, powers_dbm={(A, B): UNDETECTED_DBM})
    air.send(1000, A, B, lifetime_us=100)
    assert outcomes_at(air, 1160 + TIMEOUT_US) == ([], [JobOutcome.EXPIRED])
    assert len(air.run()) == 1


def test_no_events_remain_after_all_frames_are_sent():
    air = Air(2)
    air.send(1000, A, B)
    air.send(1000, A)
    air.run(3000)
    assert air.outcomes == [JobOutcome.ACKNOWLEDGED, JobOutcome.SENT]
    assert air.queue.next_ns() == NEVER_NS


def test_silence_completes_the_frame_on_the_air_and_drops_the_others():
    #  1000 1100 1160
    #  A data ^  |        A falls silent at 1100
    air = Air(2)
    air.send(1000, A)
    air.send(1010, A)
    air.queue.at(1_100_000, lambda _: air.stations[A].silence(), None)
    assert outcomes_at(air, 1100) == ([], [JobOutcome.SENT, JobOutcome.EXPIRED])
    assert air.run() == [(1000, 1160, A, "data")]
    assert air.transmissions[0].delivered == [B]
    assert len(air.outcomes) == 2


def test_body_of_a_frame_on_the_air_is_kept_when_its_station_is_silenced():
    """Another's frame is made meanwhile, and must not be taken for it."""
    air = Air(3)
    air.send(1000, A, B, body="of A")
    air.queue.at(1_100_000, lambda _: air.stations[A].silence(), None)
    air.send(1110, C, B, body="of C")
    air.run()
    assert air.outcomes[0] is JobOutcome.EXPIRED  # its station is off when the ACK arrives
    assert air.bodies == ["of A", "of C"]


def test_group_frame_with_only_its_rts_sent_expires_in_silence():
    air = Air(2)
    air.send(1000, B)
    air.send(2000, A, rts=True)
    air.queue.at(2_010_000, lambda _: air.stations[A].silence(), None)
    # the CTS is still sent, and no station receives it
    assert [kind for *_, kind in air.run()] == ["data", "rts", "cts"]
    assert air.outcomes == [JobOutcome.SENT, JobOutcome.EXPIRED]


@pytest.mark.parametrize(
    ("unheard", "rts", "frames", "attempts"),
    [
        ((A, B), True, ["rts"] * 3, 0),
        ((A, B), False, ["data"] * 3, 3),
        ((B, A), False, ["data", "ack"] * 3, 3),
        ((A, C), True, ["rts", "cts", "data", "ack"], 1),
    ],
)
def test_attempts_are_transmissions_of_the_frame_itself(unheard, rts, frames, attempts):
    air = Air(3, powers_dbm={unheard: UNDETECTED_DBM})
    job = air.send(1000, A, B, rts=rts, retry_limit=2)
    assert [kind for *_, kind in air.run()] == frames
    assert job.attempts == attempts
