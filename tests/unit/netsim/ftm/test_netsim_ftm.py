"""Fine Time Measurement: frames on the air, statistics against the measured figures, ends of sessions.

Costs six seconds.
"""

from itertools import pairwise
from math import sqrt

import numpy as np
import pytest
from netsim_ftm_air import FtmAir
from netsim_swarm import Swarm

from netsim.ftm.stamps import (
    FIELD_PS,
    Clock,
    arrival_std_ps,
    distance_m,
    format_name,
    frequency_ratio_std,
    measured_m,
    round_trip_std_ps,
)
from netsim.model.config import FtmConfig
from netsim.wire.messages import FtmResult

BOTH_WAYS = ((1, 0), (0, 1))
TWENTY_METRES = [(0.0, 0.0, -20.0), (20.0, 0.0, -20.0)]


def results(swarm):
    return [(station, item) for station, item in swarm.received if isinstance(item, FtmResult)]


@pytest.mark.parametrize(
    ("width", "mode", "request_us", "first_us", "frame_us", "ack_us"),
    [
        # 42, 59 and 48 bytes; at 6 Mbit/s 20 + 4 ceil((22 + 8 L) / 24)
        (20, "ofdm6", 80, 104, 88, 44),
        (20, "ofdm24", 36, 44, 40, 28),
        # 40 + 4 ceil((22 + 8 (L + 4)) / 117)
        (80, "vht_mcs0", 56, 60, 56, 44),
    ],
)
def test_burst_of_eight_on_the_air(width, mode, request_us, first_us, frame_us, ack_us):
    swarm = Swarm(TWENTY_METRES, bandwidth_mhz=width, rician_k_db=None, ftm=FtmConfig(mode=mode))
    swarm.request(0, 1, 1_000)
    swarm.run(20_000)
    frames = swarm.emulator.take_frames()
    assert [(f.kind, f.source) for f in frames] == [("ftm_request", 0), ("ack", 1)] + [
        ("ftm", 1),
        ("ack", 0),
    ] * 8
    durations_us = [(f.end_ns - f.start_ns) / 1_000 for f in frames]
    assert durations_us == [request_us, ack_us, first_us, ack_us] + [frame_us, ack_us] * 7
    measurements, acks = frames[2::2], frames[3::2]
    assert all(later.start_ns - earlier.start_ns >= 200_000 for earlier, later in pairwise(measurements))
    # 20 m are 67 ns
    assert all(
        ack.start_ns - frame.end_ns == 16_000 + 67 for frame, ack in zip(measurements, acks, strict=True)
    )
    assert [f.seq for f in measurements] == list(range(1, 9))
    assert results(swarm)[0][1].round_trips == 7


@pytest.mark.parametrize(
    ("width", "mode", "sheet_ms"), [(20, "ofdm6", 1.75), (20, "ofdm24", 1.18), (80, "vht_mcs0", 1.50)]
)
def test_airtime_of_a_session_of_eight(width, mode, sheet_ms):
    """Mean of 200 sessions whose frames follow each other as fast as access allows.

    The request finds the medium idle; its AIFS of 34 us and mean backoff of 1.5 slots are added.
    """
    air = FtmAir(bandwidth_mhz=width, ftm=FtmConfig(mode=mode, min_delta_us=100))
    for i in range(200):
        air.request(4_000 * (i + 1))
    frames = air.run(810_000)
    assert len(frames) == 200 * 18
    took_us = [frames[i + 17][1] - frames[i][0] for i in range(0, len(frames), 18)]
    assert {what for _, _, _, what in frames[::18]} == {"request"}
    # backoffs of 8 exchanges: 1.12 slots each, 28 us for a session, 2 us for the mean of 200
    assert 1e-3 * (np.mean(took_us) + 34 + 1.5 * 9) == pytest.approx(sheet_ms, rel=0.05)


def mode_of(width):
    """Return a mode whose time stamps have the precision of the channel's width."""
    return "ofdm24" if width == 20 else "vht_mcs4"


