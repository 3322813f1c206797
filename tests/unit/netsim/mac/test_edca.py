"""EDCA as timelines in microseconds: priorities, the count of slots, collisions inside a station, and TXOPs.

100 bytes at 6 Mbit/s last 160 us and their ACK 44 us, an exchange 220 us; RTS and CTS at 24 Mbit/s last 28
us. Slot 9, SIFS 16, AIFS 34 (voice, video), 43 (best effort), 79 (background). On a medium that has been idle
from the start, slot boundaries of all categories are at 7 + 9 k us from their AIFS on, so at 1006 us. The
file runs in under a second.
"""

import pytest
from netsim_air import UNDETECTED_DBM, A, Air, B, C, D

from netsim.mac.access_parameters import DCF, edca_parameters
from netsim.mac.jobs import JobOutcome
from netsim.model.config import RadioConfig
from netsim.phy.modes import phy_mode
from netsim.phy.timing import timing_of

SLOT_US, SIFS_US, AIFS_VO_US, AIFS_BE_US = 9, 16, 34, 43
EXCHANGE_US = 160 + SIFS_US + 44


@pytest.mark.parametrize(
    ("edition", "limits_us"), [(2016, (1504, 3008, 0, 0)), (2020, (2080, 4096, 2528, 2528))]
)
def test_interframe_spaces_and_limits_are_those_of_5_ghz_ofdm(edition, limits_us):
    """Tables 9-137 of 802.11-2016 and 9-155 of 802.11-2020 differ in the TXOP limits alone."""
    timing = timing_of(RadioConfig())
    assert (DCF.aifs_ns(timing), DCF.txop_ns) == (34_000, 0)
    parameters = edca_parameters(edition)
    assert {name: (p.aifs_ns(timing) // 1_000, p.cw_min, p.cw_max) for name, p in parameters.items()} == {
        "vo": (34, 3, 7),
        "vi": (34, 7, 15),
        "be": (43, 15, 1023),
        "bk": (79, 15, 1023),
    }
    assert tuple(p.txop_ns // 1_000 for p in parameters.values()) == limits_us


@pytest.mark.parametrize("category", ["vo", "be", "bk"])
@pytest.mark.parametrize(("arrives_us", "starts_us"), [(998, 1006), (1006, 1006), (1007, 1015)])
def test_frame_waits_on_an_idle_medium_for_a_slot_boundary(category, arrives_us, starts_us):
    air = Air(2, access="edca")
    air.send(arrives_us, A, category=category)
    assert air.run() == [(starts_us, starts_us + 160, A, "data")]


@pytest.mark.parametrize("category", ["vo", "be", "bk"])
def test_boundaries_count_from_the_end_of_the_last_busy_period(category):
    #  1006   1166   1200 1209 ... 1299 1308        12 slots after AIFS of voice, 11 after that of best
    #  A data | aifs |    |    ...  |B's | B data   effort, 7 after that of background
    starts_us = 1166 + AIFS_VO_US + 12 * SLOT_US
    air = Air(2, access="edca")
    air.send(1006, A, category="be")
    air.send(1300, B, category=category)
    assert air.run()[1] == (starts_us, starts_us + 160, B, "data")


def test_frames_that_arrive_within_a_slot_collide():
    """DCF would have sent the first at 998, and the second station would have sensed it."""
    air = Air(3, access="edca")
    air.send(998, A, category="be")
    air.send(1005, B, category="vo")
    assert [frame[:3] for frame in air.run()] == [(1006, 1166, A), (1006, 1166, B)]
    assert air.transmissions[0].collided == [B, C]


def test_no_backoff_is_drawn_if_the_medium_becomes_busy_before_the_boundary():
    #  1006     1166 1209
    #  A data   |aifs| B data      B's arrives at 1008, when A cannot be sensed yet; its boundary is at 1015
    #    ^ B's
    air = Air(2, access="edca", backoffs={B: [(5, 15)]})
    air.send(1006, A, category="be")
    air.send(1008, B, category="be")
    assert air.run()[1] == (1166 + AIFS_BE_US, 1369, B, "data")


def test_voice_has_priority_over_best_effort():
    #  1006   1166 1200 1209        1369     1412
    #  A data |aifs|slot | C data   | aifs   | B data      at 1209 B's AIFS ends, and its only slot counts
    air = Air(3, access="edca", backoffs={B: [(1, 15)], C: [(1, 3)]})
    air.send(1006, A, category="be")
    air.send(1016, B, category="be")
    air.send(1026, C, category="vo")
    assert [frame[:3] for frame in air.run()[1:]] == [(1209, 1369, C), (1369 + AIFS_BE_US, 1572, B)]


def test_edca_counts_slots_at_their_boundaries():
    #  1006   1166 1209 1218      1378 1421 1430
    #  A data |aifs|slot| C data  |aifs|slot| B data      B drew 3 and counts at 1209 and at 1218, when C
    #                                                     begins; DCF would have counted one
    air = Air(3, access="edca", backoffs={B: [(3, 15)], C: [(1, 15)]})
    air.send(1006, A, category="be")
    air.send(1016, B, category="be")
    air.send(1026, C, category="be")
    assert [frame[:3] for frame in air.run()[1:]] == [(1218, 1378, C), (1430, 1590, B)]


def test_queues_of_one_station_collide_internally():
    # both would send at 1209: voice does, best effort draws from twice its window
    air = Air(2, access="edca", backoffs={B: [(0, 15), (1, 3), (20, 31)]})
    air.send(1006, A, category="be")
    be = air.send(1016, B, category="be")
    air.send(1026, B, category="vo")
    assert [frame[:3] for frame in air.run()[1:]] == [(1209, 1369, B), (1369 + 43 + 20 * 9, 1752, B)]
    assert be.failures == 1


def test_order_of_first_use_is_not_the_order_of_priority():
    # all four queues of B back off no slot; AIFS decides between them, and priority at equal AIFS
    air = Air(2, access="edca", backoffs={B: [(0, 15), (0, 15), (0, 7), (0, 3)] + [(0, 15)] * 20})
    air.send(1006, A, category="be")
    jobs = [air.send(1016, B, category=category) for category in ("bk", "be", "vi", "vo")]
    air.run()
    starts_ns = [job.sent_ns for job in jobs]
    assert starts_ns == sorted(starts_ns, reverse=True)
    # video alone has collided: it would have sent in voice's slot
    assert [job.failures for job in jobs] == [0, 0, 1, 0]


def test_video_txop_continues_after_sifs():
    #  1006   1166 1182  1226 1242   1402 1418  1462
    #  A data |    B ack |    A data |    B ack |
    air = Air(2, access="edca")
    for _ in range(2):
        air.send(1006, A, B, category="vi")
    assert air.run() == [
        (1006, 1166, A, "data"),
        (1182, 1226, B, "ack"),
        (1242, 1402, A, "data"),
        (1418, 1462, B, "ack"),
    ]
    # what follows in the TXOP is reserved by the frame and by its ACK
    following_us = SIFS_US + EXCHANGE_US
    nav_us = [t.frame.nav_ns // 1_000 for t in air.transmissions]
    assert nav_us == [SIFS_US + 44 + following_us, following_us, SIFS_US + 44, 0]


def test_group_frames_of_a_txop_follow_after_sifs():
    air = Air(2, access="edca")
    for _ in range(3):
        air.send(1006, A, category="vo")
    assert [start for start, *_ in air.run()] == [1006, 1182, 1358]


@pytest.mark.parametrize(
    ("edition", "category", "limit_us", "window", "aifs_us"),
    [
        (2016, "vo", 1504, 3, AIFS_VO_US),
        (2016, "vi", 3008, 7, AIFS_VO_US),
        (2020, "vo", 2080, 3, AIFS_VO_US),
        (2020, "be", 2528, 15, AIFS_BE_US),
    ],
)
def test_txop_ends_before_the_exchange_that_does_not_fit(edition, category, limit_us, window, aifs_us):
    # k exchanges take 220 k + 16 (k - 1): 6 fit into 1504 us, 12 into 3008, 8 into 2080, 10 into 2528
    fit = (limit_us + SIFS_US) // (EXCHANGE_US + SIFS_US)
    air = Air(2, access="edca", edca_edition=edition, backoffs={A: [(1, window), (0, window)]})
    for at_us in (1006, 1007, 1008, 1009, 1010, 1011, 1012, 1013, 1014, 1015):
        air.send(at_us, A, B, category=category)
    # the queue holds ten, so the rest comes when some are gone
    for _ in range(4):
        air.send(2000, A, B, category=category)
    starts_us = [start for start, _, source, _ in air.run() if source == A]
    last_us = 1006 + (fit - 1) * (EXCHANGE_US + SIFS_US)
    assert starts_us[:fit] == [1006 + k * (EXCHANGE_US + SIFS_US) for k in range(fit)]
    assert starts_us[fit] == last_us + EXCHANGE_US + aifs_us + SLOT_US
    assert last_us + EXCHANGE_US <= 1006 + limit_us < last_us + SIFS_US + 2 * EXCHANGE_US
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
        ("ofdm54", 1006 + EXCHANGE_US + SIFS_US),  # 380 us: in the same TXOP
        ("ofdm6", 1006 + EXCHANGE_US + AIFS_VO_US + 3 * SLOT_US),  # 3 ms: after backing off three slots
    ],
)
def test_frame_whose_mode_does_not_fit_the_txop_needs_a_new_one(mode, start_us):
    air = Air(2, access="edca", backoffs={A: [(3, 7)]})
    air.send(1006, A, B, category="vi")
    air.send(1006, A, B, category="vi", frame_bytes=2200, rates=Always(mode))
    starts_us = [start for start, _, source, _ in air.run() if source == A]
    assert starts_us == [1006, start_us]
    assert air.outcomes == 2 * [JobOutcome.ACKNOWLEDGED]


def test_best_effort_sends_one_frame_and_backs_off():
    air = Air(2, access="edca", backoffs={A: [(2, 15)]})
    for _ in range(2):
        air.send(1006, A, B, category="be")
    assert air.run()[2][0] == 1006 + EXCHANGE_US + AIFS_BE_US + 2 * SLOT_US


def test_failure_ends_a_txop():
    #  1006   1166 1182  1226 1242   1402     1447 1481 1499
    #  A data |    B ack |    A data | no ack |aifs|2   | A data      C does not receive A
    air = Air(3, access="edca", powers_dbm={(A, C): UNDETECTED_DBM}, backoffs={A: [(2, 7)]})
    air.send(1006, A, B, category="vi")
    air.send(1006, A, C, category="vi", retry_limit=0)
    air.send(1006, A, B, category="vi")
    assert [start for start, _, source, _ in air.run() if source == A] == [1006, 1242, 1499]
    assert air.outcomes == [JobOutcome.ACKNOWLEDGED, JobOutcome.RETRY_LIMIT, JobOutcome.ACKNOWLEDGED]


def test_expired_frame_is_skipped_in_a_txop():
    air = Air(2, access="edca")
    air.send(1006, A, category="vo")
    air.send(1006, A, category="vo", lifetime_us=100)
    air.send(1006, A, category="vo")
    assert [start for start, *_ in air.run()] == [1006, 1182]
    assert air.outcomes == [JobOutcome.EXPIRED, JobOutcome.SENT, JobOutcome.SENT]


def test_hidden_station_defers_for_the_rest_of_a_txop():
    # D receives only B's ACKs: the first, at 1226, reserves the medium to the end of the second, at 1462
    air = Air(
        4,
        access="edca",
        powers_dbm={(A, D): UNDETECTED_DBM, (D, A): UNDETECTED_DBM},
        backoffs={D: [(0, 15)]},
    )
    for _ in range(2):
        air.send(1006, A, B, category="vi")
    air.send(1306, D, category="be")
    assert air.run()[-1] == (1462 + AIFS_BE_US, 1665, D, "data")


def test_group_frame_reserves_the_next_one_of_its_txop():
    #  1006   1170 1186   1350
    #  A data |    A data |aifs| C data      D, hidden from A, begins at 1186 too: at C neither of the
    #              D data |                  two is 4 dB over the other. 105 bytes last 164 us, so that
    #                                        the second frame of A begins at a slot boundary of D
    hidden = dict.fromkeys([(A, D), (D, A)], UNDETECTED_DBM)
    weak = dict.fromkeys([(A, C), (D, C)], -75.0)
    air = Air(4, access="edca", powers_dbm=hidden | weak, backoffs={C: [(0, 15)]})
    for _ in range(2):
        air.send(1006, A, category="vo", frame_bytes=105)
    air.send(1180, D, category="be", frame_bytes=105)
    air.send(1206, C, category="be")
    assert air.run() == [
        (1006, 1170, A, "data"),
        (1186, 1350, A, "data"),
        (1186, 1350, D, "data"),
        (1350 + AIFS_BE_US, 1553, C, "data"),
    ]
    assert C not in air.transmissions[1].delivered + air.transmissions[2].delivered


def test_txop_holder_gets_responses_despite_its_own_nav():
    #  1006   1166 1182  1226 1242  1270 1286  1314 1330   1490 1506  1550
    #  A data |    B ack |    A rts |    C cts |    A data |    C ack |
    air = Air(3, access="edca")
    air.send(1006, A, B, category="vo")
    air.send(1006, A, C, category="vo", rts=True)
    assert [(start, source, kind) for start, _, source, kind in air.run()] == [
        (1006, A, "data"),
        (1182, B, "ack"),
        (1242, A, "rts"),
        (1286, C, "cts"),
        (1330, A, "data"),
        (1506, C, "ack"),
    ]
