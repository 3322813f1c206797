"""All wrong fields of a scenario are reported at once, each with its path and what would be right."""

import tomllib

import msgspec
import pytest
from paths import SCENARIOS

from harness.scenario.field_names import all_fields, allowed_values, nearest
from harness.scenario.scenario import Scenario, ScenarioError
from harness.scenario.scenario_file import load
from harness.scenario.validation_errors import MOST_PROBLEMS, InvalidTable, convert

ARTICLE = SCENARIOS / "article.toml"


def problems(text):
    with pytest.raises(InvalidTable) as caught:
        convert(tomllib.loads(text), Scenario, {})
    return caught.value.problems


def test_all_wrong_fields_are_in_one_report():
    found = problems("agents = 0\n[wind]\nmean_n = -1.0\n[radio]\nbandwidth_mhz = 30\nspeed = 1\n")
    paths = sorted(line.partition(":")[0] for line in found)
    assert paths == ["agents", "radio", "radio.bandwidth_mhz", "wind.mean_n"]


def test_the_report_counts_the_fields_and_has_a_line_for_each():
    with pytest.raises(ScenarioError) as caught:
        load(ARTICLE, ["agents=0", "wind.mean_n=-1", "run.seed=-1"])
    first, *others = str(caught.value).split("\n")
    assert first == f"{ARTICLE}: 3 fields are wrong:"
    assert {line.strip().partition(":")[0] for line in others} == {"agents", "wind.mean_n", "run.seed"}


def test_one_wrong_field_is_one_line():
    with pytest.raises(ScenarioError) as caught:
        load(ARTICLE, ["agents=0"])
    assert str(caught.value) == f"{ARTICLE}: agents: expected `int` >= 1"


def test_entries_of_arrays_keep_their_numbers():
    entry = '{kind = "gps_loss", uav = 0, start_s = -1.0}'
    fine = '{kind = "gps_loss", uav = 0, start_s = 1.0}'
    found = problems(f"agents = 2\nfaults = [{entry}, {fine}, {entry}, 3, {entry}]")
    assert sorted(line.partition(":")[0] for line in found) == [
        "faults[0].start_s", "faults[2].start_s", "faults[3]", "faults[4].start_s",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("assignment", "paths"),
    [
        ('formation.points_m=[[1,2,"x"],[1,2,"y"]]', ["formation.points_m[0][2]"]),
        ('formation.points_m=[[1,2,3],["x",2,3]]', ["formation.points_m[1][0]"]),
        (
            'radio.interferers=[{pos_ned_m=[1,2,"x"]},{pos_ned_m=[1,"y",3]}]',
            ["radio.interferers[0].pos_ned_m[2]", "radio.interferers[1].pos_ned_m[1]"],
        ),
        (
            'radio.interferers=[3,{pos_ned_m=[1,"y",3]}]',
            ["radio.interferers[0]", "radio.interferers[1].pos_ned_m[1]"],
        ),
    ],
)
def test_arrays_in_arrays_keep_their_numbers_and_lengths(assignment, paths):
    with pytest.raises(ScenarioError) as caught:
        load(ARTICLE, [assignment])
    for path in paths:
        assert f"{path}: expected" in str(caught.value)
    assert str(caught.value).count(": expected") == len(paths)


def test_wrong_values_of_parameters_are_all_named():
    found = problems('agents = 1\n[autopilot.params]\nMPC_XY_P = "x"\nMPC_Z_P = 1.0\nSENS_BARO_RATE = "y"')
    assert sorted(line.partition(":")[0] for line in found) == [
        "autopilot.params.MPC_XY_P", "autopilot.params.SENS_BARO_RATE",
    ]  # fmt: skip


def test_a_check_of_several_fields_is_no_consequence_of_a_removed_one():
    """With a wrong number of agents, the fault of UAV 5 says nothing."""
    found = problems('agents = "eight"\nfaults = [{kind = "gps_loss", uav = 5}]')
    assert [line.partition(":")[0] for line in found] == ["agents"]


def test_the_report_ends_after_some_fields():
    lines = "\n".join(f"unknown_{number} = 1" for number in range(MOST_PROBLEMS + 5))
    found = problems(lines)
    assert len(found) == MOST_PROBLEMS
    with pytest.raises(InvalidTable, match=f"{MOST_PROBLEMS} or more fields are wrong"):
        convert(tomllib.loads(lines), Scenario, {})