def session_statistics(width, *, sessions=300, places=TWENTY_METRES, **ftm):
    config = FtmConfig(mode=mode_of(width), **ftm)
    swarm = Swarm(places, bandwidth_mhz=width, rician_k_db=None, ftm=config)
    for i in range(sessions):
        swarm.request(0, 1, 4_000 * i)
    swarm.run(4_000 * (sessions + 2))
    records = swarm.emulator.take_sessions()
    assert [r.status for r in records] == ["ok"] * sessions
    errors_m = np.array([r.distance_m - r.true_distance_m for r in records])
    single_std_m = sqrt(np.mean([r.distance_std_m**2 for r in records]))
    return errors_m, single_std_m, records[0].round_trips


@pytest.mark.parametrize(("width", "single_m"), [(20, 0.384), (40, 0.161), (80, 0.0806)])
def test_error_has_no_bias_and_the_measured_deviation(width, single_m):
    errors_m, measured_single_m, round_trips = session_statistics(width)
    # standard error of the deviation with 2100 round trips: 1.6 %, of 300 means: 4.1 %
    assert measured_single_m == pytest.approx(single_m, rel=0.06)
    mean_std_m = single_m / sqrt(round_trips)
    assert errors_m.std() == pytest.approx(mean_std_m, rel=0.15)
    assert abs(errors_m.mean()) < 4 * mean_std_m / sqrt(errors_m.size)


def test_more_frames_reduce_the_white_noise():
    short_m, _, few = session_statistics(20, ftms_per_burst=3)
    long_m, _, many = session_statistics(20, ftms_per_burst=17)
    assert (few, many) == (2, 16)
    assert short_m.std() / long_m.std() == pytest.approx(sqrt(8), rel=0.2)


def test_clock_offset_and_drift_cancel():
    # uncorrected, clocks 200 ppm apart would be 15 ns or 2 m off over the 72 us from t2 to t3
    for seed in range(5):
        swarm = Swarm(
            TWENTY_METRES, seed=seed, rician_k_db=None, ftm=FtmConfig(clock_ppm=100.0, round_trip_std_ps=0.0)
        )
        swarm.request(0, 1, 1_000)
        swarm.run(20_000)
        # what is left: the bound at 49 dB, some 15 ps of arrival and 0.01 ppm of frequency
        assert results(swarm)[0][1].distance_m == pytest.approx(20.0, abs=0.01)


def test_calibration_bias_belongs_to_the_pair():
    places = [*TWENTY_METRES, (0.0, 20.0, -20.0)]
    swarm = Swarm(places, rician_k_db=None, ftm=FtmConfig(calibration_bias_std_m=1.0, round_trip_std_ps=0.0))
    for i, (initiator, peer) in enumerate([(0, 1), (1, 0), (0, 1), (0, 2)]):
        swarm.request(initiator, peer, 20_000 * i)
    swarm.run(100_000)
    bias_m = [item.distance_m - 20.0 for _, item in results(swarm)]
    assert bias_m[:3] == pytest.approx([bias_m[0]] * 3, abs=0.01)
    assert abs(bias_m[0]) > 0.05
    assert abs(bias_m[3] - bias_m[0]) > 0.05


@pytest.mark.parametrize(("width", "single_m", "bias_m"), [(20, 0.384, -2.5), (40, 0.161, 40.0)])
def test_mean_error_of_2000_sessions_is_the_configured_bias(width, single_m, bias_m):
    """Within 1 cm; 7 round trips and 2000 sessions leave 0.384 m / sqrt(14000) = 3.2 mm of noise."""
    ftm = FtmConfig(mode=mode_of(width), min_delta_us=100)
    air = FtmAir(distance_m=20.0, bandwidth_mhz=width, bias_m=bias_m, ftm=ftm)
    for i in range(2_000):
        air.request(4_000 * i)
    air.queue.run_until(8_010_000_000)
    errors_m = np.array([r.distance_m - 20.0 for r in air.results if r.status == "ok"])
    assert errors_m.size == 2_000
    assert errors_m.mean() == pytest.approx(bias_m, abs=0.01)
    # standard error of the deviation with 14000 round trips: 0.6 %
    assert sqrt(np.mean([r.distance_std_m**2 for r in air.results])) == pytest.approx(single_m, rel=0.03)


