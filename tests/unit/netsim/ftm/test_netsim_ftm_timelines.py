"""Ranging sessions as timelines in microseconds.

At 24 Mbit/s a request of 42 bytes lasts 20 + 4 ceil((22 + 336) / 96) = 36 us, a trigger of 31 bytes 32, the
first measurement frame of 59 bytes 44, the others of 48 bytes 40 and an ACK 28. SIFS 16, slot 9, AIFS of VO
34, as DIFS. The station that answers a request draws a backoff, for its ACK comes between. Costs a second.
"""

from functools import partial

import numpy as np
import pytest
from netsim_ftm_air import A, B, C, FtmAir

from netsim.ftm.elements import Measurement, Parameters, Request, Status
from netsim.model.config import FtmConfig

SLOT_US, SIFS_US, AIFS_US = 9, 16, 34
REQUEST_US, TRIGGER_US, FIRST_US, FRAME_US, ACK_US = 36, 32, 44, 40, 28
TIMEOUT_US = SIFS_US + SLOT_US + 20
TIME_UNIT_US = 1_024
DcfAir = partial(FtmAir, access="dcf")
"""Stations that send at once on an idle medium; EDCA waits for a slot boundary."""
NO_SLOTS = (0, 1023)
"""A backoff that is 0 in every window."""


def exchange(start_us, duration_us, source, to, what):
    """A frame and its ACK."""
    end_us = start_us + duration_us
    return [
        (start_us, end_us, source, what),
        (end_us + SIFS_US, end_us + SIFS_US + ACK_US, to, "ack"),
    ]


def quiet(**ftm):
    return FtmConfig(**{"mode": "ofdm24", "round_trip_std_ps": 0.0, **ftm})


def test_burst_of_three():
    #  1000         1052  1080      1123                  1323              1523
    #  A request |sifs| B ack |aifs+1| B 1! |sifs| A ack    B 2<1 |.| A ack   B 0<2 |.| A ack
    #                                   <--- min delta 200 --><---- 200 ------>
    air = DcfAir(backoffs={B: [(1, 15), *[NO_SLOTS] * 9]}, ftm=quiet(ftms_per_burst=3))
    air.request(1_000)
    first_us = 1_080 + AIFS_US + SLOT_US
    assert first_us == 1_123
    assert air.run(10_000) == [
        *exchange(1_000, REQUEST_US, A, B, "request"),
        *exchange(first_us, FIRST_US, B, A, "1!"),
        *exchange(first_us + 200, FRAME_US, B, A, "2<1"),
        *exchange(first_us + 400, FRAME_US, B, A, "0<2"),
    ]
    (result,) = air.results
    assert (result.status, result.round_trips, result.measurements) == ("ok", 2, 3)
    assert result.ended_ns == 1_000 * (first_us + 400 + FRAME_US)
    # the round trips used are those of the first two frames
    assert result.measured_ns == 1_000 * (first_us + FIRST_US + first_us + 200 + FRAME_US) // 2
    assert air.queue.next_ns() > 10**18


@pytest.mark.parametrize(("short_slot", "slot_us"), [(True, 9), (False, 20)])
def test_burst_at_2_4_ghz(short_slot, slot_us):
    """SIFS is 10 us and frames last 6 us more: t3 is as long after t2, and the distance is the true one."""
    air = DcfAir(
        distance_m=299.792458,  # 1 us
        backoffs={B: [(1, 15), NO_SLOTS, NO_SLOTS]},
        ftm=quiet(ftms_per_burst=2, clock_ppm=0.0),
        frequency_mhz=2437.0,
        short_slot=short_slot,
    )
    air.request(1_000)
    request_us, first_us, frame_us, ack_us = (6 + each for each in (REQUEST_US, FIRST_US, FRAME_US, ACK_US))
    acknowledged_us = 1_000 + request_us + 1 + 10 + ack_us  # at B
    burst_us = acknowledged_us + 10 + 2 * slot_us + slot_us
    assert air.run(10_000) == [
        (1_000, 1_000 + request_us, A, "request"),
        (acknowledged_us - ack_us, acknowledged_us, B, "ack"),
        (burst_us, burst_us + first_us, B, "1!"),
        (burst_us + first_us + 11, burst_us + first_us + 11 + ack_us, A, "ack"),
        (burst_us + 200, burst_us + 200 + frame_us, B, "0<1"),
        (burst_us + 200 + frame_us + 11, burst_us + 200 + frame_us + 11 + ack_us, A, "ack"),
    ]
    (result,) = air.results
    assert (result.status, result.round_trips) == ("ok", 1)
    assert result.distance_m == pytest.approx(299.792458, abs=0.05)


