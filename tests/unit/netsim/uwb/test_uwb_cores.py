"""Air times, time stamps, estimators and packet errors of the ranging radios."""

import math

import numpy as np
import pytest
import uwb_decoder
from msgspec.structs import replace

from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S
from netsim.uwb import frames
from netsim.uwb.access import Access, check_stations
from netsim.uwb.clock import DEPARTURE_TICKS, FIELD_TICKS, TICK_PS, UwbClock, elapsed_ticks, stamp
from netsim.uwb.config import UwbConfig
from netsim.uwb.reception import arrival_std_ps, error_rates, packet_error_probability
from netsim.uwb.time_of_flight import clock_error_m, distance_std_m, double_sided_ticks, single_sided_ticks

DEFAULT = UwbConfig()


def clock(ppm=0.0, seed=1, drift_ppm_s=0.0):
    return UwbClock(ppm, drift_ppm_s, np.random.default_rng(seed))


def test_air_times_are_those_of_the_data_sheet():
    # DW1000 data sheet: typical profile, 12 bytes at 6.8 Mbit/s, 128 symbols, 16 MHz: 175 us
    assert frames.duration_us(replace(DEFAULT, prf_mhz=16), 12) == pytest.approx(175.0, abs=0.5)
    # DW1000 user manual, symbol durations in ns
    assert frames.preamble_symbol_us(16) * 1e3 == pytest.approx(993.59, abs=0.01)
    assert frames.preamble_symbol_us(64) * 1e3 == pytest.approx(1017.63, abs=0.01)
    assert frames.data_symbol_us(850) * 1e3 == pytest.approx(1025.64, abs=0.01)
    assert frames.data_symbol_us(6810) * 1e3 == pytest.approx(128.21, abs=0.01)
    # 1 / 6.81 Mbit/s is the data symbol with the parity of full blocks
    assert frames.data_symbol_us(6810) * 378 / 330 == pytest.approx(1.0 / 6.81, rel=1e-3)


@pytest.mark.parametrize(("payload_bytes", "blocks"), [(0, 0), (1, 1), (41, 1), (42, 2), (127, 4)])
def test_each_block_of_330_bits_has_48_parity_bits(payload_bytes, blocks):
    assert frames.coded_bits(payload_bytes) == 8 * payload_bytes + 48 * blocks


def test_an_exchange_lasts_from_the_first_preamble_to_the_end_of_the_last_frame():
    config = replace(DEFAULT, method="ss", reply_time_us=500)
    first_us, last_us = frames.to_marker_us(config), frames.after_marker_us(config, 20)
    assert frames.exchange_us(config) == pytest.approx(first_us + 500 + last_us)
    three_us = 3 * 500 + first_us + frames.after_marker_us(config, 16)
    assert frames.exchange_us(replace(config, method="ds")) == pytest.approx(three_us)
    assert frames.airtime_us(config) == pytest.approx(
        frames.duration_us(config, 12) + frames.duration_us(config, 20)
    )


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"reply_time_us": 150}, "reply_time_us"),
        ({"preamble_symbols": 1024}, "reply_time_us"),
        ({"slot_us": 2_000}, "slot_us"),
    ],
)
def test_times_in_which_frames_do_not_fit_are_rejected(changes, field):
    frames.check(DEFAULT)
    with pytest.raises(ValueError, match=f"^{field}: "):
        frames.check(replace(DEFAULT, **changes))


def test_slots_must_return_before_a_request_times_out():
    check_stations(DEFAULT, 64)
    with pytest.raises(ValueError, match=r"^request_timeout_us: "):
        check_stations(replace(DEFAULT, request_timeout_us=20_000), 10)
    check_stations(replace(DEFAULT, request_timeout_us=20_000, access="aloha"), 10)