def test_the_table_itself_is_not_changed():
    table = tomllib.loads("agents = 0\n[wind]\nmean_n = -1.0\n")
    before = msgspec.json.encode(table)
    with pytest.raises(InvalidTable):
        convert(table, Scenario, {})
    assert msgspec.json.encode(table) == before


@pytest.mark.parametrize(
    ("override", "hint"),
    [
        ("radio.mcs=7", "radio: unknown key `mcs`; did you mean `radio.broadcast_mode`?"),
        ("radio.bandwith_mhz=40", "did you mean `radio.bandwidth_mhz`?"),
        ("wind.mean=3", "did you mean `wind.mean_n`?"),
        ("duration_s=3", "unknown key `duration_s`; did you mean `run.duration_s`?"),
        ("seed=3", "did you mean `run.seed`?"),
        ("uavs=3", "did you mean `agents`?"),
        ("run.qwertz=3", "run: unknown key `qwertz`; expected seed, duration_s, "),
    ],
)
def test_an_unknown_key_comes_with_the_field_that_was_probably_meant(override, hint):
    with pytest.raises(ScenarioError) as caught:
        load(ARTICLE, [override])
    assert hint in str(caught.value)


def test_enumerations_are_reported_with_their_values():
    with pytest.raises(ScenarioError) as caught:
        load(ARTICLE, ["onboard.ranging=sometimes"])
    text = str(caught.value)
    assert text.endswith(f"one of {', '.join(allowed_values(Scenario, 'onboard.ranging'))}")
    assert "scheduled" in text


@pytest.mark.parametrize(
    "path",
    [
        path
        for path in all_fields(Scenario)
        if allowed_values(Scenario, path) and not path.startswith("formation.motion.")
    ],
)
def test_every_enumeration_names_its_values(path):
    values = allowed_values(Scenario, path)
    wrong = "9999" if all(value.isdecimal() for value in values) else "no_such_value"
    with pytest.raises(ScenarioError) as caught:
        load(ARTICLE, [f"{path}={wrong}"])
    assert all(value in str(caught.value) for value in values)


LONG_NAMES = [path for path in all_fields(Scenario) if len(path.rpartition(".")[2]) >= 6]


def without_third_letter(path):
    table, _, name = path.rpartition(".")
    return table, name[:2] + name[3:]


@pytest.mark.parametrize("path", LONG_NAMES)
def test_a_name_with_one_letter_missing_leads_to_the_field(path):
    assert nearest(Scenario, *without_third_letter(path)) == path


@pytest.mark.parametrize(
    ("table", "key"), [("wind", "n"), ("antenna", "rate"), ("radio", "count"), ("sensors.gps", "model")]
)
def test_a_word_of_another_table_leads_nowhere(table, key):
    assert nearest(Scenario, table, key) is None


def test_the_fields_of_a_fault_are_those_of_its_kind():
    (line,) = problems('agents = 1\nfaults = [{kind = "gps_loss", uav = 0, attenuation_db = 3}]')
    assert line.startswith("faults[0]: unknown key `attenuation_db`; expected uav, start_s, duration_s")
    assert "motor" not in line


@pytest.mark.parametrize(("value", "text"), [("medum", "invalid enum value 'medum'"), ("3", "got `int`")])
def test_values_of_a_field_with_words_and_booleans_are_all_named(value, text):
    with pytest.raises(ScenarioError) as caught:
        load(ARTICLE, [f"radio.capture={value}"])
    assert text in str(caught.value)
    assert str(caught.value).endswith("expected one of medium, receivers, true, false")


@pytest.mark.parametrize("content", ["", "# only a comment\n", "\n\n"])
def test_an_empty_scenario_is_refused(tmp_path, content):
    file = tmp_path / "empty.toml"
    file.write_text(content)
    with pytest.raises(ScenarioError, match=r"empty\.toml: it has no settings"):
        load(file)


def test_a_folder_is_refused_in_words(tmp_path):
    with pytest.raises(ScenarioError, match="it is a folder, not a file"):
        load(tmp_path)
