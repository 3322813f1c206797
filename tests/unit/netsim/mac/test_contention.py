"""Channel access and frame exchange by DCF as timelines in microseconds. EDCA is in test_edca.

100 bytes at 6 Mbit/s last 160 us and their ACK 44 us; RTS and CTS at 24 Mbit/s last 28 us. Slot 9, SIFS 16,
DIFS 34. The file runs in under a second.
"""

from itertools import pairwise

import pytest
from netsim_air import UNDETECTED_DBM, A, Air, B, C, D

from netsim.mac.jobs import JobOutcome

SLOT_US, SIFS_US, DIFS_US, EIFS_US = 9, 16, 34, 94


def test_idle_medium_is_used_at_once():
    #  1000   1160 1176 1220
    #  A data | sifs | B ack
    air = Air(2)
    air.send(1000, A, B)
    assert air.run() == [(1000, 1160, A, "data"), (1176, 1220, B, "ack")]
    assert air.outcomes == [JobOutcome.ACKNOWLEDGED]
    assert air.arrivals == [(B, A, False)]


def test_frame_within_difs_of_a_busy_medium_waits_for_the_rest_of_difs():
    #  1000   1160  1170         1194
    #  A data |     B's arrives  B data
    air = Air(2)
    air.send(1000, A)
    air.send(1170, B)
    assert air.run()[1] == (1160 + DIFS_US, 1354, B, "data")


def test_frame_that_finds_the_medium_busy_backs_off():
    #  1000     1160 1194      1221
    #  A data   |difs| 3 slots | B data
    #    ^ B's arrives
    air = Air(2, backoffs={B: [(3, 15)]})
    air.send(1000, A)
    air.send(1100, B)
    assert air.run() == [(1000, 1160, A, "data"), (1160 + DIFS_US + 3 * SLOT_US, 1381, B, "data")]


def test_backoff_freezes_while_busy_and_resumes_with_the_remaining_slots():
    #  1000   1160 1194     1212     1372 1406     1433
    #  A data |difs|2 slots | C data |difs|3 slots | B data
    #  B drew 5, C drew 2
    air = Air(3, backoffs={B: [(5, 15)], C: [(2, 15)]})
    air.send(1000, A)
    air.send(1010, B)
    air.send(1020, C)
    assert air.run() == [(1000, 1160, A, "data"), (1212, 1372, C, "data"), (1433, 1593, B, "data")]


def test_post_backoff_delays_the_next_frame_of_the_same_station():
    air = Air(2, backoffs={A: [(4, 15)]})
    air.send(1000, A)
    air.send(1100, A)
    assert air.run()[1][0] == 1160 + DIFS_US + 4 * SLOT_US


def test_post_backoff_counts_down_without_a_frame():
    # drawn at 1160: 4 slots have passed at 1230; a frame at 1300 goes out at once, one at 1210 waits for them
    for arrives_us, starts_us in ((1300, 1300), (1210, 1230)):
        air = Air(2, backoffs={A: [(4, 15)]})
        air.send(1000, A)
        air.send(arrives_us, A)
        assert air.run()[1][0] == starts_us


@pytest.mark.parametrize("arrives_us", [1247, 1250, 1252, 1253])
def test_slots_before_a_busy_period_count_once(arrives_us):
    #  1000   1160 1194     1248   1408 1442    1478
    #  B data |difs|6 slots | A data |difs|4 slots| B data    B drew 10; that the next frame comes
    #                        ^ B's arrives                    before B can have sensed A's changes nothing
    air = Air(2, backoffs={B: [(10, 15)]})
    air.send(1000, B)
    air.send(1248, A)
    air.send(arrives_us, B)
    assert air.run()[2] == (1408 + DIFS_US + 4 * SLOT_US, 1638, B, "data")


def test_stations_that_start_in_the_same_instant_all_collide():
    stations = 6
    air = Air(stations)
    for station in range(stations):
        air.send(1000, station)
    assert [start for start, *_ in air.run()] == [1000] * stations
    assert not air.arrivals
    assert all(len(t.collided) == stations - 1 and not t.lost_to_noise for t in air.transmissions)