def test_vht_format_at_2_4_ghz_is_rejected():
    air = FtmAir(ftm=quiet(), frequency_mhz=2437.0)
    requested = Parameters(format_and_bandwidth=10, ftms_per_burst=8, asap=True)
    air.send(1_000, A, B, Request(parameters=requested))
    air.run(40_000)
    assert air.transmissions[2].frame.body.parameters.status is Status.INCAPABLE
    assert air.transmissions[2].frame.mode.name == "ofdm24"


def test_responder_that_needs_more_time_sends_fewer_frames_farther_apart():
    #  1114     1414      asked: 8 frames 200 us apart in 250 us; granted: 2, 300 us apart in 1 ms
    #  B 1!     B 0<1
    ftm = quiet(burst_duration_us=250, responder_ftms_per_burst=2, responder_min_delta_us=300)
    air = DcfAir(backoffs={B: [NO_SLOTS]}, ftm=ftm)
    air.request(1_000)
    assert air.run(10_000)[2:] == [
        *exchange(1_114, FIRST_US, B, A, "1!"),
        *exchange(1_414, FRAME_US, B, A, "0<1"),
    ]
    granted = air.transmissions[2].frame.body.parameters
    assert (granted.ftms_per_burst, granted.min_delta_us, granted.burst_duration_us) == (2, 300, 1_000)
    assert [(r.status, r.round_trips) for r in air.results] == [("ok", 1)]


def test_second_burst_begins_on_schedule_with_the_last_stamps_of_the_first():
    #  request at 1000..1036 | 1024 + 100 ms: TSF of the request, cut to a time unit, and the burst period
    #  B 1!   B 2<1           A trigger |.| B ack |aifs+2| B 3<2   B 0<3
    air = DcfAir(
        backoffs={B: [NO_SLOTS, NO_SLOTS, NO_SLOTS, (2, 15)]},
        ftm=quiet(bursts_exponent=1, ftms_per_burst=2),
    )
    air.request(1_000)
    second_us = TIME_UNIT_US + 100_000
    third_us = second_us + TRIGGER_US + SIFS_US + ACK_US + AIFS_US + 2 * SLOT_US
    assert air.run(150_000) == [
        *exchange(1_000, REQUEST_US, A, B, "request"),
        *exchange(1_114, FIRST_US, B, A, "1!"),
        *exchange(1_314, FRAME_US, B, A, "2<1"),
        *exchange(second_us, TRIGGER_US, A, B, "trigger"),
        *exchange(third_us, FRAME_US, B, A, "3<2"),
        *exchange(third_us + 200, FRAME_US, B, A, "0<3"),
    ]
    # all round trips in one result, after the request's time-out of 100 ms, which the grant has moved
    (result,) = air.results
    assert (result.status, result.round_trips, result.measurements) == ("ok", 3, 4)
    assert result.ended_ns == 1_000 * (third_us + 200 + FRAME_US)


