"""The parameter table against the settings."""

import itertools

import msgspec
import pytest
from pymavlink.dialects.v20 import common
from vehicle_world import Flight, vehicle_config

from autopilot.parameters.inert import STATED
from autopilot.parameters.table import (
    INDEX_OF,
    NOT_OVER,
    ROWS,
    TABLE,
    UNDER,
    ParameterError,
    ParameterProblem,
    ParameterSet,
    Settings,
    check_range,
)
from autopilot.services.metadata import COMPONENT_METADATA

NAMES = [parameter.name for parameter in TABLE]
CHAINS = (
    ("BAT_EMERGEN_THR", "BAT_CRIT_THR", "BAT_LOW_THR"),
    ("BAT1_V_EMPTY", "BAT1_V_CHARGED"),
    ("MPC_LAND_ALT2", "MPC_LAND_ALT1"),
    ("MPC_THR_MIN", "MPC_THR_MAX"),
)
"""In ascending order."""
NEVER = {("BAT1_V_EMPTY", 5.0), ("BAT1_V_CHARGED", 2.0)}
"""Ends of a range at which the other parameter of the pair has no valid value."""


def with_room(name):
    """Values of the other parameters of its chain that leave it the largest range."""
    chain = next((chain for chain in CHAINS if name in chain), (name,))
    at = chain.index(name)
    below = {other: TABLE[INDEX_OF[other]].minimum for other in chain[:at]}
    return below | {other: TABLE[INDEX_OF[other]].maximum for other in chain[at + 1 :]}


def test_names_are_unique_sorted_and_fit_mavlink():
    assert sorted(set(NAMES)) == NAMES
    assert max(map(len, NAMES)) <= 16


@pytest.mark.parametrize("parameter", TABLE, ids=NAMES)
def test_each_row_changes_its_setting_over_its_whole_range_and_no_other(parameter):
    parameters = ParameterSet(Settings())
    assert parameter.minimum <= parameters.get(parameter.name) <= parameter.maximum
    parameters = ParameterSet(Settings(), with_room(parameter.name))
    others = {name: parameters.get(name) for name in NAMES if name != parameter.name}
    for value in (parameter.minimum, parameter.maximum):
        if (parameter.name, value) in NEVER:
            continue
        parameters = ParameterSet(Settings(), with_room(parameter.name) | {parameter.name: value})
        assert parameters.get(parameter.name) == pytest.approx(value, rel=1e-12)
        # the settings accept the whole range of the table
        assert msgspec.convert(msgspec.to_builtins(parameters.settings), Settings) == parameters.settings
        assert {name: parameters.get(name) for name in others} == others


def test_each_change_is_in_effect_at_once_unless_only_at_the_start():
    for parameter in TABLE:
        parameters, reported = ParameterSet(Settings(), with_room(parameter.name)), []
        parameters.report_to(reported.append)
        value, before = parameter.maximum, parameters.get(parameter.name)
        if (parameter.name, value) in NEVER:
            value = parameter.minimum
        if parameter.only_at_start:
            with pytest.raises(ParameterError, match=f"{parameter.name} can only be set at the start"):
                parameters.set(parameter.name, value)
            parameters.reset([parameter.name])
            assert (parameters.get(parameter.name), reported) == (before, [])
        else:
            parameters.set(parameter.name, value)
            assert parameters.get(parameter.name) == pytest.approx(value, rel=1e-12)
            assert reported == [parameter.name]


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        ({"MPC_XYP": 1.0}, "there is no parameter 'MPC_XYP'"),
        ({"MPC_XY_P": 9.0}, "parameter MPC_XY_P = 9 is outside 0 .. 2 1/s"),
        ({"MPC_XY_P": float("nan")}, "parameter MPC_XY_P = nan is outside 0 .. 2 1/s"),
        ({"EKF2_REQ_NSATS": 6.5}, "parameter EKF2_REQ_NSATS = 6.5 is not a whole number"),
    ],
)
def test_invalid_overrides_are_one_line_errors(overrides, line):
    with pytest.raises(ParameterError) as error:
        ParameterSet(Settings(), overrides)
    assert str(error.value) == line


def test_units_are_px4s():
    parameters = ParameterSet(Settings(), {"MPC_TILTMAX_AIR": 30.0, "EKF2_GPS_DELAY": 110.0})
    assert parameters.settings.control.position.tilt_max_rad == pytest.approx(0.5235987756)
    assert parameters.settings.estimation.gps_delay_us == 110_000


def test_the_chains_are_the_checked_pairs():
    pairs = {pair for chain in CHAINS for pair in itertools.pairwise(chain)}
    assert pairs == set(NOT_OVER + UNDER)


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (
            {"MPC_THR_MIN": 0.5, "MPC_THR_MAX": 0.4},
            "parameter MPC_THR_MIN = 0.5 must be at most MPC_THR_MAX = 0.4",
        ),
        ({"BAT_LOW_THR": 0.06}, "parameter BAT_CRIT_THR = 0.07 must be at most BAT_LOW_THR = 0.06"),
        ({"BAT_EMERGEN_THR": 0.1}, "parameter BAT_EMERGEN_THR = 0.1 must be at most BAT_CRIT_THR = 0.07"),
        (
            {"BAT1_V_EMPTY": 4.05},
            "parameter BAT1_V_EMPTY = 4.05 must be less than BAT1_V_CHARGED = 4.05",
        ),
        ({"MPC_LAND_ALT1": 4.0}, "parameter MPC_LAND_ALT2 = 5 must be at most MPC_LAND_ALT1 = 4"),
    ],
)
def test_pairs_out_of_order_are_one_line_errors_without_a_change(overrides, line):
    with pytest.raises(ParameterError) as error:
        ParameterSet(Settings(), overrides)
    assert str(error.value) == line
    parameters = ParameterSet(Settings(), dict(list(overrides.items())[:-1]))
    before = parameters.settings
    with pytest.raises(ParameterError):
        parameters.set(*list(overrides.items())[-1])
    assert parameters.settings is before


