"""Streams: rates, deadlines, changed intervals, and immediate messages."""

import pytest
from protocol_bench import make_flight, make_telemetry
from pymavlink.dialects.v20 import common

from autopilot.services.streams import (
    APPLICATION_HZ,
    COMPANION_HZ,
    GROUND_STATION_HZ,
    ON_NEW_DATA,
    STEP_US,
    MessageStreams,
)

ATTITUDE = common.MAVLINK_MSG_ID_ATTITUDE
HEARTBEAT = common.MAVLINK_MSG_ID_HEARTBEAT
HOME = common.MAVLINK_MSG_ID_HOME_POSITION
GPS = common.MAVLINK_MSG_ID_GPS_RAW_INT


def count_streams(streams, duration_us, *, on_step=lambda _: None):
    counts = {}
    for now_us in range(0, duration_us, STEP_US):
        on_step(now_us)
        for message in streams.on_timer(now_us):
            counts[message.get_msgId()] = counts.get(message.get_msgId(), 0) + 1
    return counts


def dummy_builders(rates_hz):
    """Builders that always return a message, so that the test is of the schedule alone."""

    def make(message_id):
        def build():
            message = common.MAVLink_system_time_message(0, 0)
            message.get_msgId = lambda: message_id
            return message

        return build

    return {message_id: make(message_id) for message_id in rates_hz}


@pytest.mark.parametrize("rates_hz", [GROUND_STATION_HZ, COMPANION_HZ])
def test_every_stream_has_its_rate_on_the_4_ms_grid(rates_hz):
    streams = MessageStreams(dummy_builders(rates_hz), rates_hz)
    counts = count_streams(
        streams, 10_000_000, on_step=lambda _: [streams.on_new_data(message_id) for message_id in ON_NEW_DATA]
    )
    for message_id, rate_hz in rates_hz.items():
        assert counts[message_id] == pytest.approx(10 * rate_hz, abs=1), message_id


def test_new_data_is_sent_once_and_never_above_the_rate():
    streams = MessageStreams(dummy_builders(COMPANION_HZ), COMPANION_HZ)

    def fixes(every_us):
        return lambda now_us: now_us % every_us or streams.on_new_data(GPS)

    assert GPS not in count_streams(streams, 1_000_000)
    assert count_streams(streams, 10_000_000, on_step=fixes(200_000))[GPS] == 50
    streams = MessageStreams(dummy_builders(COMPANION_HZ), COMPANION_HZ)
    assert count_streams(streams, 10_000_000, on_step=fixes(20_000))[GPS] == pytest.approx(100, abs=1)


def test_without_a_listener_only_the_heartbeat_is_built():
    streams = MessageStreams(dummy_builders(GROUND_STATION_HZ), GROUND_STATION_HZ)
    streams.active = False
    streams.hasten(HOME, 0)
    assert count_streams(streams, 3_000_000) == {HEARTBEAT: 3}
    streams.active = True  # skipped messages are not sent later
    assert count_streams(streams, 1_000_000)[ATTITUDE] <= 50


def test_the_deadline_is_the_time_of_the_next_message():
    streams = MessageStreams(dummy_builders(COMPANION_HZ), COMPANION_HZ)
    now_us = 0
    for _ in range(200):
        assert streams.on_timer(now_us)
        assert streams.deadline_us > now_us
        assert streams.on_timer(streams.deadline_us - 1) == ()
        now_us = streams.deadline_us


def test_intervals_are_set_stopped_and_restored():
    streams = MessageStreams(dummy_builders(COMPANION_HZ), COMPANION_HZ)
    assert streams.set_interval(ATTITUDE, 500_000, 0)
    assert count_streams(streams, 1_000_000)[ATTITUDE] == 2
    assert streams.set_interval(ATTITUDE, -1, 0)
    assert ATTITUDE not in count_streams(streams, 1_000_000)
    assert streams.set_interval(ATTITUDE, 0, 0)
    assert count_streams(streams, 1_000_000)[ATTITUDE] == pytest.approx(100, abs=1)
    assert not streams.set_interval(12_345, 1_000, 0)


def test_no_message_is_sent_more_often_than_the_vehicle_steps():
    streams = MessageStreams(dummy_builders(COMPANION_HZ), COMPANION_HZ)
    assert streams.set_interval(ATTITUDE, 1, 0)
    assert streams.interval_us(ATTITUDE) == STEP_US
    assert count_streams(streams, 1_000_000)[ATTITUDE] == 1_000_000 // STEP_US


@pytest.mark.parametrize("interval_us", [-1, 0, 10**30])
def test_the_heartbeat_cannot_be_stopped(interval_us):
    streams = MessageStreams(dummy_builders(COMPANION_HZ), COMPANION_HZ)
    streams.set_interval(HEARTBEAT, interval_us, 0)
    assert count_streams(streams, 5_000_000)[HEARTBEAT] == 5


def test_a_change_is_sent_with_the_next_step_and_then_at_the_rate():
    streams = MessageStreams(dummy_builders(GROUND_STATION_HZ), GROUND_STATION_HZ)
    period_us = round(1e6 / GROUND_STATION_HZ[HOME])
    times_us = []
    for now_us in range(0, 3 * period_us, STEP_US):
        if now_us == period_us // 2:
            streams.hasten(HOME, now_us)
        times_us += [now_us for m in streams.on_timer(now_us) if m.get_msgId() == HOME]
    assert times_us == [0, period_us // 2, 3 * period_us // 2, 5 * period_us // 2]


def test_a_builder_that_is_added_later_is_used():
    builders = {}
    streams = MessageStreams(builders, {ATTITUDE: 50.0})
    assert not streams.is_supported(ATTITUDE)
    assert streams.interval_us(ATTITUDE) == 0
    assert count_streams(streams, 1_000_000) == {}
    builders |= dummy_builders({ATTITUDE: 50.0})
    assert streams.is_supported(ATTITUDE)
    assert [message.get_msgId() for message in streams.on_timer(1_000_000)] == [ATTITUDE]


def test_every_stream_has_a_builder():
    builders = make_telemetry(make_flight()).builders
    others = {
        common.MAVLINK_MSG_ID_MISSION_CURRENT,
        common.MAVLINK_MSG_ID_PING,
        common.MAVLINK_MSG_ID_TIMESYNC,
    }  # added by the vehicle
    for rates_hz in (GROUND_STATION_HZ, COMPANION_HZ, APPLICATION_HZ):
        assert set(rates_hz) - others <= set(builders)
