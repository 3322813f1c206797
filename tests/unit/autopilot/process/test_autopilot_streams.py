"""Requests for the streams of the autopilot beside an application."""

import pytest
from pymavlink.dialects.v20 import common

from autopilot.process.streams import ARDUPILOT_STREAMS, AS_SENT, PX4_STREAMS, REQUEST_PERIOD_US, Streams

REQUESTED = {kind: period_us for kind, period_us in ARDUPILOT_STREAMS.items() if period_us != AS_SENT}
UNUSED = common.MAVLINK_MSG_ID_HIGHRES_IMU


def intervals(messages):
    """Return periods in us by message."""
    assert {message.command for message in messages} <= {common.MAV_CMD_SET_MESSAGE_INTERVAL}
    assert {(message.target_system, message.target_component) for message in messages} <= {(5, 1)}
    return {int(message.param1): message.param2 for message in messages}


@pytest.fixture
def ardupilot():
    return Streams(ARDUPILOT_STREAMS, stops_others=False, target_system=5)


def test_all_streams_are_requested_at_once_with_their_periods(ardupilot):
    assert intervals(ardupilot.on_timer(0)) == REQUESTED


def test_missing_streams_are_requested_again_each_second(ardupilot):
    arriving = common.MAVLINK_MSG_ID_LOCAL_POSITION_NED
    requested = []
    for now_us in range(0, 5 * REQUEST_PERIOD_US, 20_000):
        assert ardupilot.on_message(arriving, now_us) == []
        requested.append(intervals(ardupilot.on_timer(now_us)))
    rounds = [each for each in requested if each]
    missing = {kind: period_us for kind, period_us in REQUESTED.items() if kind != arriving}
    assert rounds == [missing] * 5


def test_a_stream_that_ends_is_requested_again(ardupilot):
    for kind in REQUESTED:
        ardupilot.on_message(kind, 0)
    assert ardupilot.on_timer(REQUEST_PERIOD_US - 20_000) == []
    ended = common.MAVLINK_MSG_ID_GPS_RAW_INT
    for kind in REQUESTED.keys() - {ended}:
        ardupilot.on_message(kind, 2 * REQUEST_PERIOD_US - 20_000)
    assert intervals(ardupilot.on_timer(2 * REQUEST_PERIOD_US)) == {ended: REQUESTED[ended]}


def test_an_ardupilots_other_messages_are_ignored_and_not_stopped(ardupilot):
    assert not ardupilot.is_used(UNUSED)
    assert ardupilot.on_message(UNUSED, 0) == []


def test_a_px4s_other_messages_are_stopped_ever_more_rarely():
    px4 = Streams(PX4_STREAMS, stops_others=True, target_system=5)
    assert px4.on_timer(0) == []  # it streams by itself
    times_us = range(0, 10_000_000, 100_000)
    stops = {now_us: intervals(px4.on_message(UNUSED, now_us)) for now_us in times_us}
    assert {now_us: stop for now_us, stop in stops.items() if stop} == {
        now_us: {UNUSED: -1.0} for now_us in (0, 1_000_000, 3_000_000, 7_000_000)
    }


@pytest.mark.parametrize("streams", [PX4_STREAMS, ARDUPILOT_STREAMS])
def test_replies_and_texts_are_used_of_each_autopilot(streams):
    for name in (
        "HEARTBEAT",
        "COMMAND_ACK",
        "COMMAND_LONG",
        "PARAM_VALUE",
        "STATUSTEXT",
        "GPS_GLOBAL_ORIGIN",
    ):
        assert streams[getattr(common, f"MAVLINK_MSG_ID_{name}")] == AS_SENT