@pytest.mark.parametrize(("after_us", "starts_us"), [(4, 1004), (5, 1160 + DIFS_US)])
def test_energy_is_not_sensed_within_cca_time(after_us, starts_us):
    #  1000    1004           1160
    #  A data  |              |           B finds the medium idle up to 4 us after A began, and sends;
    #          | B data       |difs|      a microsecond later it waits
    air = Air(2, backoffs={B: [(0, 15)]})
    air.send(1000, A)
    air.send(1000 + after_us, B)
    assert air.run()[1][:3] == (starts_us, starts_us + 160, B)
    assert len(air.arrivals) == (0 if after_us == 4 else 2)


@pytest.mark.parametrize(("after_us", "starts_us"), [(4, 1004), (5, 1160 + DIFS_US)])
def test_preamble_is_detected_after_cca_time(after_us, starts_us):
    # as above, but A is below the energy threshold: B senses the frame when it has detected the preamble
    air = Air(2, powers_dbm={(A, B): -70.0}, backoffs={B: [(0, 15)]}, cca_missed_dbm=-62.0)
    air.send(1000, A)
    air.send(1000 + after_us, B)
    assert air.run()[1][:3] == (starts_us, starts_us + 160, B)


@pytest.mark.parametrize(
    ("missed_dbm", "power_dbm", "retry_us"),
    [
        (-62.0, -70.0, 1205 + DIFS_US + 2 * SLOT_US),
        (-62.0, -61.9, 2376 + DIFS_US + 2 * SLOT_US),
        (-82.0, -70.0, 2376 + DIFS_US + 2 * SLOT_US),
    ],
)
def test_retry_after_a_collision_with_a_longer_frame(missed_dbm, power_dbm, retry_us):
    #  1000   1160  1205             2376           A's frame and B's to C collide. A has missed B's preamble:
    #  A data |     time-out                        by the standard it senses B's rest from -62 dBm on, and
    #  B data                        |              otherwise retries after the time-out
    powers_dbm = {(A, B): power_dbm, (B, A): power_dbm}
    air = Air(3, powers_dbm=powers_dbm, backoffs={A: [(2, 31)]}, cca_missed_dbm=missed_dbm)
    air.send(1000, A, C, retry_limit=1)
    air.send(1000, B, frame_bytes=1014)
    assert [start for start, _, source, _ in air.run() if source == A] == [1000, retry_us]


@pytest.mark.parametrize(("missed_dbm", "starts_us"), [(-62.0, 1050), (-82.0, 1160 + DIFS_US)])
def test_frame_during_a_collision_of_weak_frames(missed_dbm, starts_us):
    # C finds neither preamble, and -70 dBm twice are -67
    powers_dbm = {(A, C): -70.0, (B, C): -70.0}
    air = Air(3, powers_dbm=powers_dbm, backoffs={C: [(0, 15)]}, cca_missed_dbm=missed_dbm)
    air.send(1000, A)
    air.send(1000, B)
    air.send(1050, C)
    assert air.run()[2][:3] == (starts_us, starts_us + 160, C)


def test_equal_backoffs_collide_despite_propagation():
    # 300 m: a microsecond between any two, a tenth of a slot
    delays_ns = {(i, j): 1_000 for i in range(3) for j in range(3) if i != j}
    air = Air(3, delays_ns=delays_ns, backoffs={B: [(2, 15)], C: [(2, 15)]})
    air.send(1000, A)
    air.send(1100, B)
    air.send(1100, C)
    # both count from the end at their own antennas, 1161
    assert [(start, source) for start, _, source, _ in air.run()] == [(1000, A), (1213, B), (1213, C)]


@pytest.mark.parametrize(("stronger_db", "wait_us"), [(6.0, EIFS_US), (0.0, DIFS_US)])
def test_eifs_follows_a_frame_received_with_errors(stronger_db, wait_us):
    #  1000        1160
    #  A data      |                 C finds A's preamble if that is 4 dB over B, fails to decode it and waits
    #  B data      |eifs|slot|C data EIFS; of two equal frames it finds neither and senses energy alone
    powers_dbm = {(A, C): -50.0, (B, C): -50.0 - stronger_db}
    air = Air(3, powers_dbm=powers_dbm, backoffs={C: [(1, 15)]})
    air.send(1000, A, mode="ofdm24", frame_bytes=400)
    air.send(1000, B, mode="ofdm24", frame_bytes=400)
    air.send(1050, C)
    end_us = 1000 + 20 + 4 * 34
    assert air.run()[2][:3] == (end_us + wait_us + SLOT_US, end_us + wait_us + SLOT_US + 160, C)