def blocked_errors_m(*, sessions=500, ways=BOTH_WAYS, **settings):
    ftm = FtmConfig(mode="ofdm24", round_trip_std_ps=0.0)
    air = FtmAir(distance_m=20.0, blocked_ways=ways, ftm=ftm, **settings)
    for i in range(sessions):
        air.request(4_000 * i)
    air.queue.run_until(4_000_000 * (sessions + 1))
    assert [r.status for r in air.results] == ["ok"] * sessions
    # one excess for a whole session
    assert max(r.distance_std_m for r in air.results) < 0.05
    return np.array([r.distance_m - r.true_distance_m for r in air.results])


def test_blocked_line_of_sight_only_ever_adds_range():
    """Exponential: its deviation is its mean, and a share of 1/e lies above it."""
    errors_m = blocked_errors_m(sessions=2_000)
    assert errors_m.min() > -0.01
    standard_error_m = 3.0 / sqrt(errors_m.size)
    assert errors_m.mean() == pytest.approx(3.0, abs=4 * standard_error_m)
    assert errors_m.std() == pytest.approx(3.0, rel=0.1)
    assert np.mean(errors_m > 3.0) == pytest.approx(np.exp(-1.0), abs=4 * sqrt(0.25 / errors_m.size))


def test_excess_lasts_as_long_as_the_obstacle_and_is_the_same_both_ways():
    both_m = blocked_errors_m()
    # each way has half of it: only the measurement frames blocked, only their ACKs
    for way in BOTH_WAYS:
        one_m = blocked_errors_m(ways=[way])
        assert one_m == pytest.approx(both_m / 2, abs=0.01)
    later_m = blocked_errors_m(blocked_from_ns=1_000_000_000)
    assert abs(later_m[:250]).max() < 0.01
    assert later_m[251:] == pytest.approx(both_m[251:], abs=0.01)


def test_80_mhz_scales_with_the_inverse_of_the_bandwidth():
    assert round_trip_std_ps(FtmConfig(), 80) == 1075.0 / 2
    assert round_trip_std_ps(FtmConfig(round_trip_std_ps=9.0), 80) == 9.0


@pytest.mark.parametrize(
    ("mode", "channel_mhz", "round_trip_m"),
    [
        # Zubow et al., WONS 2022: 2563 ps at 20 MHz and 1075 ps at 40 MHz; c/2 of them
        ("ofdm6", 20, 0.384), ("ofdm6", 40, 0.384), ("ofdm6", 80, 0.384), ("ofdm24", 80, 0.384),
        ("vht_mcs0", 20, 0.384), ("vht_mcs0", 40, 0.161), ("vht_mcs0", 80, 0.081), ("vht_mcs4", 80, 0.081),
    ],
)  # fmt: skip
def test_noise_of_ranging_is_that_of_the_format(mode, channel_mhz, round_trip_m):
    ftm = FtmConfig(mode=mode)
    assert distance_m(round_trip_std_ps(ftm, channel_mhz)) == pytest.approx(round_trip_m, abs=6e-4)
    assert round_trip_std_ps(FtmConfig(mode=mode, round_trip_std_ps=9.0), channel_mhz) == 9.0


def test_format_of_ranging_is_named():
    assert format_name(FtmConfig(mode="ofdm24"), 80) == "non-HT, 20 MHz"
    assert format_name(FtmConfig(mode="vht_mcs0"), 40) == "VHT, 40 MHz"


