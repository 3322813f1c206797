"""TIMESYNC, PING, SET_HOME_POSITION and SET_GPS_GLOBAL_ORIGIN."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from protocol_bench import CLIENT, make_flight, over_the_wire
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Reason
from autopilot.services.clocks import PingService, TimesyncService
from autopilot.services.places import PlacesService
from autopilot.services.service import Partner

any_int32 = st.integers(-(2**31), 2**31 - 1)


def test_timesync_requests_are_answered_and_answers_ignored():
    service = TimesyncService(make_flight())
    ((partner, answer),) = service.on_message(
        common.MAVLink_timesync_message(0, 123_456_789_000), 5_000, CLIENT
    )
    assert partner == CLIENT
    assert (answer.tc1, answer.ts1) == (5_000_000, 123_456_789_000)
    assert not service.on_message(answer, 6_000, CLIENT)


def test_an_answer_to_timesync_or_ping_is_not_answered():
    flight = make_flight()
    flight.clock.now_us = 4_000
    a, b = TimesyncService(flight), TimesyncService(flight)
    ((_, answer),) = b.on_message(a.question(), 4_000, CLIENT)
    assert not a.on_message(answer, 8_000, CLIENT)


def test_a_ping_is_returned_to_its_sender():
    service = PingService(make_flight())
    question = over_the_wire(common.MAVLink_ping_message(77, 5, 0, 0))
    ((partner, answer),) = service.on_message(question, 4_000, CLIENT)
    assert partner == CLIENT
    assert (answer.time_usec, answer.seq) == (77, 5)
    assert (answer.target_system, answer.target_component) == (255, 190)
    assert not service.on_message(answer, 4_000, CLIENT)
    own = [service.question() for _ in range(3)]
    assert [ping.seq for ping in own] == [1, 2, 3]
    assert all(ping.target_system == 0 for ping in own)


def set_home(lat_e7, lon_e7, alt_mm):
    return common.MAVLink_set_home_position_message(
        1, lat_e7, lon_e7, alt_mm, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0
    )


@given(any_int32, any_int32, any_int32)
def test_only_valid_coordinates_become_home(lat_e7, lon_e7, alt_mm):
    homes = []
    service = PlacesService(lambda *place: homes.append(place), lambda: None)
    answers = service.on_message(set_home(lat_e7, lon_e7, alt_mm), 0, CLIENT)
    if abs(lat_e7) <= 900_000_000 and abs(lon_e7) <= 1_800_000_000:
        assert homes == [pytest.approx((lat_e7 * 1e-7, lon_e7 * 1e-7, alt_mm * 1e-3))]
        assert not answers
    else:
        assert not homes
        assert answers[0].message.text == "Home denied: wrong parameter"


def test_a_refused_home_is_reported_with_the_reason():
    service = PlacesService(lambda *_: Reason.NO_POSITION, lambda: None)
    ((_, text),) = service.on_message(set_home(0, 0, 0), 0, CLIENT)
    assert text.text == "Home denied: no position estimate"


def test_a_request_to_set_the_origin_is_answered_with_the_current_one():
    origin = common.MAVLink_gps_global_origin_message(1, 2, 3)
    for known in (None, origin):
        service = PlacesService(lambda *_: None, lambda known=known: known)
        message = common.MAVLink_set_gps_global_origin_message(1, 471_234_567, 81_234_567, 500_000)
        answers = service.on_message(message, 0, CLIENT)
        assert [(a.partner, a.message) for a in answers] == [(Partner(CLIENT.link), origin)] * (
            known is origin
        )