@pytest.mark.parametrize(
    "overrides",
    [
        {"BAT_LOW_THR": 0.04, "BAT_CRIT_THR": 0.03, "BAT_EMERGEN_THR": 0.02},
        {"BAT_LOW_THR": 0.5, "BAT_CRIT_THR": 0.5, "BAT_EMERGEN_THR": 0.5},
        {"MPC_THR_MIN": 0.11, "MPC_THR_MAX": 0.11},
        {"BAT1_V_EMPTY": 2.8, "BAT1_V_CHARGED": 3.4},
        {"MPC_LAND_ALT1": 2.0, "MPC_LAND_ALT2": 1.0},
    ],
)
def test_overrides_in_order_are_accepted_in_any_sequence(overrides):
    """Applied one by one to the defaults, each set would be out of order in one sequence."""
    for names in itertools.permutations(overrides):
        parameters = ParameterSet(Settings(), {name: overrides[name] for name in names})
        assert {name: parameters.get(name) for name in overrides} == overrides


def test_check_range_ignores_other_parameters():
    check_range("MPC_THR_MAX", 0.1)
    with pytest.raises(ParameterError, match="outside"):
        check_range("MPC_THR_MAX", 0.09)


def test_parameters_without_effect_are_stored_within_their_ranges():
    parameters = ParameterSet(Settings(), {"COM_RC_IN_MODE": 4.0}, system=7)
    assert (parameters.get("COM_RC_IN_MODE"), parameters.get("MAV_SYS_ID")) == (4.0, 7.0)
    assert parameters.settings == Settings()
    for row in STATED:
        assert row.minimum <= row.default <= row.maximum
        assert not row.is_integer or row.default == round(row.default)
        if not row.read_only:
            parameters.set(row.name, row.maximum)
            assert parameters.get(row.name) == row.maximum
    assert parameters.settings == Settings()


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("NO_SUCH", 1.0, ParameterProblem.UNKNOWN),
        ("MPC_XY_P", 9.0, ParameterProblem.VALUE),
        ("RTL_TYPE", 3.0, ParameterProblem.VALUE),
        ("MAV_SYS_ID", 3.0, ParameterProblem.READ_ONLY),
    ],
)
def test_a_refusal_has_its_problem_and_changes_nothing(name, value, problem):
    parameters = ParameterSet(Settings())
    with pytest.raises(ParameterError) as error:
        parameters.set(name, value)
    assert error.value.problem is problem
    assert parameters.version == 0
    parameters.set("MPC_XY_P", 1.1)
    assert parameters.version == 1


def test_rows_of_both_kinds_are_sorted_by_name():
    names = [row.name for row in ROWS]
    assert sorted(set(names)) == names
    assert max(map(len, names)) <= 16
    assert len(names) == len(TABLE) + len(STATED)


def test_every_change_is_reported_to_stations():
    with Flight(vehicle_config()) as flight:
        flight.step()
        flight.vehicle.parameters.set("MPC_XY_P", 1.2)
        flight.vehicle.parameters.set("COM_RC_IN_MODE", 4.0)
        flight.step()
        reported = [message.param_id for _, message in flight.received if message.get_type() == "PARAM_VALUE"]
        assert set(reported) == {"MPC_XY_P", "COM_RC_IN_MODE"}
        flight.received.clear()
        flight.run(0.2)
        assert not [message for _, message in flight.received if message.get_type() == "PARAM_VALUE"]


def test_the_metadata_message_can_be_requested():
    with Flight(vehicle_config()) as flight:
        flight.step()
        message_id = float(COMPONENT_METADATA)
        assert flight.command(common.MAV_CMD_REQUEST_MESSAGE, message_id) == common.MAV_RESULT_ACCEPTED
        (message,) = [m for _, m in flight.received if m.get_msgId() == COMPONENT_METADATA]
        assert flight.vehicle.messaging.files.open(message.uri.removeprefix("mftp://")) is not None


def test_a_change_reaches_the_subscribers_of_its_group_in_their_order():
    parameters, received = ParameterSet(Settings()), []

    def subscribe(name, *groups):
        parameters.subscribe(lambda *values: received.append((name, *values)), *groups)

    subscribe("control", "control")
    subscribe("rate", "control.rate")
    subscribe("navigator", "navigation", "control.trajectory")
    parameters.set("MPC_XY_CRUISE", 4.0)
    settings = parameters.settings
    assert received == [
        ("control", settings.control), ("navigator", settings.navigation, settings.control.trajectory)
    ]  # fmt: skip
    received.clear()
    with pytest.raises(ParameterError):
        parameters.set("MPC_THR_MIN", 0.5 + parameters.get("MPC_THR_MAX"))
    parameters.set("COM_RC_IN_MODE", 4.0)  # without effect
    assert received == []
    parameters.reset(["MPC_XY_CRUISE", "MC_ROLLRATE_P"])
    assert [name for name, *_ in received] == ["control", "navigator"]


def test_a_subscription_to_an_unknown_group_is_an_error():
    with pytest.raises(AttributeError):
        ParameterSet(Settings()).subscribe(print, "control.speed")