def test_first_burst_without_asap_begins_on_schedule():
    #  1000        1114              12288: 10 ms after the request came, rounded up to a time unit
    #  A request   B 1! (announces)  A trigger |.| B ack |aifs| B 2   B 3<2   B 0<3
    air = DcfAir(backoffs={B: [*[NO_SLOTS] * 9]}, ftm=quiet(asap=False, ftms_per_burst=3))
    air.request(1_000)
    begin_us = -(-(1_000 + REQUEST_US + 10_000) // TIME_UNIT_US) * TIME_UNIT_US
    first_us = begin_us + TRIGGER_US + SIFS_US + ACK_US + AIFS_US
    assert air.run(50_000)[2:] == [
        *exchange(1_114, FIRST_US, B, A, "1!"),
        *exchange(begin_us, TRIGGER_US, A, B, "trigger"),
        *exchange(first_us, FRAME_US, B, A, "2"),
        *exchange(first_us + 200, FRAME_US, B, A, "3<2"),
        *exchange(first_us + 400, FRAME_US, B, A, "0<3"),
    ]
    # the announcement is no measurement
    assert [(r.status, r.round_trips, r.measurements) for r in air.results] == [("ok", 2, 3)]


def test_responder_without_asap_grants_a_later_time():
    air = FtmAir(ftm=quiet(responder_asap_capable=False, ftms_per_burst=2))
    air.request(1_000)
    timeline = air.run(50_000)
    granted = air.transmissions[2].frame.body.parameters
    assert (granted.asap, granted.asap_capable) == (False, False)
    assert [what for _, _, _, what in timeline if what != "ack"] == ["request", "1!", "trigger", "2", "0<2"]
    assert air.results[0].round_trips == 1


def test_last_transmission_of_a_frame_with_lost_ack_counts():
    #  1114          1174 lost    1203        1158 + 45: no ACK; then AIFS and 4 slots of CW 7
    #  B 1! |.| A ack ~~~~ | no answer | aifs + 4 | B 1! |.| A ack     B 0<1
    air = DcfAir(
        distance_m=30.0,
        backoffs={B: [NO_SLOTS, (4, 31)]},
        lost_us={A: [(1_150, 1_190)]},
        ftm=quiet(ftms_per_burst=2, clock_ppm=0.0),
    )
    air.request(1_000)
    air.queue.run_until(10_000_000)
    measurements = [t for t in air.transmissions if isinstance(t.frame.body, Measurement)]
    assert [FtmAir.what(t) for t in measurements] == ["1!", "1!", "0<1"]
    first, again, last = measurements
    timeout_ns = 1_000 * (TIMEOUT_US + AIFS_US + 4 * SLOT_US)
    assert again.start_ns == first.end_ns + timeout_ns
    assert last.start_ns == again.start_ns + 200_000
    # 30 m are 100069 ps each way; t4 - t1 is of the second transmission: frame, SIFS and two ways
    body = last.frame.body
    ack = next(t for t in air.transmissions if t.source == A and t.start_ns > again.end_ns)
    assert abs(body.t4_ps - body.t1_ps - 1_000 * (ack.start_ns - again.start_ns) - 100_069) < 200
    (result,) = air.results
    assert (result.round_trips, result.measurements) == (1, 2)
    assert result.measured_ns == again.end_ns + 100
    assert abs(result.distance_m - 30.0) < 0.005


def test_frame_lost_after_all_retries_costs_its_round_trips_and_the_grant_is_repeated():
    #  1114          1237                1852          2052: min delta
    #  B 1! ~~~ aifs B 1! ~~~ aifs ..... B 1! ~~~      B 2! |.| A ack     B 3<2 |.| A ack    B 0<3 |.| A ack
    air = DcfAir(
        backoffs={B: [*[NO_SLOTS] * 19]},
        lost_us={B: [(1_100, 1_900)]},
        retry_limit=6,
        ftm=quiet(ftms_per_burst=4),
    )
    air.request(1_000)
    again_us = FIRST_US + TIMEOUT_US + AIFS_US
    starts = [(start, what) for start, _, source, what in air.run(20_000) if source == B]
    assert starts[1:8] == [(1_114 + again_us * attempt, "1!") for attempt in range(7)]
    assert starts[8:] == [(2_052, "2!"), (2_252, "3<2"), (2_452, "0<3")]
    assert [(r.status, r.round_trips, r.measurements) for r in air.results] == [("ok", 2, 3)]


def test_frame_lost_in_the_middle_costs_two_round_trips():
    #  1114          1314        1437              2252
    #  B 1! |.| A ack  B 2<1 ~~~ aifs B 2<1 ~~~ ... B 3 |.| A ack   B 4<3 |.| A ack   B 0<4 |.| A ack
    air = DcfAir(
        backoffs={B: [*[NO_SLOTS] * 19]},
        lost_us={B: [(1_200, 2_100)]},
        ftm=quiet(ftms_per_burst=5),
    )
    air.request(1_000)
    again_us = FRAME_US + TIMEOUT_US + AIFS_US
    starts = [(start, what) for start, _, source, what in air.run(20_000) if source == B]
    assert starts[2:9] == [(1_314 + again_us * attempt, "2<1") for attempt in range(7)]
    last_us = 1_314 + again_us * 6
    assert starts[9:] == [(last_us + 200, "3"), (last_us + 400, "4<3"), (last_us + 600, "0<4")]
    assert [(r.round_trips, r.measurements) for r in air.results] == [(2, 4)]


def test_rejected_request_reports_the_retry_time():
    #  A and B range to C, which serves one of them
    air = FtmAir(3, ftm=quiet(responder_sessions=1, ftms_per_burst=31))
    air.request(1_000, A, C)
    air.request(1_500, B, C)
    timeline = air.run(50_000)
    refused = next(
        t for t in air.transmissions if t.source == C and t.frame.destination == B and t.frame.body
    )
    assert refused.frame.body == Measurement(
        token=0, parameters=Parameters(status=Status.FAILED, value=1, partial_tsf=0)
    )
    assert [what for _, _, source, what in timeline if source == C].count("0!") == 1
    assert [(r.initiator, r.status, r.retry_after_s) for r in air.results] == [
        (B, "rejected", 1),
        (A, "ok", 0),
    ]
    assert air.results[1].round_trips == 30


def test_format_wider_than_the_channel_is_rejected():
    air = FtmAir(ftm=quiet())
    requested = Parameters(format_and_bandwidth=13, ftms_per_burst=8, asap=True)
    air.send(1_000, A, B, Request(parameters=requested))
    air.request(50_000)
    assert [what for _, _, source, what in air.run(40_000) if source == B] == ["ack", "0!"]
    refused = air.transmissions[2].frame.body
    assert refused.parameters.status is Status.INCAPABLE
    # the initiator reports the rejection, here before its first round trip
    air.send(50_100, A, B, Request(parameters=requested))
    air.run(90_000)
    assert [r.status for r in air.results] == ["incapable"]


def test_lost_triggers_cost_their_burst_and_no_other():
    # A is not received around the second of four bursts; the first one's last stamps are sent in the third
    air = DcfAir(
        lost_us={A: [(99_000, 180_000)]},
        ftm=quiet(bursts_exponent=2, ftms_per_burst=3, burst_duration_us=4_000),
    )
    air.request(1_000)
    sent = [what for _, _, source, what in air.run(500_000) if source == B and what != "ack"]
    assert sent == ["1!", "2<1", "3<2", "4<3", "5<4", "6<5", "7<6", "8<7", "0<8"]
    assert [(r.status, r.round_trips) for r in air.results] == [("ok", 8)]
    triggers_us = [start for start, _, _, what in air.run(500_000) if what == "trigger"]
    # a trigger that is not answered is repeated until its retry limit or the end of its burst
    assert 1 < len([us for us in triggers_us if 101_024 <= us <= 105_024]) <= 7
    assert [us for us in triggers_us if us > 106_000] == [201_024, 301_024]


def test_every_burst_begins_on_schedule():
    air = DcfAir(ftm=quiet(bursts_exponent=6, ftms_per_burst=5, burst_period_ms=200))
    air.request(5_000)
    timeline = air.run(14_000_000)
    first_us = 5_000 // TIME_UNIT_US * TIME_UNIT_US
    triggers_us = [start for start, _, _, what in timeline if what == "trigger"]
    assert triggers_us == [first_us + 200_000 * burst for burst in range(1, 64)]
    # 320 frames: dialog tokens go round once from 255 to 1, and the last is 0
    assert [(r.status, r.round_trips, r.measurements) for r in air.results] == [("ok", 319, 320)]
    assert abs(air.results[0].distance_m) < 0.005


def test_peer_silenced_between_bursts_leaves_the_completed_round_trips():
    air = FtmAir(ftm=quiet(bursts_exponent=2, ftms_per_burst=4))
    air.request(1_000)
    air.run(50_000)
    assert not air.results
    air.radios[B].silence()
    air.run(1_000_000)
    # the initiator waits for its last burst: 300 ms and its duration, a time unit and a millisecond
    (result,) = air.results
    assert (result.status, result.round_trips) == ("ok", 3)
    assert result.ended_ns == 1_000 * (TIME_UNIT_US + 300_000 + 16_000 + TIME_UNIT_US + 1_000)
    assert air.queue.next_ns() > 10**18


def test_stop_ends_a_session_and_frees_its_slot():
    air = FtmAir(3, ftm=quiet(responder_sessions=1, bursts_exponent=3, ftms_per_burst=2))
    air.request(1_000, A, C)
    air.run(50_000)
    air.send(55_000, A, C, Request(trigger=False))
    air.request(60_000, B, C)
    air.run(2_000_000)
    assert [(r.initiator, r.status, r.round_trips) for r in air.results] == [(A, "ok", 1), (B, "ok", 15)]


def test_early_and_repeated_triggers_are_ignored():
    #  bursts of 4 ms from 1024 and 101024 on; own triggers: in the first, between the two, in the second
    air = FtmAir(ftm=quiet(bursts_exponent=1, ftms_per_burst=3, burst_duration_us=4_000))
    air.request(1_000)
    for at_us in (3_000, 50_000, 103_000, 150_000):
        air.send(at_us, A, B, Request())
    sent = [what for _, _, source, what in air.run(300_000) if source == B and what != "ack"]
    assert sent == ["1!", "2<1", "3<2", "4<3", "5<4", "0<5"]


def test_announcement_lost_after_all_retries_ends_the_session_and_frees_its_slot():
    air = FtmAir(
        3, lost_us={C: [(1_100, 5_000)]}, ftm=quiet(asap=False, responder_sessions=1, ftms_per_burst=2)
    )
    air.request(1_000, A, C)
    air.request(8_000, B, C)
    air.run(300_000)
    assert [(r.initiator, r.status, r.ended_ns) for r in air.results][1:] == [(A, "timeout", 101_000_000)]
    assert (air.results[0].initiator, air.results[0].status) == (B, "ok")


@pytest.mark.parametrize("seed", range(12))
def test_every_request_ends_once_with_correct_round_trips_despite_losses(seed):
    """Three stations range to each other, and in a fifth of the time their frames are not received.

    Time stamps paired with those of another frame or transmission would be wrong by microseconds, or
    hundreds of metres.
    """
    rng = np.random.default_rng(seed)
    lost_us = {
        station: [(int(at), int(at + rng.exponential(1_000))) for at in rng.uniform(0, 500_000, 100)]
        for station in (A, B, C)
    }
    ftm = quiet(
        bursts_exponent=seed % 3,
        asap=bool(seed % 2),
        ftms_per_burst=4,
        responder_sessions=1 + seed % 2,
        burst_duration_us=4_000,
    )
    air = FtmAir(3, distance_m=50.0, lost_us=lost_us, ftm=ftm, seed=seed)
    pairs = [(a, b) for a in (A, B, C) for b in (A, B, C) if a != b]
    for at_us in range(1_000, 400_000, 10_000):
        source, peer = pairs[rng.integers(len(pairs))]
        air.request(at_us, source, peer, seq=at_us)
    air.queue.run_until(2_000_000_000)
    assert sorted(r.seq for r in air.results) == list(range(1_000, 400_000, 10_000))
    assert air.queue.next_ns() > 10**18
    measured = [r for r in air.results if r.status == "ok"]
    assert len(measured) > 3
    for result in measured:
        assert 1 <= result.round_trips < result.measurements <= 4 * 2**ftm.bursts_exponent
        assert abs(result.distance_m - result.true_distance_m) < 0.05
        assert result.distance_std_m < 0.05
