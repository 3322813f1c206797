"""The public interface of on-board applications: a user's class in place of the built-in one."""

import math
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from vehicle_world import Flight, vehicle_config

from autopilot.logs.vehicle_record import record, vehicle_record
from autopilot.onboard.factory import layout_of, load_application
from autopilot.parameters.onboard_config import OnboardConfig
from foundation.extension_failure import ExtensionFailure
from foundation.extensions import ExtensionError
from netsim.wire.messages import Delivery


def steps(flight, count):
    return [flight.step() for _ in range(count)]


def flight_of(application, **settings):
    onboard = OnboardConfig(
        application=f"user_applications:{application}", settings=settings, loop_period_ms=20
    )
    return Flight(replace(vehicle_config(onboard=True), onboard=onboard))


def test_it_receives_telemetry_and_settings_uses_the_radio_and_reports():
    flight = flight_of("Echo", prefix=">")
    outputs = steps(flight, 500)
    vehicle = flight.vehicle
    assert {"HEARTBEAT", "LOCAL_POSITION_NED"} <= vehicle.app.application.seen
    item = Delivery(source=1, seq=0, received_ns=1_000 * flight.now_us, rssi_dbm=-60.0, payload=b"abc")
    vehicle.app.on_radio([item], flight.now_us)
    sent = []
    for _ in range(10):  # the loop's period is 20 ms, 5 steps
        output = flight.step()
        outputs.append(output)
        sent += output.radio
    assert [each.payload for each in sent] == [b">abc"]
    assert vehicle.troubles() == {"offboard_rejected": 0, "echoes_lost": 0}
    assert np.frombuffer(record(vehicle), vehicle_record(vehicle.columns))["phase"] == 3
    assert vehicle.app.values[0] == 1.0
    assert math.isnan(vehicle.app.values[1])
    messages = [message for output in outputs for message in output.simulator]
    beats = [message for message in messages if message.get_type() == "HEARTBEAT" and message.autopilot == 8]
    assert {message.custom_mode for message in beats} == {3}
    arrays = [message for message in messages if message.get_type() == "DEBUG_FLOAT_ARRAY"]
    assert len(arrays) == pytest.approx(510 * 4 / 200, abs=2)


def test_the_client_takes_off_follows_and_reports_a_landing():
    flight = flight_of("Hop")
    autopilot = flight.vehicle.app.application.context.autopilot
    for _ in range(30 * 250):
        flight.step()
        if flight.vehicle.app.phase == 7:
            break
    assert flight.vehicle.app.phase == 7
    assert autopilot.follows


def test_numbers_that_an_application_changes_in_place_are_checked_and_copied():
    flight = flight_of("ChangesNumbers")
    steps(flight, 20)
    values = [program_values(flight)]
    steps(flight, 20)
    values.append(program_values(flight))
    assert values[1]["echoes"] > values[0]["echoes"] > 0.0
    flight.vehicle.app.application.numbers["echoes"] = "many"
    with pytest.raises(ExtensionFailure, match="status has 'many' as echoes; expected a number"):
        steps(flight, 20)


@pytest.mark.parametrize("values", [None, [1.0]])
def test_values_that_are_no_mapping_are_refused(values):
    flight = flight_of("ChangesNumbers")
    flight.vehicle.app.application.numbers = values
    with pytest.raises(ExtensionFailure, match="as values; expected numbers by name"):
        steps(flight, 20)


def program_values(flight):
    return flight.vehicle.app.status.values


def test_an_exception_names_application_cause_and_place():
    config = vehicle_config(onboard=True)
    onboard = OnboardConfig(application="user_applications:Raises")
    flight = Flight(replace(config, instance=1, onboard=onboard, places_ned_m=config.places_ned_m * 2))
    with pytest.raises(ExtensionFailure) as caught:
        steps(flight, 600)
    line = str(caught.value)
    assert line.startswith("onboard.application user_applications:Raises: ZeroDivisionError: as written (")
    assert "user_applications.py:" in line
    assert 2_000_000 <= flight.now_us <= 2_040_000


@pytest.mark.parametrize(
    ("fields", "line"),
    [
        (
            {"application": "no_such_module:App"},
            (
                "onboard.application: no module no_such_module; "
                f"expected it in {Path.cwd()}, installed, or its folder in PYTHONPATH"
            ),
        ),
        (
            {"application": "consensus"},
            (
                "onboard.application: 'consensus' is not installed; "
                "expected package.module:Class or one of formation"
            ),
        ),
        (
            {"application": "user_applications:Phase"},
            (
                "onboard.application: user_applications:Phase has no method start; "
                "expected a subclass of coflight.Application"
            ),
        ),
        (
            {"application": "harness.env.policy:PolicyApplication"},
            (
                "onboard.application: harness.env.policy:PolicyApplication has no method act; "
                "expected a subclass of coflight.Application"
            ),
        ),
        (
            {"application": "user_applications:Hop", "settings": {"x": 1}},
            "onboard.settings: user_applications:Hop has no class attribute Settings",
        ),
        (
            {"application": "user_applications:Echo", "settings": {"prefix": 1}},
            "onboard.settings.prefix: expected `str`, got `int`",
        ),
    ],
)
def test_what_cannot_be_used_is_named_in_one_line(fields, line):
    with pytest.raises(ExtensionError) as caught:
        load_application(OnboardConfig(**fields))
    assert str(caught.value) == line


def test_a_wrong_setting_of_the_application_is_not_reported_as_one_of_the_programs():
    config = OnboardConfig(application="user_applications:Echo", settings={"prefix": "too long"})
    with pytest.raises(ExtensionError, match=r"^onboard\.settings\.prefix: "):
        layout_of(config)
