"""UWB ranging in the emulator: errors, access to the channel, failures, and the 802.11 channel beside it."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from netsim.lab.bench import RadioBench, ring_ned_m
from netsim.lab.uwb_ranging import uwb_range_mesh, uwb_range_pair
from netsim.model.config import RadioConfig
from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.propagation import Trajectories
from netsim.uwb.clock import UwbClock
from netsim.uwb.config import UwbConfig
from netsim.uwb.medium import Outcome, UwbMedium
from netsim.uwb.time_of_flight import clock_error_m, distance_std_m
from netsim.wire.messages import Broadcast, FtmRequest, FtmResult

RADIO = RadioConfig(rician_k_db=None, host_latency_us=0, host_jitter_us=0)
PLAIN = UwbConfig(antenna_delay_std_ps=0.0)
PAIR_NED_M = [(0.0, 0.0, -10.0), (20.0, 0.0, -10.0)]


def run(requests, *, uwb=PLAIN, radio=RADIO, places_ned_m=PAIR_NED_M, seed=1, seconds=1.0, step_s=None):
    """Simulate requests (station, peer, time in us); return the bench and the results by request."""
    bench = RadioBench(radio, places_ned_m, seed, uwb)
    for seq, (station, peer, at_us) in enumerate(requests):
        bench.submit(station, FtmRequest(seq=seq, at_us=at_us, peer=peer))
    items = []
    for end_s in np.arange(step_s or seconds, seconds + 1e-9, step_s or seconds):
        items += bench.run(round(1e6 * end_s))
    return bench, {item.seq: item for _, item in items if isinstance(item, FtmResult)}


# --- errors


@pytest.mark.parametrize("method", ["ss", "ds"])
def test_the_error_is_that_of_the_time_stamps(method):
    config = replace(PLAIN, method=method)
    found = uwb_range_pair(distance_m=20.0, exchanges=600, uwb=config)
    standard_error_m = distance_std_m(config) / math.sqrt(600)
    assert found.completed == 600
    assert found.error_mean_m == pytest.approx(0.0, abs=4 * standard_error_m)
    assert found.error_std_m == pytest.approx(distance_std_m(config), rel=0.1)


@pytest.mark.parametrize("reply_time_us", [300, 650, 2_000])
def test_an_uncorrected_single_sided_distance_has_the_clocks_error(reply_time_us):
    config = replace(
        PLAIN, method="ss", carrier_correction=False, reply_time_us=reply_time_us, clock_drift_ppm_s=0.0,
        time_stamp_std_ps=1.0,
    )  # fmt: skip
    streams = RandomStreams(np.random.SeedSequence([1]))
    rates = [UwbClock(config.clock_ppm, 0.0, streams.generator(Model.UWB, 0, i)).rate(0) for i in (0, 1)]
    bias_m = clock_error_m(1e6 * (rates[0] - rates[1]), reply_time_us)
    assert abs(bias_m) > 0.1
    found = uwb_range_pair(distance_m=20.0, exchanges=50, uwb=config)
    assert found.error_mean_m == pytest.approx(bias_m, abs=0.003)  # a tick is 4.7 mm
    double = uwb_range_pair(distance_m=20.0, exchanges=50, uwb=replace(config, method="ds"))
    assert double.error_mean_m == pytest.approx(0.0, abs=0.003)


def test_antenna_delays_are_constant_errors_of_the_radios():
    config = UwbConfig(antenna_delay_std_ps=1_000.0, time_stamp_std_ps=1.0)
    places_ned_m = ring_ned_m(3, 10.0)
    pairs = [(0, 1), (1, 0), (1, 2), (2, 1), (2, 0), (0, 2)]
    _, results = run(
        [(*pair, 50_000 * k) for k, pair in enumerate(pairs)], uwb=config, places_ned_m=places_ned_m
    )
    errors_m = [
        results[k].distance_m - math.dist(places_ned_m[a], places_ned_m[b]) for k, (a, b) in enumerate(pairs)
    ]
    # both directions have the same error, as it is a quarter of both radios' delays
    assert errors_m[::2] == pytest.approx(errors_m[1::2], abs=0.005)
    assert max(map(abs, errors_m)) > 0.02


@pytest.mark.parametrize("mean_m", [0.0, 2.0])
def test_a_blocked_path_adds_an_exponential_excess_and_attenuation(mean_m):
    radio = replace(RADIO, nlos_fraction=1.0, nlos_loss_db=2.0)
    config = replace(PLAIN, nlos_bias_mean_m=mean_m)
    count = 300
    _, results = run([(0, 1, 10_000 * k) for k in range(count)], uwb=config, radio=radio, seconds=4.0)
    errors_m = np.array([result.distance_m for result in results.values()]) - 20.0
    standard_error_m = math.hypot(mean_m, distance_std_m(config)) / math.sqrt(count)
    assert errors_m.mean() == pytest.approx(mean_m, abs=4 * standard_error_m)
    assert errors_m.std() == pytest.approx(math.hypot(mean_m, distance_std_m(config)), rel=0.2)
    _, clear = run([(0, 1, 0)], uwb=config)
    assert results[0].rssi_dbm == pytest.approx(clear[0].rssi_dbm - 2.0)


def test_the_received_power_is_the_eirp_less_free_space_loss():
    (result,) = run([(0, 1, 0)])[1].values()
    # -41.3 dBm/MHz over 499.2 MHz; Friis at 6489.6 MHz and 20 m
    loss_db = 20.0 * math.log10(4.0 * math.pi * 20.0 * 6489.6e6 / 299_792_458.0)
    assert result.rssi_dbm == pytest.approx(-41.3 + 10.0 * math.log10(499.2) - loss_db, abs=0.01)


# --- access


def test_slots_have_no_collisions():
    found = uwb_range_mesh(stations=8, period_s=0.16, seconds=1.6, uwb=UwbConfig(access="slots"))
    assert found.completed_fraction == 1.0
    assert found.collided_fraction == 0.0
    assert found.exchanges_per_request == 1.0


class EqualLinks:
    """Links on which every station receives every other one with the same power."""

    def clear_powers_mw(self, _source, _at_ns):
        return np.full(STATIONS, 1e-6)

    def is_blocked(self, _a, _b, _at_ns):
        return False


STATIONS = 40


@pytest.mark.parametrize("load", [0.1, 0.3, 0.8])
def test_frames_at_random_times_succeed_as_in_pure_aloha(load):
    """A frame of the duration T is received if none begins within T before or after it: exp(-2 G)."""
    rng = np.random.default_rng(6)
    duration_ns, count = 180_000, 6_000
    begins_ns = np.cumsum(rng.exponential(duration_ns / load, count)).astype(int)
    draws = [RandomStreams(np.random.SeedSequence(2)).uniforms(Model.UWB, 3, i) for i in range(STATIONS)]
    medium = UwbMedium(replace(PLAIN, capture_db=3.0), EqualLinks(), Trajectories(STATIONS), draws)
    pending, received = [], 0
    for k, begin_ns in enumerate([*begins_ns.tolist(), 2**62]):
        while pending and pending[0].end_ns <= begin_ns:
            received += medium.outcome(pending.pop(0), 0) is Outcome.RECEIVED
        if k < count:
            pending.append(medium.send(1 + k % (STATIONS - 1), begin_ns, begin_ns + duration_ns, 12))
    expected = math.exp(-2.0 * load)
    # neighbours are lost together, which doubles the variance at most
    standard_error = math.sqrt(2.0 * expected * (1.0 - expected) / count)
    assert received / count == pytest.approx(expected, abs=3 * standard_error)


def test_a_stronger_frame_is_captured():
    """Stations 0 and 2 send at once to 1, which is ten times nearer to 0: 20 dB."""
    places_ned_m = [(0.0, 0.0, -10.0), (2.0, 0.0, -10.0), (22.0, 0.0, -10.0), (22.0, 2.0, -10.0)]
    config = UwbConfig(access="aloha", aloha_delay_us=0, retry_limit=0)
    _, results = run([(0, 1, 0), (2, 3, 0)], uwb=config, places_ned_m=places_ned_m)
    assert [results[k].status for k in (0, 1)] == ["ok", "ok"]
    _, results = run([(0, 1, 0), (2, 3, 0)], uwb=replace(config, capture_db=30.0), places_ned_m=places_ned_m)
    assert [results[k].status for k in (0, 1)] == ["no_response", "no_response"]


def test_a_radio_takes_part_in_one_exchange_at_a_time():
    config = UwbConfig(access="aloha", aloha_delay_us=0, retry_limit=0)
    places_ned_m = ring_ned_m(3, 5.0)
    bench, results = run([(0, 1, 0), (2, 1, 1_000)], uwb=config, places_ned_m=places_ned_m)
    assert [results[0].status, results[1].status] == ["ok", "no_response"]
    assert bench.emulator.counters.uwb.outcomes["missed"] == 1
    # repeated, it succeeds
    _, results = run(
        [(0, 1, 0), (2, 1, 1_000)], uwb=replace(config, retry_limit=3), places_ned_m=places_ned_m
    )
    assert [results[0].status, results[1].status] == ["ok", "ok"]


# --- requests that fail


def test_requests_out_of_range_end_without_response():
    _, results = run([(0, 1, 0)], places_ned_m=[(0.0, 0.0, -10.0), (500.0, 0.0, -10.0)])
    assert results[0].status == "no_response"
    assert results[0].round_trips == 0


def test_impossible_requests_are_rejected_and_late_ones_dropped():
    config = replace(PLAIN, request_timeout_us=7_000)
    requests = [(0, 0, 0), (0, 9, 0), (0, 1, 0), (0, 1, 0)]
    _, results = run(requests, uwb=config)
    assert [results[k].status for k in range(4)] == ["rejected", "rejected", "ok", "rejected"]
    places_ned_m = ring_ned_m(4, 5.0)
    queue = [(0, peer, 0) for peer in (1, 2, 3)]
    aloha = replace(config, request_timeout_us=6_000, access="aloha", aloha_delay_us=0)
    _, results = run(queue, uwb=aloha, places_ned_m=places_ned_m)
    assert [results[k].status for k in range(3)] == ["ok", "ok", "dropped"]


def test_a_radio_that_is_off_neither_asks_nor_responds():
    bench = RadioBench(RADIO, PAIR_NED_M, 1, PLAIN)
    bench.emulator.set_silent(1)
    for station in (0, 1):
        bench.submit(station, FtmRequest(seq=1, at_us=0, peer=1 - station))
    (found,) = [item for _, item in bench.run(1_000_000) if isinstance(item, FtmResult)]
    assert (found.peer, found.status) == (1, "no_response")


# --- beside the 802.11 channel


def test_results_do_not_depend_on_the_length_of_intervals():
    requests = [(k % 3, (k + 1) % 3, 3_000 * k) for k in range(60)]
    places_ned_m = ring_ned_m(3, 8.0)
    whole = run(requests, places_ned_m=places_ned_m, seconds=0.4)[1]
    pieces = run(requests, places_ned_m=places_ned_m, seconds=0.4, step_s=0.004)[1]
    assert len(whole) == 60
    assert whole == pieces
    assert whole != run(requests, places_ned_m=places_ned_m, seconds=0.4, seed=2)[1]


@pytest.mark.parametrize("channel", ["emulated", "ideal"])
def test_uwb_uses_no_802_11_air_time(channel):
    """Datagrams arrive as without UWB, whose frames are not on the 802.11 channel."""
    radio = replace(RADIO, channel=channel)

    def deliveries(uwb):
        bench = RadioBench(radio, PAIR_NED_M, 1, uwb)
        for k in range(40):
            bench.submit(0, Broadcast(seq=2 * k, at_us=1_000 * k, payload=bytes(300)))
            if uwb is not None:
                bench.submit(1, FtmRequest(seq=2 * k + 1, at_us=1_000 * k, peer=0))
        items = bench.run(200_000)
        return [item for _, item in items if type(item).__name__ == "Delivery"], bench.emulator

    alone, without = deliveries(None)
    beside, with_uwb = deliveries(PLAIN)
    assert alone == beside
    assert without.counters.frames_sent == with_uwb.counters.frames_sent
    assert without.busy_ns == with_uwb.busy_ns
    assert without.counters.uwb is None
    assert with_uwb.counters.ftm.completed + sum(with_uwb.counters.ftm.failed.values()) == 40
