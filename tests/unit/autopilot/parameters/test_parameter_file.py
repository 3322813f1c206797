"""Parameter files: round trips to the last bit, other programs' files, and one-line errors. About 2 s."""

import math
import struct
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from autopilot.parameters import parameter_file
from autopilot.parameters.inert import STATED
from autopilot.parameters.parameter_file import (
    ParameterFileError,
    ParsedParameters,
    dumps,
    load,
    load_known,
    parse,
    save,
)
from autopilot.parameters.table import NOT_OVER, ROWS, TABLE, UNDER, ParameterSet, Settings

READ_ONLY = [row.name for row in STATED if row.read_only]
WRITTEN = [row for row in ROWS if row.name not in READ_ONLY]
REALS = [parameter for parameter in WRITTEN if not parameter.is_integer]
WHOLES = [parameter for parameter in WRITTEN if parameter.is_integer]


def within(parameter):
    """Strategy for the valid values of a parameter."""
    if parameter.is_integer:
        return st.integers(int(parameter.minimum), int(parameter.maximum)).map(float)
    return st.floats(parameter.minimum, parameter.maximum)


FEW = [row for row in STATED if row.name not in READ_ONLY][::12]
some_values = st.fixed_dictionaries({}, optional={p.name: within(p) for p in (*TABLE, *FEW)})


def in_order(values):
    """Whether every pair is in order, with defaults for parameters that are not in ``values``."""
    present = {
        name: ParameterSet(Settings()).get(name) for pair in NOT_OVER + UNDER for name in pair
    } | values
    return all(present[low] <= present[high] for low, high in NOT_OVER) and all(
        present[low] < present[high] for low, high in UNDER
    )


def line(name, value, kind="9", component=1):
    return f"1\t{component}\t{name}\t{value}\t{kind}\n"


@settings(max_examples=100, deadline=None)
@given(some_values)
def test_every_double_is_preserved(values):
    assert parse(dumps(values), "x") == ParsedParameters(values, {})


@settings(max_examples=100, deadline=None)
@given(some_values.filter(in_order))
def test_a_set_is_preserved_to_the_last_bit(values):
    """Conversion from degrees to radians and back alone would sometimes change the last bit."""
    parameters = ParameterSet(Settings(), values)
    text = dumps(parameter_file.values_of(parameters))
    again = ParameterSet(Settings(), parse(text, "x").values)
    assert (again.settings, again.stated) == (parameters.settings, parameters.stated)


def test_unchanged_parameters_are_written_too():
    parameters = ParameterSet(Settings(), {"MPC_XY_P": 0.5})
    assert list(parameter_file.values_of(parameters)) == [p.name for p in WRITTEN]


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(REALS), st.data())
def test_18_decimals_of_a_float32_are_read_as_its_shortest_decimal(parameter, data):
    """Ground stations print 0.95 as 0.949999988079071045."""
    shortest = float(str(np.float32(data.draw(within(parameter)))))
    assume(parameter.minimum <= shortest <= parameter.maximum)
    assume(shortest == 0.0 or abs(shortest) > 1e-9)  # otherwise fewer than nine significant digits remain
    printed = f"{struct.unpack('<f', struct.pack('<f', shortest))[0]:.18f}"
    assert parse(line(parameter.name, printed), "x").values == {parameter.name: shortest}


def test_the_format_is_qgroundcontrols():
    """Its loader expects lines of five fields between tabs, the last of which is the MAV_PARAM_TYPE."""
    text = dumps(
        {"EKF2_REQ_NSATS": 7.0, "MPC_XY_P": 0.95, "MPC_THR_MIN": 0.05, "MPC_XY_CRUISE": 5.0}, system_id=3
    )
    lines = [entry.split("\t") for entry in text.splitlines() if not entry.startswith("#")]
    assert lines == [
        ["3", "1", "EKF2_REQ_NSATS", "7", "6"],
        ["3", "1", "MPC_XY_P", "0.95", "9"],
        ["3", "1", "MPC_THR_MIN", "0.05", "9"],
        ["3", "1", "MPC_XY_CRUISE", "5", "9"],
    ]
    assert text.splitlines()[2] == "# Vehicle-Id Component-Id Name Value Type"


def test_comments_blank_lines_spaces_and_windows_line_ends_are_accepted():
    text = "\ufeff# made by hand\r\n\r\n  # more\r\n1 1  MPC_XY_P 0.5 9\r\n" + line(
        "EKF2_REQ_NSATS", "+8", "6"
    )
    assert parse(text, "x").values == {"MPC_XY_P": 0.5, "EKF2_REQ_NSATS": 8.0}


@dataclass
class Wrong:
    text: str
    reason: str