def test_a_correct_frame_ends_eifs():
    # D's frame reaches C while C waits EIFS; from its end on DIFS is enough
    powers_dbm = {(A, C): -50.0, (B, C): -56.0, (A, D): UNDETECTED_DBM, (B, D): UNDETECTED_DBM}
    air = Air(4, powers_dbm=powers_dbm, backoffs={C: [(0, 15)]})
    air.send(1000, A, mode="ofdm24", frame_bytes=400)
    air.send(1000, B, mode="ofdm24", frame_bytes=400)
    air.send(1050, C)
    air.send(1160, D)
    assert [frame for frame in air.run() if frame[2] in {C, D}] == [
        (1160, 1320, D, "data"),
        (1354, 1514, C, "data"),
    ]


def test_rts_and_cts_reserve_the_medium():
    #  1000  1028 1044  1072 1088   1248 1264 1308
    #  A rts |    B cts |    A data |    B ack |difs| C data
    air = Air(3, backoffs={C: [(0, 15)]})
    air.send(1000, A, B, rts=True)
    air.send(1035, C)
    assert air.run() == [
        (1000, 1028, A, "rts"),
        (1044, 1072, B, "cts"),
        (1088, 1248, A, "data"),
        (1264, 1308, B, "ack"),
        (1308 + DIFS_US, 1502, C, "data"),
    ]


@pytest.mark.parametrize("rts", [False, True])
def test_hidden_terminal_collides_unless_it_receives_the_cts(rts):
    # A and C do not receive each other, B receives both
    air = Air(3, powers_dbm={(A, C): UNDETECTED_DBM, (C, A): UNDETECTED_DBM}, backoffs={C: [(0, 15)]})
    air.send(1000, A, B, rts=rts)
    air.send(1100, C)
    air.run(1600)
    first_data = next(t for t in air.transmissions if t.source == A and t.frame.kind == "data")
    from_c = next(t for t in air.transmissions if t.source == C)
    if rts:
        # C waits for the end of the exchange at 1308, of which it receives only CTS and ACK
        assert (first_data.delivered, first_data.collided) == ([B], [])
        assert from_c.start_ns == 1_000 * (1308 + DIFS_US)
    else:
        assert (first_data.delivered, first_data.collided) == ([], [B])
        assert from_c.start_ns == 1_100_000


def test_exposed_terminal_defers_without_need():
    # A - B - C - D in a row, each receives only its neighbours: B's frame to A delays C's to D
    #  1000   1160 1176     1220
    #  B data |    | A ack  |difs| C data      C misses the ACK, but its time is in B's Duration field
    hidden = [(i, j) for i in range(4) for j in range(4) if abs(i - j) > 1]
    air = Air(4, powers_dbm=dict.fromkeys(hidden, UNDETECTED_DBM), backoffs={C: [(0, 15)]})
    air.send(1000, B, A)
    air.send(1050, C, D)
    assert air.run()[2] == (1220 + DIFS_US, 1414, C, "data")
    assert air.outcomes == [JobOutcome.ACKNOWLEDGED] * 2


@pytest.mark.parametrize(("later_us", "arrivals"), [(10, [(B, C, False)]), (30, [])])
def test_stronger_frame_captures_a_receiver_in_the_preamble(later_us, arrivals):
    #  1000    1016          1160
    #  A data  |             |            preamble of A up to 1016: C's frame, 10 dB over A's at B, takes B
    #      C data  |             |        over if it begins before; later it only breaks A's
    powers_dbm = {(A, B): -60.0, (C, B): -50.0, (A, C): UNDETECTED_DBM, (C, A): UNDETECTED_DBM}
    air = Air(3, powers_dbm=powers_dbm)
    air.send(1000, A)
    air.send(1000 + later_us, C)
    air.run()
    assert air.arrivals == arrivals