def test_noise_of_an_arrival_grows_as_the_signal_fades():
    # independent of the floor 1 / (2 pi B_rms sqrt(2 SNR B T)): at 10 dB and 20 MHz 5.77 MHz rms, 128 samples
    bound_ps = 1e12 / (2 * np.pi * 20e6 / sqrt(12) * sqrt(2 * 10 * 128))
    assert arrival_std_ps(0.0, 20, 10.0) == pytest.approx(bound_ps)
    assert arrival_std_ps(1000.0, 20, 10.0) == pytest.approx(sqrt(1000**2 + bound_ps**2))
    assert arrival_std_ps(0.0, 20, 1000.0) == pytest.approx(bound_ps / 10)
    # 30 dB at 5.2 GHz and 20 MHz: some 0.03 ppm
    assert frequency_ratio_std(5.2e9, 20, 1000.0) == pytest.approx(3.3e-8, rel=0.05)


def test_stamps_wrap_and_round_trips_do_not():
    clock = Clock(20.0, np.random.default_rng(4))
    earlier_ps = 0
    while clock.stamp_ps(earlier_ps + 10**12) > clock.stamp_ps(earlier_ps):
        earlier_ps += 10**12
    assert earlier_ps < FIELD_PS
    stamps_ps = clock.stamp_ps(earlier_ps), clock.stamp_ps(earlier_ps + 10**12)
    second_m = distance_m(10**12 * clock.rate)
    assert measured_m(stamps_ps[0], 0, 0, stamps_ps[1], 1.0) == pytest.approx(second_m, abs=2e-4)
    assert measured_m(0, *stamps_ps, 0, 2.0) == pytest.approx(-2 * second_m, abs=4e-4)
    assert measured_m(5, 0, 0, 3, 1.0) == distance_m(-2.0)
    assert distance_m(1.0) == pytest.approx(1.5e-4, rel=1e-3)


