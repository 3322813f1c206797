"""Timelines by band and coverage class, in microseconds: time-outs, interframe spaces, slots.

Expected times follow from IEEE 802.11-2016: tables 17-21 and 18-5, 9.4.2.9, 10.3.2.3, 10.3.2.9, 10.3.7 and
10.3.8. 100 bytes at 6 Mbit/s last 160 us and their ACK 44 us; RTS and CTS at 24 Mbit/s last 28 us; at 2.4 GHz
each frame lasts 6 us more. A second.
"""

from itertools import pairwise

import numpy as np
import pytest
from netsim_air import UNDETECTED_DBM, A, Air, B, C
from netsim_swarm import Swarm

from netsim.emulator.settings_checks import check
from netsim.mac.access_parameters import EDCA
from netsim.mac.jobs import JobOutcome
from netsim.mac.rates import datagram_modes
from netsim.model.config import FtmConfig, RadioConfig, StationConfig
from netsim.model.random_streams import RandomStreams
from netsim.phy.frames import GROUP
from netsim.phy.timing import timing_of
from netsim.wire.messages import Sent, Unicast

LONG = {"frequency_mhz": 2437.0}
SHORT = {"frequency_mhz": 2437.0, "short_slot": True}
AT_2_4_GHZ = {
    **LONG,
    "bandwidth_mhz": 20,
    "ftm": FtmConfig(mode="ofdm6"),
    "rician_k_db": None,
    "tx_power_dbm": 45.0,
}
TIMINGS = pytest.mark.parametrize(
    ("settings", "slot_us", "sifs_us", "extension_us"),
    [
        ({}, 9, 16, 0),
        ({"coverage_class": 3}, 9 + 3 * 3, 16, 0),
        ({"coverage_class": 31}, 9 + 31 * 3, 16, 0),
        (SHORT, 9, 10, 6),
        (LONG, 20, 10, 6),
        ({**LONG, "coverage_class": 2}, 20 + 2 * 3, 10, 6),
    ],
    ids=["5 GHz", "class 3", "class 31", "2.4 GHz short", "2.4 GHz long", "2.4 GHz long, class 2"],
)
RX_START_US = 20


@TIMINGS
def test_acknowledgement_follows_after_sifs(settings, slot_us, sifs_us, extension_us):
    air = Air(2, **settings)
    air.send(1000, A, B)
    end_us = 1160 + extension_us
    ack_us = end_us + sifs_us
    assert air.run() == [(1000, end_us, A, "data"), (ack_us, ack_us + 44 + extension_us, B, "ack")]
    assert ack_us == 1160 + 16  # after the last symbol, in either band and with any slot
    assert timing_of(air.config).slot_ns == 1_000 * slot_us
    # the Duration field reaches to the end of the ACK
    assert air.transmissions[0].frame.nav_ns == 1_000 * (sifs_us + 44 + extension_us)
    assert air.outcomes == [JobOutcome.ACKNOWLEDGED]


@TIMINGS
def test_unanswered_frame_is_repeated_after_time_out_difs_and_backoff(
    settings, slot_us, sifs_us, extension_us
):
    windows = [31, 63, 127]
    air = Air(2, powers_dbm={(A, B): UNDETECTED_DBM}, backoffs={A: [(w, w) for w in windows]}, **settings)
    air.send(1000, A, B, retry_limit=2)
    gaps_us = [later - earlier for earlier, later in pairwise(start for start, *_ in air.run())]
    failed_us = 160 + extension_us + sifs_us + slot_us + RX_START_US
    difs_us = sifs_us + 2 * slot_us
    assert gaps_us == [failed_us + difs_us + w * slot_us for w in windows[:2]]


@pytest.mark.parametrize(
    ("settings", "slot_us"),
    [({}, 9), ({"coverage_class": 1}, 12), ({"coverage_class": 7}, 30), (SHORT, 9), (LONG, 20)],
)
@pytest.mark.parametrize("rts", [False, True], ids=["ack", "cts"])
def test_response_counts_if_its_reception_begins_within_the_time_out(settings, slot_us, rts):
    """PHY-RXSTART comes SIFS, both ways and 20 us after the end: both ways may take a slot."""
    limit_ns = 1_000 * slot_us // 2
    for delay_ns, kinds, outcome in (
        (limit_ns, ["rts", "cts", "data", "ack"] if rts else ["data", "ack"], JobOutcome.ACKNOWLEDGED),
        (limit_ns + 1, ["rts", "cts"] if rts else ["data", "ack"], JobOutcome.RETRY_LIMIT),
    ):
        air = Air(2, delays_ns={(A, B): delay_ns, (B, A): delay_ns}, **settings)
        air.send(1000, A, B, rts=rts, retry_limit=0)
        air.queue.run_until(5_000_000)
        assert [t.frame.kind.value for t in air.transmissions] == kinds
        assert air.outcomes == [outcome]


