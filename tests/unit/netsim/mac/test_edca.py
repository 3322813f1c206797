"""EDCA as timelines in microseconds: priorities, the count of slots, collisions inside a station, and TXOPs.

100 bytes at 6 Mbit/s last 160 us and their ACK 44 us, an exchange 220 us; RTS and CTS at 24 Mbit/s last 28
us. Slot 9, SIFS 16, AIFS 34 (voice, video), 43 (best effort), 79 (background). The file runs in under a
second.
"""

import pytest
from netsim_air import UNDETECTED_DBM, A, Air, B, C, D

from netsim.mac.access_parameters import DCF, EDCA
from netsim.mac.jobs import JobOutcome
from netsim.model.config import RadioConfig
from netsim.phy.modes import phy_mode
from netsim.phy.timing import timing_of

SLOT_US, SIFS_US, AIFS_VO_US, AIFS_BE_US = 9, 16, 34, 43
EXCHANGE_US = 160 + SIFS_US + 44


def test_interframe_spaces_and_limits_are_those_of_5_ghz_ofdm():
    timing = timing_of(RadioConfig())
    assert (DCF.aifs_ns(timing), DCF.txop_ns) == (34_000, 0)
    assert {
        name: (p.aifs_ns(timing) // 1_000, p.cw_min, p.cw_max, p.txop_ns // 1_000) for name, p in EDCA.items()
    } == {
        "vo": (34, 3, 7, 1504),
        "vi": (34, 7, 15, 3008),
        "be": (43, 15, 1023, 0),
        "bk": (79, 15, 1023, 0),
    }


def test_voice_has_priority_over_best_effort():
    #  1000   1160 1194 1203        1363     1406
    #  A data |aifs|slot | C data   | aifs   | B data      at 1203 B's AIFS ends, and its only slot counts
    air = Air(3, access="edca", backoffs={B: [(1, 15)], C: [(1, 3)]})
    air.send(1000, A, category="be")
    air.send(1010, B, category="be")
    air.send(1020, C, category="vo")
    assert [frame[:3] for frame in air.run()[1:]] == [(1203, 1363, C), (1363 + AIFS_BE_US, 1566, B)]


def test_edca_counts_slots_at_their_boundaries():
    #  1000   1160 1203 1212      1372 1415 1424
    #  A data |aifs|slot| C data  |aifs|slot| B data      B drew 3 and counts at 1203 and at 1212, when C
    #                                                     begins; DCF would have counted one
    air = Air(3, access="edca", backoffs={B: [(3, 15)], C: [(1, 15)]})
    air.send(1000, A, category="be")
    air.send(1010, B, category="be")
    air.send(1020, C, category="be")
    assert [frame[:3] for frame in air.run()[1:]] == [(1212, 1372, C), (1424, 1584, B)]


def test_queues_of_one_station_collide_internally():
    # both would send at 1203: voice does, best effort draws from twice its window
    air = Air(2, access="edca", backoffs={B: [(0, 15), (1, 3), (20, 31)]})
    air.send(1000, A, category="be")
    be = air.send(1010, B, category="be")
    air.send(1020, B, category="vo")
    assert [frame[:3] for frame in air.run()[1:]] == [(1203, 1363, B), (1363 + 43 + 20 * 9, 1746, B)]
    assert be.failures == 1


def test_order_of_first_use_is_not_the_order_of_priority():
    # all four queues of B back off no slot; AIFS decides between them, and priority at equal AIFS
    air = Air(2, access="edca", backoffs={B: [(0, 15), (0, 15), (0, 7), (0, 3)] + [(0, 15)] * 20})
    air.send(1000, A, category="be")
    jobs = [air.send(1010, B, category=category) for category in ("bk", "be", "vi", "vo")]
    air.run()
    starts_ns = [job.sent_ns for job in jobs]
    assert starts_ns == sorted(starts_ns, reverse=True)
    # video alone has collided: it would have sent in voice's slot
    assert [job.failures for job in jobs] == [0, 0, 1, 0]


def test_video_txop_continues_after_sifs():
    #  1000   1160 1176  1220 1236   1396 1412  1456
    #  A data |    B ack |    A data |    B ack |
    air = Air(2, access="edca")
    for _ in range(2):
        air.send(1000, A, B, category="vi")
    assert air.run() == [
        (1000, 1160, A, "data"),
        (1176, 1220, B, "ack"),
        (1236, 1396, A, "data"),
        (1412, 1456, B, "ack"),
    ]
    # what follows in the TXOP is reserved by the frame and by its ACK
    following_us = SIFS_US + EXCHANGE_US
    nav_us = [t.frame.nav_ns // 1_000 for t in air.transmissions]
    assert nav_us == [SIFS_US + 44 + following_us, following_us, SIFS_US + 44, 0]


def test_group_frames_of_a_txop_follow_after_sifs():
    air = Air(2, access="edca")
    for _ in range(3):
        air.send(1000, A, category="vo")
    assert [start for start, *_ in air.run()] == [1000, 1176, 1352]


@pytest.mark.parametrize(("category", "limit_us", "window"), [("vo", 1504, 3), ("vi", 3008, 7)])
def test_txop_ends_before_the_exchange_that_does_not_fit(category, limit_us, window):
    # k exchanges take 220 k + 16 (k - 1): 6 fit into 1504 us, 12 into 3008 us
    fit = (limit_us + SIFS_US) // (EXCHANGE_US + SIFS_US)
    air = Air(2, access="edca", backoffs={A: [(1, window), (0, window)]})
    for at_us in (1000, 1001, 1002, 1003, 1004, 1005, 1006, 1007, 1008, 1009):
        air.send(at_us, A, B, category=category)
    # the queue holds ten, so the rest comes when some are gone
    for _ in range(4):
        air.send(2000, A, B, category=category)
    starts_us = [start for start, _, source, _ in air.run() if source == A]
    last_us = 1000 + (fit - 1) * (EXCHANGE_US + SIFS_US)
    assert starts_us[:fit] == [1000 + k * (EXCHANGE_US + SIFS_US) for k in range(fit)]
    assert starts_us[fit] == last_us + EXCHANGE_US + AIFS_VO_US + SLOT_US
    assert last_us + EXCHANGE_US <= 1000 + limit_us < last_us + SIFS_US + 2 * EXCHANGE_US
    assert air.outcomes == [JobOutcome.ACKNOWLEDGED] * 14


class Always:
    """A rate control that always chooses the same mode."""

    def __init__(self, mode):
        self._mode = phy_mode(mode, 20)

    def mode_for(self, *_, **__):
        return self._mode

    def report(self, *_, **__):
        pass


@pytest.mark.parametrize(
    ("mode", "start_us"),
    [
        ("ofdm54", 1000 + EXCHANGE_US + SIFS_US),  # 380 us: in the same TXOP
        ("ofdm6", 1000 + EXCHANGE_US + AIFS_VO_US + 3 * SLOT_US),  # 3 ms: after backing off three slots
    ],
)
def test_frame_whose_mode_does_not_fit_the_txop_needs_a_new_one(mode, start_us):
    air = Air(2, access="edca", backoffs={A: [(3, 7)]})
    air.send(1000, A, B, category="vi")
    air.send(1000, A, B, category="vi", frame_bytes=2200, rates=Always(mode))
    starts_us = [start for start, _, source, _ in air.run() if source == A]
    assert starts_us == [1000, start_us]
    assert air.outcomes == 2 * [JobOutcome.ACKNOWLEDGED]


def test_best_effort_sends_one_frame_and_backs_off():
    air = Air(2, access="edca", backoffs={A: [(2, 15)]})
    for _ in range(2):
        air.send(1000, A, B, category="be")
    assert air.run()[2][0] == 1000 + EXCHANGE_US + AIFS_BE_US + 2 * SLOT_US


def test_failure_ends_a_txop():
    #  1000   1160 1176  1220 1236   1396     1441 1475 1493
    #  A data |    B ack |    A data | no ack |aifs|2   | A data      C does not receive A
    air = Air(3, access="edca", powers_dbm={(A, C): UNDETECTED_DBM}, backoffs={A: [(2, 7)]})
    air.send(1000, A, B, category="vi")
    air.send(1000, A, C, category="vi", retry_limit=0)
    air.send(1000, A, B, category="vi")
    assert [start for start, _, source, _ in air.run() if source == A] == [1000, 1236, 1493]
    assert air.outcomes == [JobOutcome.ACKNOWLEDGED, JobOutcome.RETRY_LIMIT, JobOutcome.ACKNOWLEDGED]


def test_expired_frame_is_skipped_in_a_txop():
    air = Air(2, access="edca")
    air.send(1000, A, category="vo")
    air.send(1000, A, category="vo", lifetime_us=100)
    air.send(1000, A, category="vo")
    assert [start for start, *_ in air.run()] == [1000, 1176]
    assert air.outcomes == [JobOutcome.EXPIRED, JobOutcome.SENT, JobOutcome.SENT]


def test_hidden_station_defers_for_the_rest_of_a_txop():
    # D receives only B's ACKs: the first, at 1220, reserves the medium to the end of the second, at 1456
    air = Air(
        4,
        access="edca",
        powers_dbm={(A, D): UNDETECTED_DBM, (D, A): UNDETECTED_DBM},
        backoffs={D: [(0, 15)]},
    )
    for _ in range(2):
        air.send(1000, A, B, category="vi")
    air.send(1300, D, category="be")
    assert air.run()[-1] == (1456 + AIFS_BE_US, 1659, D, "data")


def test_group_frame_reserves_the_next_one_of_its_txop():
    #  1000   1160 1176   1336
    #  A data |    A data |aifs| C data      D, hidden from A, begins at 1176 too: at C neither of the
    #              D data |                  two is 4 dB over the other, and both are below the energy
    #                                        that it senses
    hidden = dict.fromkeys([(A, D), (D, A)], UNDETECTED_DBM)
    weak = dict.fromkeys([(A, C), (D, C)], -75.0)
    air = Air(4, access="edca", powers_dbm=hidden | weak, backoffs={C: [(0, 15)]})
    for _ in range(2):
        air.send(1000, A, category="vo")
    air.send(1176, D, category="be")
    air.send(1200, C, category="be")
    assert air.run() == [
        (1000, 1160, A, "data"),
        (1176, 1336, A, "data"),
        (1176, 1336, D, "data"),
        (1336 + AIFS_BE_US, 1539, C, "data"),
    ]
    assert C not in air.transmissions[1].delivered + air.transmissions[2].delivered


def test_txop_holder_gets_responses_despite_its_own_nav():
    #  1000   1160 1176  1220 1236  1264 1280  1308 1324   1484 1500  1544
    #  A data |    B ack |    A rts |    C cts |    A data |    C ack |
    air = Air(3, access="edca")
    air.send(1000, A, B, category="vo")
    air.send(1000, A, C, category="vo", rts=True)
    assert [(start, source, kind) for start, _, source, kind in air.run()] == [
        (1000, A, "data"),
        (1176, B, "ack"),
        (1236, A, "rts"),
        (1280, C, "cts"),
        (1324, A, "data"),
        (1500, C, "ack"),
    ]
