"""The parameter table against the settings that it leads to."""

import msgspec
import pytest

from autopilot.params import TABLE, ParameterError, ParameterSet, Settings

NAMES = [parameter.name for parameter in TABLE]


def test_names_are_unique_sorted_and_fit_mavlink():
    assert sorted(set(NAMES)) == NAMES
    assert max(map(len, NAMES)) <= 16


@pytest.mark.parametrize("parameter", TABLE, ids=NAMES)
def test_each_row_changes_its_setting_over_its_whole_range_and_nothing_else(parameter):
    parameters = ParameterSet(Settings())
    assert parameter.minimum <= parameters.get(parameter.name) <= parameter.maximum
    others = {name: parameters.get(name) for name in NAMES if name != parameter.name}
    for value in (parameter.minimum, parameter.maximum):
        parameters.set(parameter.name, value)
        assert parameters.get(parameter.name) == pytest.approx(value, rel=1e-12)
        # what the settings themselves allow is not narrower than what the table does
        assert msgspec.convert(msgspec.to_builtins(parameters.settings), Settings) == parameters.settings
    assert {name: parameters.get(name) for name in others} == others


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        ({"MPC_XYP": 1.0}, "there is no parameter 'MPC_XYP'"),
        ({"MPC_XY_P": 9.0}, "parameter MPC_XY_P = 9 is outside 0 .. 2 1/s"),
        ({"MPC_XY_P": float("nan")}, "parameter MPC_XY_P = nan is outside 0 .. 2 1/s"),
        ({"EKF2_REQ_NSATS": 6.5}, "parameter EKF2_REQ_NSATS = 6.5 is not a whole number"),
    ],
)
def test_wrong_overrides_are_one_line(overrides, line):
    with pytest.raises(ParameterError) as error:
        ParameterSet(Settings(), overrides)
    assert str(error.value) == line


def test_units_are_px4s():
    parameters = ParameterSet(Settings(), {"MPC_TILTMAX_AIR": 30.0, "EKF2_GPS_DELAY": 110.0})
    assert parameters.settings.control.position.tilt_max_rad == pytest.approx(0.5235987756)
    assert parameters.settings.estimation.gps_delay_us == 110_000