@pytest.mark.parametrize(("begins_us", "failed_us"), [(1185, 1185 + 160), (1186, 1205)])
def test_time_out_waits_for_the_end_of_a_frame_whose_reception_has_begun(begins_us, failed_us):
    #  1000   1160  1185           1205          1345     no response to A; A is locked on to C's frame at
    #  A data |     C data ...     | time-out    |        its time-out
    air = Air(3, powers_dbm=dict.fromkeys([(A, B), (A, C)], UNDETECTED_DBM))
    air.send(1000, A, B, retry_limit=0)
    air.send(begins_us, C)
    air.run(failed_us - 1)
    assert JobOutcome.RETRY_LIMIT not in air.outcomes
    air.run(failed_us)
    assert JobOutcome.RETRY_LIMIT in air.outcomes


def boundary_us(arrives_us, aifs_us, slot_us):
    """Return the first slot boundary of EDCA from ``arrives_us`` on, of a medium that is idle since 0."""
    return arrives_us + (aifs_us - arrives_us) % slot_us


@TIMINGS
def test_dcf_backs_off_in_slots_after_difs(settings, slot_us, sifs_us, extension_us):
    air = Air(2, backoffs={B: [(3, 15)]}, **settings)
    air.send(1000, A)
    air.send(1100, B)
    assert air.run()[1][0] == 1160 + extension_us + sifs_us + 2 * slot_us + 3 * slot_us


@TIMINGS
@pytest.mark.parametrize(("category", "aifsn", "window"), [("vo", 2, 3), ("be", 3, 15), ("bk", 7, 15)])
def test_edca_backs_off_in_slots_after_aifs(
    settings, slot_us, sifs_us, extension_us, category, aifsn, window
):
    air = Air(2, access="edca", backoffs={B: [(2, window)]}, **settings)
    assert EDCA[category].aifs_ns(timing_of(air.config)) == 1_000 * (sifs_us + aifsn * slot_us)
    air.send(1000, A)
    air.send(1100, B, category=category)
    first, second = air.run()
    assert first[0] == boundary_us(1000, sifs_us + 3 * slot_us, slot_us)
    assert second[0] == first[0] + 160 + extension_us + sifs_us + (aifsn + 2) * slot_us


@TIMINGS
def test_eifs_is_sifs_and_an_ack_longer_than_difs(settings, slot_us, sifs_us, extension_us):
    # 136 bytes at 24 Mbit/s twice: C locks on to A's, and B breaks it
    powers_dbm = {(A, C): -50.0, (B, C): -56.0}
    air = Air(3, powers_dbm=powers_dbm, backoffs={C: [(1, 15)]}, **settings)
    air.send(1000, A, mode="ofdm24", frame_bytes=400)
    air.send(1000, B, mode="ofdm24", frame_bytes=400)
    air.send(1050, C)
    end_us = 1000 + 20 + 4 * 34 + extension_us
    eifs_us = sifs_us + 44 + extension_us + sifs_us + 2 * slot_us
    assert air.run()[2][0] == end_us + eifs_us + slot_us