def test_busy_medium_beyond_nav_is_waited_for():
    #  1000  1028 1044  1072 1088   1248 1264 1308            C has the NAV of the RTS; D receives only C
    #  A rts |    B cts |    A data |    B ack |              and reaches only C, breaks B's ACK at C,
    #                                     1290 D data 1450    and holds it back beyond NAV and EIFS
    hidden = [(A, D), (D, A), (B, D), (D, B)]
    air = Air(4, powers_dbm=dict.fromkeys(hidden, UNDETECTED_DBM), backoffs={C: [(0, 15)]})
    air.send(1000, A, B, rts=True)
    air.send(1035, C)
    air.send(1290, D)
    assert air.run()[-2:] == [(1290, 1450, D, "data"), (1450 + DIFS_US, 1644, C, "data")]
    assert air.outcomes == [JobOutcome.ACKNOWLEDGED, JobOutcome.SENT, JobOutcome.SENT]


@pytest.mark.parametrize("arrives_us", [1210, 1250, 1280, 1300, 1470, 1509])
def test_frame_queued_during_nav_waits_for_its_end(arrives_us):
    #  1000   1160 1194 1200  1228 1244  1272 1288   1448 1464  1508 1542    1668
    #  C data |difs|    A rts |    B cts |    A data |    B ack |difs|14 slots| C data      C drew 15: one
    #                                                                                       has passed at 1204
    air = Air(3, backoffs={C: [(15, 15)]})
    air.send(1000, C)
    air.send(1200, A, B, rts=True)
    air.send(arrives_us, C)
    assert air.run()[-1] == (1508 + DIFS_US + 14 * SLOT_US, 1828, C, "data")


def test_nav_is_reset_when_no_frame_follows_an_rts():
    # 1028 + 2 SIFS + CTS 28 + preamble 20 + 2 slots = 1126
    air = Air(3, powers_dbm={(A, B): UNDETECTED_DBM}, backoffs={C: [(0, 15)]})
    air.send(1000, A, B, rts=True, frame_bytes=1000, retry_limit=0)
    air.send(1035, C)
    assert air.run()[1] == (1126 + DIFS_US, 1320, C, "data")


def test_lost_frame_is_retried_with_doubled_windows_and_dropped():
    # no answer: 45 us after its end the exchange has failed, then DIFS and the backoff, here the whole window
    windows = [31, 63, 127, 255, 511, 1023, 1023]
    air = Air(2, powers_dbm={(A, B): UNDETECTED_DBM}, backoffs={A: [(w, w) for w in windows]})
    air.send(1000, A, B)
    starts_us = [start for start, *_ in air.run()]
    gaps_us = [later - earlier for earlier, later in pairwise(starts_us)]
    assert gaps_us == [160 + SIFS_US + SLOT_US + 20 + DIFS_US + w * SLOT_US for w in windows]
    assert air.outcomes == [JobOutcome.RETRY_LIMIT]


def test_window_is_reset_after_the_retry_limit():
    # two attempts: the second failure gives the frame up, and the next one backs off from 0..15, not 0..63
    air = Air(2, powers_dbm={(A, B): UNDETECTED_DBM}, backoffs={A: [(31, 31), (15, 15)]})
    for _ in range(2):
        air.send(1000, A, B, retry_limit=1)
    starts_us = [start for start, *_ in air.run()]
    gaps_us = [later - earlier for earlier, later in pairwise(starts_us)]
    failed_us = 160 + SIFS_US + SLOT_US + 20
    assert gaps_us[:2] == [failed_us + DIFS_US + slots * SLOT_US for slots in (31, 15)]
    assert air.outcomes == [JobOutcome.RETRY_LIMIT] * 2


def test_repeated_frame_is_marked_as_a_duplicate():
    # B receives A, A never receives B's ACK
    air = Air(2, powers_dbm={(B, A): UNDETECTED_DBM})
    air.send(1000, A, B, retry_limit=2)
    air.send(500_000, A, B, retry_limit=0)
    air.run()
    assert air.arrivals == [(B, A, False), (B, A, True), (B, A, True), (B, A, False)]


def test_ack_that_begins_in_time_is_awaited():
    # at 6 Mbit/s the ACK ends 60 us after the frame, 15 us past the time-out, which stops at its preamble
    air = Air(2)
    air.send(1000, A, B)
    air.run()
    assert air.outcomes == [JobOutcome.ACKNOWLEDGED]
    assert len(air.transmissions) == 2