def test_a_moving_peer_is_ranged_where_it_is():
    swarm = Swarm(TWENTY_METRES, rician_k_db=None, ftm=FtmConfig(round_trip_std_ps=0.0))
    for i in range(100):
        # 20 m/s; every fifth of these steps of 4 ms a request, some sessions across two steps
        if i % 5 == 0:
            swarm.request(0, 1, 4_000 * i + 200 * (i // 5))
        swarm.places = swarm.places + np.array([[0.0, 0.0, 0.0], [0.08, 0.0, 0.0]])
        swarm.run(4_000 * (i + 1))
    records = swarm.emulator.take_sessions()
    assert len(records) == 20
    assert records[-1].true_distance_m > 27.0
    assert all(r.distance_m == pytest.approx(r.true_distance_m, abs=0.01) for r in records)


def test_lost_frames_cost_their_round_trips():
    # 8 dB on average, with strong fading that changes within a session: many frames are lost, and with them
    # round trips
    swarm = Swarm(
        [(0.0, 0.0, 0.0), (300.0, 0.0, 0.0)], rician_k_db=0.0, fading_doppler_hz=1_000.0, retry_limit=1
    )
    for i in range(60):
        swarm.request(0, 1, 50_000 * i)
    swarm.run(3_200_000)
    records = swarm.emulator.take_sessions()
    assert len(records) == 60
    round_trips = {r.round_trips for r in records if r.status == "ok"}
    assert 7 in round_trips
    assert min(round_trips) < 7
    attempts = swarm.emulator.counters.frames_sent
    assert attempts["ftm"] > attempts["ack"] / 2


def test_burst_ends_with_its_duration():
    # 10 frames 1 ms apart do not fit into 4 ms
    ftm = FtmConfig(ftms_per_burst=10, min_delta_us=1_000, burst_duration_us=4_000)
    swarm = Swarm(TWENTY_METRES, rician_k_db=None, ftm=ftm)
    swarm.request(0, 1, 1_000)
    swarm.run(30_000)
    ((_, result),) = results(swarm)
    assert result.status == "ok"
    assert 2 <= result.round_trips <= 4
    assert swarm.emulator.next_event_us > 10**15


@pytest.mark.parametrize("peer", [0, 2, 65_535])
def test_invalid_peer_is_rejected_at_once(peer):
    swarm = Swarm(TWENTY_METRES)
    seq = swarm.request(0, peer, 1_000)
    swarm.run(4_000)
    assert [(station, item.status, item.seq, item.peer) for station, item in results(swarm)] == [
        (0, "rejected", seq, peer)
    ]


def test_second_request_to_the_same_peer_is_rejected_and_the_first_continues():
    swarm = Swarm(TWENTY_METRES)
    swarm.request(0, 1, 1_000)
    swarm.request(0, 1, 1_200)
    swarm.run(20_000)
    assert [(item.seq, item.status) for _, item in results(swarm)] == [(2, "rejected"), (1, "ok")]


def test_responder_limits_its_sessions():
    places = [(0.0, 10.0 * i, 0.0) for i in range(5)]
    swarm = Swarm(places, ftm=FtmConfig(responder_sessions=2))
    for initiator in range(1, 5):
        swarm.request(initiator, 0, 1_000)
    swarm.run(60_000)
    assert sorted(item.status for _, item in results(swarm)) == ["ok", "ok", "rejected", "rejected"]


def test_both_directions_at_once():
    swarm = Swarm(TWENTY_METRES)
    swarm.request(0, 1, 1_000)
    swarm.request(1, 0, 1_000)
    swarm.run(40_000)
    assert sorted((station, item.status) for station, item in results(swarm)) == [(0, "ok"), (1, "ok")]


def test_a_silent_peer_does_not_respond():
    swarm = Swarm(TWENTY_METRES)
    swarm.emulator.set_silent(1)
    swarm.request(0, 1, 1_000)
    swarm.run(120_000)
    ((_, result),) = results(swarm)
    assert result.status == "no_response"
    assert result.distance_m == 0.0
    # the first and as many repetitions as `RadioConfig.retry_limit`
    assert swarm.emulator.counters.frames_sent["ftm_request"] == 7


def test_peer_silenced_during_a_burst_leaves_the_completed_round_trips():
    swarm = Swarm(TWENTY_METRES, ftm=FtmConfig(min_delta_us=2_000))
    swarm.request(0, 1, 1_000)
    swarm.run(8_000)
    swarm.emulator.set_silent(1)
    swarm.run(120_000)
    ((_, result),) = results(swarm)
    assert result.status == "ok"
    assert 1 <= result.round_trips <= 3


def test_request_stuck_in_the_queue_is_dropped_at_its_time_out():
    # sixty datagrams of 2 ms each are ahead of it
    swarm = Swarm(
        TWENTY_METRES, broadcast_mode="ofdm6", bandwidth_mhz=20, ftm=FtmConfig(access_category="be")
    )
    for _ in range(60):
        swarm.broadcast(0, 1_000, b"x" * 1400)
    swarm.request(0, 1, 1_000)
    swarm.run(300_000)
    ((_, result),) = results(swarm)
    assert result.status == "dropped"
    assert result.measured_ns == 101_000_000
    assert swarm.emulator.counters.frames_sent["ftm_request"] == 0


def test_no_measurement_frame_goes_out_after_its_burst():
    places = [(8.5 * (i % 4), 2.5 * (i // 4), -10.0) for i in range(8)]
    burst_us = 2_000  # a lone session takes 1.5 ms, so these leave many frames behind
    swarm = Swarm(places, ftm=FtmConfig(burst_duration_us=burst_us))
    for round_us in range(0, 200_000, 20_000):
        for station in range(8):
            swarm.request(station, (station + 1 + round_us // 20_000 % 7) % 8, round_us + 500 * station)
    swarm.run(300_000)
    begun_ns, waits_ns = {}, []
    for frame in swarm.emulator.take_frames():
        if frame.kind == "ftm_request" and frame.delivered:
            begun_ns[frame.destination, frame.source] = frame.end_ns
        elif frame.kind == "ftm":
            waits_ns.append(frame.start_ns - begun_ns[frame.source, frame.destination])
    assert 100 < len(waits_ns) < 80 * 8  # some were left out
    # the burst counts from the request's end at the responder; the medium once won, SIFS and preamble pass
    assert max(waits_ns) <= 1_000 * (burst_us + 1)