@TIMINGS
def test_rts_and_cts_reserve_the_medium(settings, slot_us, sifs_us, extension_us):
    air = Air(3, backoffs={C: [(0, 15)]}, **settings)
    air.send(1000, A, B, rts=True)
    air.send(1035, C)
    timeline, at_us = [], 1000
    for source, kind, duration_us in ((A, "rts", 28), (B, "cts", 28), (A, "data", 160), (B, "ack", 44)):
        timeline.append((at_us, at_us + duration_us + extension_us, source, kind))
        at_us += duration_us + extension_us + sifs_us
    ack_end_us = timeline[-1][1]
    access_us = ack_end_us + sifs_us + 2 * slot_us
    assert air.run() == [*timeline, (access_us, access_us + 160 + extension_us, C, "data")]
    ends_us = [t.end_ns // 1_000 + t.frame.nav_ns // 1_000 for t in air.transmissions[:4]]
    assert ends_us == [ack_end_us] * 4


@TIMINGS
def test_unused_reservation_is_dropped(settings, slot_us, sifs_us, extension_us):
    # NAVTimeout of 10.3.2.4: 2 SIFS, CTS, 20 us, 2 slots
    air = Air(3, powers_dbm={(A, B): UNDETECTED_DBM}, backoffs={C: [(0, 15)]}, **settings)
    air.send(1000, A, B, rts=True, frame_bytes=1000, retry_limit=0)
    air.send(1035, C)
    rts_end_us = 1028 + extension_us
    dropped_us = rts_end_us + 2 * sifs_us + 28 + extension_us + RX_START_US + 2 * slot_us
    assert air.run()[1][0] == dropped_us + sifs_us + 2 * slot_us


@pytest.mark.parametrize(("settings", "fit"), [({}, 6), (SHORT, 6), (LONG, 6)])
def test_txop_counts_signal_extensions(settings, fit):
    # k exchanges take 220 k + 16 (k - 1) us in either band, and 6 us more at 2.4 GHz: the last extension
    air = Air(2, access="edca", backoffs={A: [(0, 3)]}, **settings)
    for _ in range(10):
        air.send(1000, A, B, category="vo")
    starts_us = [start for start, _, source, _ in air.run() if source == A]
    timing = timing_of(air.config)
    extension_us, difs_us = timing.signal_extension_ns // 1_000, EDCA["vo"].aifs_ns(timing) // 1_000
    first_us = boundary_us(1000, difs_us, timing.slot_ns // 1_000)
    assert starts_us[:fit] == [first_us + 236 * k for k in range(fit)]
    assert starts_us[fit] == starts_us[fit - 1] + 220 + extension_us + difs_us


# --- signal extension


def test_no_power_is_on_the_air_during_a_signal_extension():
    # A and C are hidden from each other; at B C's frame begins in the last symbol of A's, or after it
    hidden = dict.fromkeys([(A, C), (C, A)], UNDETECTED_DBM)
    for begins_us, delivered in ((1158, []), (1160, [B])):
        air = Air(3, powers_dbm=hidden, **LONG)
        air.send(1000, A)
        air.send(begins_us, C)
        air.run()
        assert air.transmissions[0].delivered == delivered
    air = Air(2, **LONG)
    air.send(1000, A)
    air.queue.run_until(2_000_000)
    assert air.radios.busy_ns() == 160_000


@pytest.mark.parametrize(("arrives_us", "slots"), [(1165, 3), (1167, 0)])
def test_medium_is_busy_until_the_end_of_a_signal_extension(arrives_us, slots):
    # 1166; a frame that finds the medium busy backs off, a later one waits for the rest of DIFS
    air = Air(2, backoffs={B: [(3, 15)]}, **LONG)
    air.send(1000, A)
    air.send(arrives_us, B)
    assert air.run()[1][0] == 1166 + 10 + 2 * 20 + slots * 20


def test_energy_alone_has_no_signal_extension():
    # C senses A's frame, below the threshold of preambles, by its power alone
    air = Air(3, powers_dbm={(A, C): -84.0}, backoffs={C: [(3, 15)]}, cca_energy_dbm=-90.0, **LONG)
    air.send(1000, A)
    air.send(1100, C)
    assert air.run()[1][0] == 1160 + 10 + 2 * 20 + 3 * 20


def test_survey_counts_a_signal_extension_as_busy():
    air = Air(2, **LONG)
    air.send(1000, A)
    air.queue.run_until(2_000_000)
    assert air.radios.surveyed_ns() == [166_000, 166_000]


# --- distances, through the whole emulator


def outcome_at(distance_m, channel, **settings):
    """The outcome of a datagram to one station that is not repeated."""
    swarm = Swarm(
        [(0.0, 0.0, -10.0), (distance_m, 0.0, -10.0)],
        **{"tx_power_dbm": 45.0, "rician_k_db": None, "retry_limit": 0, "channel": channel, **settings},
    )
    swarm.submit(0, Unicast(seq=1, at_us=0, destination=1, payload=b"x" * 100))
    (status,) = [item.status for _, item in swarm.run(40_000) if isinstance(item, Sent)]
    return status


@pytest.mark.parametrize("channel", ["emulated", "ideal"])
@pytest.mark.parametrize(
    ("settings", "farthest_m"),
    # half a slot at the speed of light: 149.896 m for each microsecond of the slot
    [({}, 1349.1), ({"coverage_class": 1}, 1798.8), ({"coverage_class": 5}, 3597.5), (SHORT, 1349.1)],
)
def test_distance_of_acknowledged_frames(channel, settings, farthest_m):
    settings = {**AT_2_4_GHZ, **settings} if settings is SHORT else settings
    assert outcome_at(farthest_m - 9.0, channel, **settings) == "acknowledged"
    assert outcome_at(farthest_m + 11.0, channel, **settings) == "retry_limit"


@pytest.mark.parametrize(("settings", "farthest_m"), [({}, 4796.7), (AT_2_4_GHZ, 2997.9)])
def test_no_frame_arrives_beyond_a_delay_of_sifs(settings, farthest_m):
    for distance_m, arrives in ((farthest_m - 5.0, True), (farthest_m + 5.0, False)):
        swarm = Swarm(
            [(0.0, 0.0, -10.0), (distance_m, 0.0, -10.0)],
            **{"tx_power_dbm": 45.0, "rician_k_db": None, **settings},
        )
        swarm.broadcast(0, 1_000, b"x" * 10)
        assert bool(swarm.run(8_000)) is arrives


# --- settings


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"bandwidth_mhz": 80}, "bandwidth_mhz: a channel at 2.4 GHz has 20 or 40 MHz, not 80"),
        (
            {"frequency_mhz": 2440.0},
            "frequency_mhz: 2440 MHz is not the centre of a channel of 20 MHz at 2.4",
        ),
        ({"frequency_mhz": 2484.0, "bandwidth_mhz": 40}, "not the centre of a channel of 40 MHz"),
        (
            {"frequency_mhz": 2412.0, "bandwidth_mhz": 40},
            "choose from 2422, 2427, 2432, 2437, 2442, 2447, 2452",
        ),
        ({"ftm": FtmConfig()}, "ftm.mode: vht_mcs0 is VHT, which 2.4 GHz does not have; choose ofdm6 to"),
        ({"data_mode": "vht_mcs3"}, "data_mode: vht_mcs3 is VHT"),
        (
            {"stations": (StationConfig(station=1, broadcast_mode="vht_mcs1"),)},
            r"stations\[0\].broadcast_mode: vht_mcs1 is VHT",
        ),
    ],
)
def test_settings_that_do_not_exist_at_2_4_ghz_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        check(RadioConfig(**{**AT_2_4_GHZ, **settings}), 2)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"frequency_mhz": 2412.0},
        {"frequency_mhz": 2472.0},
        {"frequency_mhz": 2484.0},
        {"bandwidth_mhz": 40},
        {"data_mode": "adaptive", "coverage_class": 31},
    ],
)
def test_channels_of_2_4_ghz_are_accepted(settings):
    check(RadioConfig(**{**AT_2_4_GHZ, **settings}), 2)