def test_slots_of_stations_do_not_overlap():
    config = replace(DEFAULT, slot_guard_us=50)
    access = Access(config, draws=[None] * 5, slot_errors_us=[0.0] * 5)
    times_us = range(0, 100_000, 137)
    begins_ns = sorted({access.begin_ns(station, 1_000 * now) for station in range(5) for now in times_us})
    assert min(np.diff(begins_ns)) >= 1e3 * (frames.exchange_us(config) + config.slot_guard_us)
    for station in range(5):
        for now_us in times_us:
            wait_ns = access.begin_ns(station, 1_000 * now_us) - 1_000 * now_us
            assert 0 <= wait_ns <= 5e3 * frames.slot_us(config) + 5


# --- clocks


def test_a_tick_is_15_65_ps_and_stamps_wrap_after_17_2_s():
    assert pytest.approx(15.65, abs=0.001) == TICK_PS
    assert pytest.approx(17.2, abs=0.01) == FIELD_TICKS * TICK_PS * 1e-12
    own = clock(ppm=10.0)
    begin = stamp(own, 17_000_000_000_000)
    for elapsed_s in (0.001, 1.0, 8.0):
        end_ps = 17_000_000_000_000 + round(elapsed_s * 1e12)
        assert elapsed_ticks(begin, stamp(own, end_ps)) * TICK_PS == pytest.approx(
            elapsed_s * 1e12 * own.rate(0), abs=2 * TICK_PS
        )
    assert elapsed_ticks(0, FIELD_TICKS - 1) == -1


def test_a_clock_gains_its_rate_and_the_rate_its_drift():
    own = clock(ppm=20.0, drift_ppm_s=0.01, seed=5)
    step_ps = 10**9
    for at_ps in (0, 7 * 10**12, 31 * 10**12, 3_600 * 10**12):
        gained_ps = own.reading_ps(at_ps + step_ps) - own.reading_ps(at_ps)
        assert gained_ps == pytest.approx(step_ps * own.rate(at_ps), abs=2.0)
    rates = [own.rate(second * 10**12) for second in range(600)]
    assert 0 < max(np.abs(np.diff(rates))) <= 0.01e-6
    assert max(abs(rate - 1.0) for rate in rates) <= 20.2e-6


def test_departures_are_multiples_of_512_ticks_and_not_late():
    own = clock(ppm=20.0, seed=3)
    for wanted_ps in range(10**12, 10**12 + 10**7, 1_234_567):
        departs_ps = own.departure_ps(wanted_ps)
        assert 0 <= wanted_ps - departs_ps <= 512 * TICK_PS + 1
        assert min(stamp(own, departs_ps) % DEPARTURE_TICKS, -stamp(own, departs_ps) % DEPARTURE_TICKS) <= 1


# --- estimators


def exchange_ticks(flight_s, reply_b_s, reply_a_s, rate_a, rate_b):
    """Return Ra, Db, Rb and Da without noise, in ticks of clocks with these rates."""
    per_s = 1e12 / TICK_PS
    return (
        (2 * flight_s + reply_b_s) * rate_a * per_s,
        reply_b_s * rate_b * per_s,
        (2 * flight_s + reply_a_s) * rate_b * per_s,
        reply_a_s * rate_a * per_s,
    )


@pytest.mark.parametrize(("ppm", "reply_us"), [(2, 100), (20, 100), (40, 100), (20, 5_000)])
def test_the_single_sided_error_is_half_the_reply_time_and_clock_error(ppm, reply_us):
    flight_s = 30.0 / SPEED_OF_LIGHT_M_S
    round_a, reply_b, _, _ = exchange_ticks(flight_s, 1e-6 * reply_us, 0.0, 1.0 + 1e-6 * ppm, 1.0)
    error_s = single_sided_ticks(round_a, reply_b) * TICK_PS * 1e-12 - flight_s
    # DW1000 user manual, appendix 3: 0.1 ns at 2 ppm and 100 us, 1 ns at 20 ppm, 2 ns at 40 ppm, 50 ns at 5
    # ms
    assert error_s * 1e9 == pytest.approx(0.5e-3 * ppm * reply_us, rel=0.03)
    assert clock_error_m(ppm, reply_us) == pytest.approx(SPEED_OF_LIGHT_M_S * error_s, rel=0.03)
    corrected = single_sided_ticks(round_a, reply_b, 1.0 + 1e-6 * ppm) * TICK_PS * 1e-12
    assert corrected == pytest.approx(flight_s, rel=1e-4)


