"""Parameters that responders grant, and the times of bursts that both sides derive from them."""

from hypothesis import given
from hypothesis import strategies as st
from netsim_ftm_reader import read

from netsim.ftm.elements import Parameters, Request, Status
from netsim.ftm.negotiation import (
    LEAST_WAIT_NS,
    LONGEST_BURST_US,
    TIME_UNIT_NS,
    Schedule,
    can_measure,
    from_partial_tsf_ns,
    grant,
    rejection,
    requested_parameters,
)
from netsim.model.config import FtmConfig

DURATIONS_US = [250 << k for k in range(10)]
CONFIGS = st.builds(
    FtmConfig,
    ftms_per_burst=st.integers(2, 31),
    min_delta_us=st.integers(100, 25_500),
    burst_duration_us=st.sampled_from(DURATIONS_US),
    bursts_exponent=st.integers(0, 6),
    burst_period_ms=st.integers(1, 65_535).map(lambda units: 100 * units),
    asap=st.booleans(),
    responder_asap_capable=st.booleans(),
    responder_ftms_per_burst=st.integers(2, 31),
    responder_min_delta_us=st.integers(100, 25_500),
)
TIMES_NS = st.integers(0, 10**13)


@given(CONFIGS, CONFIGS, TIMES_NS)
def test_grant_follows_the_request_within_the_responders_limits(initiator, responder, now_ns):
    requested = requested_parameters(initiator, 13)
    granted = grant(requested, responder, 13, now_ns)
    assert granted.status is Status.SUCCESSFUL
    assert granted.bursts_exponent == initiator.bursts_exponent
    assert granted.ftms_per_burst == min(initiator.ftms_per_burst, responder.responder_ftms_per_burst)
    # the protocol counts in 100 us
    assert 0 <= granted.min_delta_us - max(initiator.min_delta_us, responder.responder_min_delta_us) < 100
    assert granted.asap == (initiator.asap and responder.responder_asap_capable)
    # a burst is longer than requested only if the responder needs more time, and then fits all frames
    if granted.min_delta_us > requested.min_delta_us:
        needed_us = granted.ftms_per_burst * granted.min_delta_us
        assert granted.burst_duration_us >= min(needed_us, LONGEST_BURST_US)
        shorter_us = granted.burst_duration_us // 2
        assert granted.burst_duration_us == initiator.burst_duration_us or shorter_us < needed_us
    else:
        assert granted.burst_duration_us == initiator.burst_duration_us
    if initiator.bursts_exponent:
        assert granted.burst_period_ms >= initiator.burst_period_ms
        assert 1_000 * granted.burst_period_ms >= granted.burst_duration_us
    # it says the same as bytes
    assert read(Request(parameters=granted).encode()) == Request(parameters=granted)
    assert read(Request(parameters=requested).encode()) == Request(parameters=requested)


@given(CONFIGS, TIMES_NS)
def test_no_preference_selects_the_responders_parameters(responder, now_ns):
    granted = grant(Parameters(asap=True), responder, 8, now_ns)
    assert granted.bursts_exponent == responder.bursts_exponent
    assert granted.ftms_per_burst == min(responder.ftms_per_burst, responder.responder_ftms_per_burst)
    assert granted.min_delta_us >= responder.min_delta_us
    assert granted.burst_duration_us >= responder.burst_duration_us


@given(CONFIGS, TIMES_NS, st.integers(0, 30_000_000))
def test_both_sides_derive_equal_times_from_a_grant(config, now_ns, later_us):
    granted = grant(requested_parameters(config, 13), config, 13, now_ns)
    schedule = Schedule.of(granted, now_ns)
    # the initiator reads it later: up to half of the 67 s after which a partial TSF repeats
    assert Schedule.of(granted, now_ns + 1_000 * later_us) == schedule
    first_ns = schedule.begin_ns(0)
    assert first_ns % TIME_UNIT_NS == 0
    if granted.asap:
        assert 0 <= now_ns - first_ns < TIME_UNIT_NS
    else:
        assert LEAST_WAIT_NS <= first_ns - now_ns < LEAST_WAIT_NS + TIME_UNIT_NS
    assert schedule.last == 2**config.bursts_exponent - 1
    for burst in {0, schedule.last // 2, schedule.last}:
        begin_ns, end_ns = schedule.begin_ns(burst), schedule.end_ns(burst)
        assert begin_ns == first_ns + burst * 1_000_000 * (granted.burst_period_ms or 0)
        assert end_ns - begin_ns == 1_000 * granted.burst_duration_us
        assert schedule.burst_at(begin_ns) == schedule.burst_at(end_ns) == burst
    assert schedule.burst_at(first_ns - 1) is None
    assert schedule.burst_at(schedule.end_ns(schedule.last) + 1) is None


def test_no_burst_between_bursts():
    schedule = Schedule(first_ns=0, period_ns=100_000_000, duration_ns=4_000_000, last=1)
    assert schedule.burst_at(4_000_001) is None
    assert schedule.burst_at(99_999_999) is None
    assert schedule.burst_at(100_000_000) == 1


def test_a_preferred_first_burst_is_granted_if_there_is_time():
    now_ns = 5_000 * TIME_UNIT_NS
    for requested_units, granted_units in ((5_100, 5_100), (5_001, 5_010)):
        requested = Parameters(partial_tsf=requested_units)
        assert grant(requested, FtmConfig(), 13, now_ns).partial_tsf == granted_units


@given(TIMES_NS, st.integers(-(2**15), 2**15 - 1))
def test_partial_tsf_selects_the_nearest_time(now_ns, units):
    then_ns = (now_ns // TIME_UNIT_NS + units) * TIME_UNIT_NS
    assert from_partial_tsf_ns(then_ns // TIME_UNIT_NS % 2**16, now_ns) == then_ns


def test_formats_wider_than_the_channel_are_not_supported():
    fits = {
        width: [
            can_measure(Parameters(format_and_bandwidth=code), width) for code in (None, 8, 10, 12, 13, 14)
        ]
        for width in (20, 40, 80)
    }
    assert fits[20] == [True, True, True, False, False, False]
    assert fits[40] == [True, True, True, True, False, False]
    assert fits[80] == [True, True, True, True, True, False]


def test_retry_time_is_rounded_up_and_limited_to_31_s():
    seconds = [rejection(Status.FAILED, ns).value for ns in (1, 10**9, 10**9 + 1, 10**12)]
    assert seconds == [1, 1, 2, 31]
    assert rejection(Status.INCAPABLE, 5).value == 0