def test_other_frequencies_have_the_timing_of_5_ghz():
    timings = {timing_of(RadioConfig(frequency_mhz=mhz)) for mhz in (915.0, 2399.0, 2501.0, 5210.0, 60_000.0)}
    assert {(each.slot_ns, each.sifs_ns, each.signal_extension_ns) for each in timings} == {
        (9_000, 16_000, 0)
    }


def test_rate_control_at_2_4_ghz_has_non_ht_modes():
    config = RadioConfig(**AT_2_4_GHZ, data_mode="adaptive")
    modes = datagram_modes(config, StationConfig(station=0), RandomStreams(np.random.SeedSequence(1)))
    assert modes.rates is not None
    names = [mode.name for mode in modes.rates._modes]
    assert names == ["ofdm6", "ofdm9", "ofdm12", "ofdm18", "ofdm24", "ofdm36", "ofdm48", "ofdm54"]
    assert modes.rates._modes[0].duration_ns(100) == 166_000


def test_group_frames_of_neighbours_beyond_the_time_out_lose_their_rts():
    """The CTS of a neighbour at a round trip of 10 us is late by 1 us."""
    for settings, kinds in (
        ({}, ["data", "rts", "cts"]),
        ({"coverage_class": 1}, ["data", "rts", "cts", "data"]),
    ):
        air = Air(2, delays_ns={(A, B): 5_000, (B, A): 5_000}, **settings)
        air.send(1000, B)
        air.send(2000, A, GROUP, rts=True, retry_limit=0)
        air.run()
        assert [t.frame.kind.value for t in air.transmissions] == kinds