@pytest.mark.parametrize("reply_a_us", [300, 650, 2_000])
def test_the_double_sided_error_does_not_depend_on_reply_times(reply_a_us):
    flight_s = 30.0 / SPEED_OF_LIGHT_M_S
    ticks = exchange_ticks(flight_s, 650e-6, 1e-6 * reply_a_us, 1.0 + 20e-6, 1.0 - 20e-6)
    # the clocks' errors change the time of flight by at most their share: 0.6 mm of 30 m
    assert double_sided_ticks(*ticks) * TICK_PS * 1e-12 == pytest.approx(flight_s, rel=21e-6, abs=1e-13)


@pytest.mark.parametrize(("method", "weights"), [("ss", (1, 1)), ("ds", (1, 2, 1))])
def test_the_stated_deviation_follows_from_the_arrivals(method, weights):
    # ss: arrivals of poll and response, each by 1/2; ds: poll and final by 1/4, the response by 2/4
    std_m = SPEED_OF_LIGHT_M_S * 130e-12 * math.hypot(*weights) / sum(weights)
    config = replace(DEFAULT, method=method, time_stamp_std_ps=130.0, carrier_offset_std_ppm=0.0)
    assert distance_std_m(config) == pytest.approx(std_m)
    uncorrected = replace(config, carrier_correction=False)
    assert (distance_std_m(uncorrected) > 0.5) == (method == "ss")


# --- reception


def test_the_sensitivity_is_that_of_the_data_sheet():
    # DWM1000 data sheet: -94 dBm/500 MHz at 6.8 Mbit/s for 10 % of frames with 20 bytes
    assert packet_error_probability(DEFAULT, 20, 10**-9.4) == pytest.approx(0.1, abs=0.05)
    assert packet_error_probability(DEFAULT, 20, 10**-9.3) < 0.005
    assert packet_error_probability(DEFAULT, 20, 10**-9.5) > 0.5
    assert packet_error_probability(DEFAULT, 20, 0.0) == 1.0


def test_slower_and_shorter_frames_have_fewer_errors():
    power_mw = 10**-9.4
    assert packet_error_probability(replace(DEFAULT, data_rate_kbps=850), 20, power_mw) < 1e-4
    assert packet_error_probability(DEFAULT, 12, power_mw) < packet_error_probability(DEFAULT, 24, power_mw)


@pytest.mark.parametrize(("energy_db", "blocks"), [(-2.0, 150), (0.0, 150), (2.0, 300), (4.0, 3_000)])
def test_error_rates_are_those_of_a_simulated_decoder(energy_db, blocks):
    energy_ratio = 10.0 ** (energy_db / 10.0)
    simulated = uwb_decoder.error_rates(energy_ratio, blocks=blocks, bits=330, seed=3)
    assert error_rates(energy_ratio) == pytest.approx(simulated, rel=0.1)


def test_time_stamps_are_noisier_at_low_power():
    assert arrival_std_ps(DEFAULT, 10**-6.0) == pytest.approx(130.0, rel=1e-3)
    bound_ps = math.sqrt(arrival_std_ps(replace(DEFAULT, time_stamp_std_ps=0.0), 10**-9.0) ** 2)
    assert arrival_std_ps(DEFAULT, 10**-9.0) == pytest.approx(math.hypot(130.0, bound_ps))
    quarter = replace(DEFAULT, time_stamp_std_ps=0.0, preamble_symbols=32)
    assert arrival_std_ps(quarter, 10**-9.0) == pytest.approx(2.0 * bound_ps)
