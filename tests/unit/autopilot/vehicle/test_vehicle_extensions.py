"""A whole vehicle with a flight mode, a service and a controller of the user."""

import sys

import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import common
from user_extensions import Counter
from vehicle_world import Flight, vehicle_config

from autopilot.commander.arming_checks import Reason
from autopilot.mavlink.dialect import AvailableModes
from autopilot.mavlink.modes import EXTERNAL_MODES, FlightMode
from autopilot.parameters.config import AutopilotConfig
from autopilot.services.service import NEVER_US
from autopilot.vehicle.extensions import load_extensions, named
from autopilot.vehicle.vehicle import Vehicle
from foundation.extension_failure import ExtensionFailure
from foundation.extensions import ExtensionError
from harness.records.versions import origin_of

ACCEPTED, DENIED = common.MAV_RESULT_ACCEPTED, common.MAV_RESULT_DENIED
SET_MODE, REQUEST = common.MAV_CMD_DO_SET_MODE, common.MAV_CMD_REQUEST_MESSAGE
CLIMB = "user_extensions:ClimbMode"
EXTERNAL1 = FlightMode.EXTERNAL1


def flight_of(**autopilot):
    return Flight(replace(vehicle_config(), autopilot=AutopilotConfig(**autopilot)))


def test_the_external_modes_have_px4s_numbers():
    assert [(mode.main, mode.custom_mode >> 24) for mode in EXTERNAL_MODES] == [(4, 11 + i) for i in range(8)]


def test_a_station_selects_a_mode_of_the_user_which_flies_and_obeys_failsafes():
    with flight_of(modes=(CLIMB,), mode_settings={CLIMB: {"climb_m_s": 1.5}}) as flight:
        commander = flight.vehicle.commander
        flight.take_off(5.0)
        assert flight.command(SET_MODE, 1.0, 4.0, 11.0) == ACCEPTED
        assert commander.mode is EXTERNAL1
        flight.run(3.0)
        assert flight.vehicle.flight.state.vel_ned_m_s[2] == pytest.approx(-1.5, abs=0.15)
        assert flight.vehicle.heartbeat().custom_mode == 4 << 16 | 11 << 24
        flight.gps = False  # its need, a position, is lost
        assert flight.run(30.0, until=lambda: commander.mode is not EXTERNAL1)
        assert commander.failsafe
        assert commander.mode is FlightMode.DESCEND


def test_a_mode_of_the_user_is_listed_with_its_name_and_cannot_be_armed_in_unless_it_says_so():
    with flight_of(modes=(CLIMB,)) as flight:
        flight.run(1.0)
        since = len(flight.received)
        assert flight.command(REQUEST, float(AvailableModes.id), 0.0) == ACCEPTED
        listed = [m for _, m in flight.received[since:] if m.get_type() == "AVAILABLE_MODES"]
        assert (listed[-1].custom_mode, listed[-1].standard_mode) == (EXTERNAL1.custom_mode, 0)
        assert "Climb" in str(listed[-1].mode_name)
        assert [m.mode_index for m in listed] == list(range(1, listed[0].number_modes + 1))
        assert flight.command(SET_MODE, 1.0, 4.0, 11.0) == ACCEPTED  # while disarmed any mode may be selected
        assert Reason.MODE_CANNOT_ARM in flight.vehicle.commander.arming_refusals()


def test_without_a_mode_of_the_user_its_number_is_denied():
    with flight_of() as flight:
        flight.run(1.0)
        assert flight.command(SET_MODE, 1.0, 4.0, 11.0) == DENIED


def test_a_mode_that_returns_a_wrong_setpoint_ends_its_vehicle_with_a_line():
    name = "user_extensions:BrokenMode"
    with flight_of(modes=(CLIMB, name)) as flight:
        flight.take_off(5.0)
        line = r"^autopilot\.modes\[1\] user_extensions:BrokenMode: update returned a vel_ned_m_s of "
        assert flight.vehicle.commander.set_mode(FlightMode.EXTERNAL2) is None
        with pytest.raises(ExtensionFailure, match=line):
            flight.step()


def test_a_service_of_the_user_answers_its_message_and_sends_by_timer():
    Counter.made.clear()
    with flight_of(services=("user_extensions:Counter",)) as flight:
        flight.run(1.0)
        since = len(flight.received)
        for _ in range(3):
            flight.send(common.MAVLink_debug_message(5, 0, 0.0))
            flight.step()
        answers = [m.value for _, m in flight.received[since:] if m.get_type() == "DEBUG"]
        assert answers == [1.0, 2.0, 3.0]
        flight.run(1.2)
        assert "3 of UAV 0" in flight.texts()
    assert len(Counter.made) == 1


def test_a_service_of_the_user_is_a_limit_of_fast_steps():
    due = Vehicle(replace(vehicle_config(), autopilot=AutopilotConfig(services=("user_extensions:Counter",))))
    never = Vehicle(
        replace(vehicle_config(), autopilot=AutopilotConfig(services=("user_extensions:NeverDue",)))
    )
    for vehicle, deadline_us in ((due, 1_000_000), (never, NEVER_US)):
        vehicle.messaging.on_timer(0, (False, False))
        assert vehicle.fast_step_limits(NEVER_US).services_us == deadline_us