WRONG = (
    Wrong("1\t1\tMPC_XY_P\t0.5\n", "4 fields, not 5: vehicle, component, name, value, type"),
    Wrong(line("MPC_XY_P", "0,5"), "MPC_XY_P: '0,5' is not a number"),
    Wrong(line("MPC_XY_P", "nan"), "MPC_XY_P: 'nan' is not a number"),
    Wrong(line("MPC_XY_P", "1e999"), "parameter MPC_XY_P = inf is outside 0 .. 2 1/s"),
    Wrong(line("MPC_XY_P", "3"), "parameter MPC_XY_P = 3 is outside 0 .. 2 1/s"),
    Wrong(line("MPC_XY_P", "1_0"), "MPC_XY_P: '1_0' is not a number"),
    Wrong(line("MPC_XY_P", "1", "11"), "MPC_XY_P: type '11' is neither 6 (INT32) nor 9 (REAL32)"),
    Wrong(line("EKF2_REQ_NSATS", "6.0", "6"), "EKF2_REQ_NSATS: '6.0' is not an integer"),
    Wrong(line("EKF2_REQ_NSATS", "6.5"), "parameter EKF2_REQ_NSATS = 6.5 is not a whole number"),
    Wrong("-1\t1\tMPC_XY_P\t1\t9\n", "'-1' is not a vehicle id"),
    Wrong("1\tx\tMPC_XY_P\t1\t9\n", "'x' is not a component id"),
    Wrong(line("MPC_Z_P", "1") + line("MPC_Z_P", "1"), "MPC_Z_P was set already in line 2"),
)


@pytest.mark.parametrize("wrong", WRONG, ids=[wrong.reason for wrong in WRONG])
def test_an_error_is_one_line_with_file_and_line(wrong):
    text = "# a comment\n" + wrong.text
    with pytest.raises(ParameterFileError) as error:
        parse(text, "iris.params")
    assert str(error.value) == f"iris.params:{text.count(chr(10))}: {wrong.reason}"


@settings(max_examples=300, deadline=None)
@given(st.text(alphabet=st.sampled_from("1 69\t\n#.-eMPC_XYx"), max_size=60))
def test_any_text_is_parsed_or_refused_in_one_line(text):
    try:
        values, reason = parse(text, "x").values, ""
    except ParameterFileError as error:
        values, reason = {}, str(error)
    assert "\n" not in reason
    assert all(math.isfinite(value) for value in values.values())


def test_a_different_type_is_accepted_if_the_value_fits():
    """PX4 has integers for some parameters that are floats here: MPC_XY_P as INT32 1 is 1."""
    assert parse(line("MPC_XY_P", "1", "6"), "x").values == {"MPC_XY_P": 1.0}
    assert parse(line("EKF2_REQ_NSATS", "6.0", "9"), "x").values == {"EKF2_REQ_NSATS": 6.0}


def test_an_unknown_parameter_is_refused_by_load_and_reported_by_load_known(tmp_path):
    path = tmp_path / "px4.params"
    path.write_text(
        line("MPC_XY_P", "0.5") + line("MPC_XYP", "0.5") + line("MNT_MODE_IN", "-1", "6", 154),
        encoding="utf-8",
    )
    with pytest.raises(ParameterFileError) as error:
        load(path)
    assert str(error.value) == f"{path}:2: the autopilot has no parameter 'MPC_XYP'"
    assert load_known(path) == ParsedParameters({"MPC_XY_P": 0.5}, {"MPC_XYP": 2, "MNT_MODE_IN": 3})


def test_parameters_of_other_components_are_not_applied(tmp_path):
    path = tmp_path / "gimbal.params"
    path.write_text(line("MPC_XY_P", "0.5", component=154), encoding="utf-8")
    assert load_known(path).values == {}


def test_an_unreadable_file_is_a_one_line_error(tmp_path):
    with pytest.raises(ParameterFileError, match=r"absent\.params: there is no such file"):
        load(tmp_path / "absent.params")
    (tmp_path / "binary.params").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ParameterFileError, match=r"binary\.params: it is not text"):
        load(tmp_path / "binary.params")


def test_saved_values_are_loaded_again(tmp_path):
    path = tmp_path / "iris.params"
    parameters = ParameterSet(Settings(), {"MPC_XY_P": 1.0 / 3.0, "LNDMC_ROT_MAX": 33.3})
    for system_id in (1, 2):  # the second replaces the file
        save(path, parameters, system_id=system_id)
        saved = load(path)
        assert (saved["MPC_XY_P"], saved["LNDMC_ROT_MAX"]) == (1.0 / 3.0, 33.3)
        assert list(saved) == [p.name for p in WRITTEN]
    assert [entry.name for entry in tmp_path.iterdir()] == ["iris.params"]


def test_a_failed_save_leaves_the_old_file_and_no_temporary_one(tmp_path):
    path = tmp_path / "taken"
    path.mkdir()
    (path / "inside").write_text("x", encoding="utf-8")
    with pytest.raises(OSError):  # a folder is not replaced by a file
        save(path, ParameterSet(Settings()))
    assert sorted(entry.name for entry in tmp_path.rglob("*")) == ["inside", "taken"]


def test_the_table_has_both_types():
    assert REALS
    assert WHOLES


def test_read_only_parameters_are_not_read_from_a_file():
    """A station saves all listed parameters; one file serves every vehicle of a swarm."""
    assert "MAV_SYS_ID" in READ_ONLY
    assert parse(line("MAV_SYS_ID", "7", "6") + line("COM_RC_IN_MODE", "4", "6"), "x") == ParsedParameters(
        {"COM_RC_IN_MODE": 4.0}, {}
    )