@pytest.mark.parametrize("begins_us", [1195, 1198, 1200])
def test_exchange_fails_at_its_time_out_despite_a_frame_that_begins_too_late(begins_us):
    #  1000   1160 1161   1189  1205  1233  1355 1389    1407
    #  A data |    C data |     A ack |     |difs|2 slots| A data     B misses C. At 1205, A's time-out, D's
    #                       1195 D data     |                         frame is there for less than 20 us; A's
    #                                                                 ACK to C breaks it off
    hidden = [(A, B), (A, C), (A, D), (C, D), (D, C)]
    air = Air(4, powers_dbm=dict.fromkeys(hidden, UNDETECTED_DBM), backoffs={A: [(2, 31)]})
    air.send(1000, A, B, retry_limit=1)
    air.send(1161, C, A, frame_bytes=40, mode="ofdm54", retry_limit=0)
    air.send(begins_us, D)
    starts_us = [start for start, _, source, kind in air.run() if (source, kind) == (A, "data")]
    assert starts_us == [1000, begins_us + 160 + DIFS_US + 2 * SLOT_US]
    assert air.outcomes.count(JobOutcome.RETRY_LIMIT) == 2


def test_rts_of_a_group_frame_goes_to_the_strongest_neighbour():
    #  9000  9028 9044  9072 9088
    #  A rts |    C cts |    A data
    air = Air(3, powers_dbm={(B, A): -60.0, (C, A): -55.0})
    air.send(1000, B)
    air.send(5000, C)
    air.send(9000, A, rts=True)
    assert air.run()[2:] == [(9000, 9028, A, "rts"), (9044, 9072, C, "cts"), (9088, 9248, A, "data")]
    assert air.transmissions[-1].delivered == [B, C]


def test_group_frame_without_recent_neighbours_is_sent_without_rts():
    air = Air(2)
    air.send(1000, A, rts=True)
    air.send(10_000, B)
    air.send(1_010_200, A, rts=True)
    assert [kind for *_, kind in air.run(2_000_000)] == ["data", "data", "data"]


def test_group_frame_is_dropped_without_cts():
    air = Air(2, powers_dbm={(A, B): UNDETECTED_DBM})
    air.send(1000, B)
    air.send(2000, A, rts=True, retry_limit=3)
    assert [kind for *_, kind in air.run()] == ["data", "rts", "rts", "rts", "rts"]
    assert air.outcomes == [JobOutcome.SENT, JobOutcome.RETRY_LIMIT]


def test_next_rts_goes_to_the_next_strongest_neighbour():
    air = Air(3, powers_dbm={(B, A): -55.0, (C, A): -60.0, (A, B): UNDETECTED_DBM})
    air.send(1000, B)
    air.send(5000, C)
    air.send(9000, A, rts=True)
    air.run()
    assert [t.frame.destination for t in air.transmissions if t.frame.kind == "rts"] == [B, C]
    assert air.transmissions[-1].delivered == [C]


def test_expired_frames_make_room_in_a_full_queue():
    # B's queue of ten fills at 1010 while A's 1000 bytes are on the air to 2360; at 1700 the ten have expired
    air = Air(2)
    air.send(1000, A, frame_bytes=1000)
    for _ in range(10):
        air.send(1010, B, lifetime_us=600)
    air.send(1500, B)
    air.send(1700, B)
    air.run()
    assert air.outcomes == [JobOutcome.OVERFLOW, *[JobOutcome.EXPIRED] * 10, JobOutcome.SENT, JobOutcome.SENT]


def test_queue_is_bounded_in_length_and_time():
    air = Air(2, powers_dbm={(A, B): UNDETECTED_DBM})
    for _ in range(12):
        air.send(1000, A, B, retry_limit=0, lifetime_us=600)
    air.run()
    # ten fit; after 600 us whatever was not yet sent has expired
    assert air.outcomes.count(JobOutcome.OVERFLOW) == 2
    sent = len(air.transmissions)
    assert 1 <= sent <= 3
    assert air.outcomes.count(JobOutcome.RETRY_LIMIT) == sent
    assert air.outcomes.count(JobOutcome.EXPIRED) == 10 - sent