def test_a_service_that_returns_something_else_than_messages_ends_its_vehicle_with_a_line():
    with (
        flight_of(services=("user_extensions:BrokenService",)) as flight,
        pytest.raises(
            ExtensionFailure,
            match=r"^autopilot\.services\[0\] user_extensions:BrokenService: on_timer returned 'text'; ",
        ),
    ):
        flight.run(1.0)


@pytest.mark.parametrize(
    ("services", "line"),
    [
        (("user_extensions:TakesCommands",), "COMMAND_LONG is already handled by a built-in service"),
        (
            ("user_extensions:Counter", "user_extensions.again:Counter"),
            "DEBUG is already handled by autopilot.services[0] user_extensions:Counter",
        ),
    ],
)
def test_two_services_that_handle_the_same_message_are_refused(services, line, monkeypatch):
    monkeypatch.setitem(sys.modules, "user_extensions.again", sys.modules["user_extensions"])
    with pytest.raises(ExtensionError) as caught:
        flight_of(services=services)
    assert str(caught.value) == f"autopilot.services[{len(services) - 1}] {services[-1]}: {line}"


@pytest.mark.parametrize(
    ("autopilot", "line"),
    [
        (
            {"controller": "no_such_module:C"},
            "autopilot.controller: no module no_such_module; expected it in ",
        ),
        (
            {"controller": "hover"},
            "autopilot.controller: 'hover' is not installed; expected package.module:Class or",
        ),
        (
            {"controller": "user_extensions:a_function"},
            "autopilot.controller: user_extensions:a_function is a funct",
        ),
        (
            {"controller": "user_extensions:NoController"},
            "autopilot.controller: user_extensions:NoController lacks reset; expected a coflight.Controller",
        ),
        (
            {"controller": "user_extensions:CascadeAgain", "controller_settings": {"gain": 1}},
            "autopilot.controller_settings: user_extensions:CascadeAgain",
        ),
        (
            {"controller_settings": {"gain": 1}},
            "autopilot.controller_settings: there is no autopilot.controller",
        ),
        (
            {"modes": (CLIMB,), "mode_settings": {CLIMB: {"climb_m_s": 4.0}}},
            f"autopilot.mode_settings.{CLIMB}.climb_m_s: expected `float` <= 3.0",
        ),
        (
            {"modes": (CLIMB,), "mode_settings": {CLIMB: {"climb": 1.0}}},
            f"autopilot.mode_settings.{CLIMB}: unknown key `climb`; did you mean `climb_m_s`?",
        ),
        (
            {"modes": (CLIMB,), "mode_settings": {"Climb": {}}},
            "autopilot.mode_settings: 'Climb' is not in autopilot.modes",
        ),
        ({"modes": (CLIMB, CLIMB)}, f"autopilot.modes: {CLIMB!r} is in it twice"),
        (
            {"modes": ("user_extensions:Counter",)},
            "autopilot.modes[0]: user_extensions:Counter lacks traits, enter, update, next_mode, course,",
        ),
        (
            {"services": ("user_extensions:CascadeAgain",)},
            "autopilot.services[0]: user_extensions:CascadeAgain lacks on_message, on_timer, ",
        ),
    ],
)
def test_what_cannot_be_loaded_is_one_line_with_the_field(autopilot, line):
    with pytest.raises(ExtensionError) as caught:
        load_extensions(AutopilotConfig(**autopilot))
    assert str(caught.value).startswith(line)
    assert "\n" not in str(caught.value)


def test_an_installed_mode_takes_effect_only_if_the_scenario_names_it(tmp_path, monkeypatch):
    about = tmp_path / "climbing-1.2.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: climbing\nVersion: 1.2\n")
    (about / "entry_points.txt").write_text("[coflight.modes]\nclimb = climbing_mode:ClimbMode\n")
    (about / "RECORD").write_text("climbing_mode.py,,\nclimbing-1.2.dist-info/METADATA,,\n")
    (tmp_path / "climbing_mode.py").write_text("from user_extensions import ClimbMode\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert load_extensions(AutopilotConfig()).modes == ()
    config = AutopilotConfig(modes=("climb",), mode_settings={"climb": {"climb_m_s": 2.0}})
    (mode,) = load_extensions(config).modes
    assert (mode.kind.__name__, mode.settings[0].climb_m_s) == ("ClimbMode", 2.0)
    ((field, (name, group)),) = named(config).items()
    assert field == "autopilot.modes[0]"
    assert origin_of(name, group) == {
        "name": "climb", "path": "climbing_mode:ClimbMode", "distribution": "climbing", "version": "1.2",
    }  # fmt: skip


def test_a_controller_of_the_user_takes_off_hovers_and_lands():
    with flight_of(controller="user_extensions:CascadeAgain") as flight:
        flight.take_off(5.0)
        flight.run(3.0)
        assert flight.height_m == pytest.approx(5.0, abs=1.0)
        assert flight.command(common.MAV_CMD_NAV_LAND) == ACCEPTED
        assert flight.run(30.0, until=lambda: not flight.vehicle.commander.armed)
        assert flight.height_m == pytest.approx(0.0, abs=0.05)
