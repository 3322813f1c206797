"""Campaign files: their runs, and errors in one line before the first flight."""

import itertools
import json
import time
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paths import ROOT

from foundation import exit_status
from harness.campaign import Campaign, CampaignError, Case, load, run
from harness.campaign.definition import expand
from harness.campaign.values import MOST_VALUES, flat, spread, toml_text
from harness.cli import campaign as cli
from harness.scenario.scenario_file import load as load_scenario

ARTICLE = ROOT / "scenarios" / "article.toml"


def write(tmp_path, text):
    path = tmp_path / "campaign.toml"
    path.write_text(f'scenario = "{ARTICLE}"\n{text}')
    return path


def refused(tmp_path, text, *overrides):
    """Return the error line of an invalid campaign."""
    path = write(tmp_path, text)
    with pytest.raises(CampaignError) as caught:
        expand(load(path, overrides), state="")
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith(f"{path}: ")
    return line.removeprefix(f"{path}: ")


# ---- values


tables = st.recursive(
    st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(exclude_categories=["Cs"])),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text(st.characters(exclude_categories=["Cs"])), inner, max_size=3)
    ),
    max_leaves=8,
)


@given(value=tables)
def test_toml_text_is_read_back_unchanged(value):
    assert tomllib.loads(f"value = {toml_text(value)}")["value"] == value


def test_all_forms_of_nesting_give_the_same_paths():
    texts = ("wind.mean_n = 2", '"wind.mean_n" = 2', "wind = {mean_n = 2}", "[wind]\nmean_n = 2")
    assert {tuple(flat(tomllib.loads(text))) for text in texts} == {(("wind.mean_n", 2),)}


@given(
    first=st.integers(-50, 50), steps=st.integers(0, 40), step=st.sampled_from(["0.1", "0.3", "2.5", "-0.7"])
)
def test_steps_are_exact_decimal_numbers(first, steps, step):
    """Sums of binary fractions would give 0.30000000000000004 and omit the last value."""
    size = round(float(step) * 10)
    last = (10 * first + size * steps) / 10
    values = spread("x", {"from": float(first), "to": last, "step": float(step)})
    assert values == tuple((10 * first + size * k) / 10 for k in range(steps + 1))


def test_ranges_of_whole_numbers_are_whole_and_include_their_end():
    assert spread("x", {"from": 2, "to": 9, "step": 3}) == (2, 5, 8)
    assert spread("x", {"from": 1, "to": 4, "count": 4}) == (1, 2, 3, 4)
    assert spread("x", {"from": 5.0, "to": 20.0, "count": 3}) == (5.0, 12.5, 20.0)
    assert [type(value) for value in spread("x", {"from": 0, "to": 1, "count": 3})] == [float] * 3


# ---- runs


def test_runs_are_every_case_with_every_value_and_every_seed_in_the_files_order(tmp_path):
    path = write(
        tmp_path,
        """seeds = [7, 3]
        [set]
        agents = 4
        run.duration_s = 5.0
        [[cases]]
        name = "lying"
        faults = [{kind = "ranging_bias", uav = 1, offset_m = 5.0}]
        [[cases]]
        name = "calm"
        run.duration_s = 6.0
        [sweep]
        wind.mean_n = [5, 0]
        antenna.wavelength_m = {from = 10.0, to = 11.0, count = 2}
        """,
    )
    runs = expand(load(path, ["formation.columns=2"]), state="")
    expected = list(itertools.product(("lying", "calm"), (5, 0), (10.0, 11.0), (7, 3)))
    assert [(run.case, *run.swept, run.seed) for run in runs] == expected
    for each in runs:
        scenario = each.scenario
        values = scenario.wind.mean_n, scenario.antenna.wavelength_m, scenario.run.seed
        assert values == (*each.swept, each.seed)
        assert (scenario.agents, scenario.formation.columns) == (4, 2)
        assert scenario.run.duration_s == (5.0 if each.case == "lying" else 6.0)  # a case overrides [set]
        assert len(scenario.faults) == (each.case == "lying")
        assert load_scenario(ARTICLE, [*each.settings, f"run.seed={each.seed}"]) == scenario
    assert len({run.digest for run in runs}) == len(runs)


def test_a_digest_depends_on_scenario_seed_and_sources_only():
    def digests(state="s", **changed):
        campaign = Campaign(**{"name": "one", "scenario": ARTICLE, "seeds": (1, 2)} | changed)
        return [run.digest for run in expand(campaign, state=state)]

    first = digests()
    assert digests(name="two", keep=("gains",), fixed={"wind.mean_n": 5.0}) == first  # the article's value
    assert digests(seeds=(2, 1)) == first[::-1]
    assert not set(first) & set(digests(state="t"))
    assert not set(first) & set(digests(overrides=("wind.mean_n=4",)))
    twice = digests(cases=(Case(name="a"), Case(name="b", settings={"agents": 8})))
    assert twice == [*first, *first]


@pytest.mark.parametrize(
    "path", sorted((ROOT / "scenarios" / "campaigns").glob("*.toml")), ids=lambda p: p.stem
)
def test_the_shipped_campaigns_are_valid(path):
    assert expand(load(path), state="")


def test_a_program_may_use_numpys_values_nested_tables_and_any_list(tmp_path):
    """A program's forms give the same runs as the file."""
    path = write(
        tmp_path,
        """seeds = [3, 4]
        [set]
        wind.gust_rms_fraction = 0.5
        [[cases]]
        name = "a"
        agents = 4
        [sweep]
        wind.mean_n = [0.0, 2.5]
        antenna.wavelength_m = [10.0, 11.0, 12.0]
        """,
    )
    given = Campaign(
        name="campaign",
        scenario=str(ARTICLE),
        seeds=np.arange(3, 5),
        fixed={"wind": {"gust_rms_fraction": np.float32(0.5)}},
        cases=[Case(name="a", settings={"agents": np.int64(4)})],
        sweep={
            "wind": {"mean_n": (np.float64(0.0), np.float64(2.5))},
            "antenna.wavelength_m": np.linspace(10.0, 12.0, 3),
        },
    )
    runs = expand(given, state="")
    assert runs == expand(load(path), state="")
    assert {type(value) for run in runs for value in (*run.swept, run.seed)} == {float, int}
    flags = Campaign(name="b", scenario=ARTICLE, seeds=range(1), sweep={"x": (np.True_, np.str_("y"))})
    assert [type(value) for value in flags.sweep["x"]] == [bool, str]


# ---- errors


@pytest.mark.parametrize(
    ("made", "line"),
    [
        ({"seeds": True}, "seeds: expected `array`, got `bool`"),
        ({"seeds": (True,)}, "seeds[0]: expected `int`, got `bool`"),
        ({"seeds": ("1",)}, "seeds[0]: expected `int`, got `str`"),
        ({"seeds": (1, -1)}, "seeds[1]: expected `int` >= 0"),
        ({"seeds": (2**70,)}, "seeds[0]: expected `int` <= 9223372036854775807"),
        ({"seeds": {1, 2}}, "seeds: a value of the kind set cannot be in a campaign"),
        ({"sweep": {"wind.mean_n": ()}}, "sweep.wind.mean_n: an empty list flies nothing"),
        ({"sweep": {"wind.mean_n": np.empty(0)}}, "sweep.wind.mean_n: an empty list flies nothing"),
        (
            {"sweep": {"onboard.localisation": "gps"}},
            "sweep.onboard.localisation: expected a list of values, ",
        ),
        ({"sweep": {"wind.mean_n": (1, 2, 1)}}, "sweep.wind.mean_n: 1 stands twice"),
        (
            {"sweep": {"wind.mean_n": (1, None)}},
            "sweep.wind.mean_n[1]: a value of the kind NoneType cannot be",
        ),
        ({"sweep": [1]}, "sweep: expected `object`, got `array`"),
        ({"fixed": {"wind": {}}}, "set.wind: an empty table sets nothing"),
        ({"cases": (Case(name=""),)}, "cases[0].name: expected a name"),
        ({"keep": "gains"}, "keep: expected `array`, got `str`"),
        ({"overrides": "agents=4"}, "overrides: expected `array`, got `str`"),
    ],
)
def test_a_campaign_of_a_program_is_validated_like_a_file(made, line):
    with pytest.raises(CampaignError) as caught:
        Campaign(**{"name": "one", "scenario": ARTICLE, "seeds": (1,)} | made)
    assert str(caught.value).startswith(f"campaign: {line}")


def test_long_sweeps_are_validated_fast():
    """Pairwise comparisons of MOST_VALUES would be 5e9 and take minutes."""
    values = tuple(range(MOST_VALUES))
    begin_s = time.process_time()
    assert Campaign(name="long", scenario=ARTICLE, seeds=(1,), sweep={"x": values}).sweep["x"] == values
    assert time.process_time() - begin_s < 10.0


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("seeds = 0", "seeds: expected `int` >= 1"),
        ("seeds = [1, 1]", "seeds: expected at least one, and none twice"),
        ("seeds = {from = 3, to = 2}", "seeds: expected at least one, and none twice"),
        ("seed = 3", "unknown key `seed`"),
        ('keep = ["gain"]', "keep: 'gain': expected some of gains, flight, radio, ftm, air"),
        ("[sweep]\nwind.mean_n = 3", "sweep.wind.mean_n: expected a list of values, "),
        ("[sweep]\nwind.mean_n = []", "sweep.wind.mean_n: an empty list flies nothing"),
        ("[sweep]\nwind.mean_n = [1, 2, 1]", "sweep.wind.mean_n: 1 stands twice"),
        ("[sweep]\nwind.mean_n = {from = 1, to = 2}", "sweep.wind.mean_n: expected {from=, to=, step=} or "),
        ("[sweep]\nwind.mean_n = {from = 1, too = 2}", "sweep.wind.mean_n: unknown key `too`; expected "),
        ("[sweep]\nwind.mean_n = {from = 1, to = 2, step = 0}", "sweep.wind.mean_n.step: 0 never"),
        ("[sweep]\nwind.mean_n = {from = 1, to = 2, step = -1}", "sweep.wind.mean_n.step: -1 never comes"),
        ("[sweep]\nwind.mean_n = {from = 1, to = 2, count = 1}", "sweep.wind.mean_n.count: 1: expected an"),
        ("[sweep]\nwind.mean_n = {from = 1, to = nan, count = 2}", "sweep.wind.mean_n.to: nan: expected a"),
        ("[sweep]\nwind.mean_n = {from = 0, to = 1, step = 1e-9}", "sweep.wind.mean_n: 1000000001 values; "),
        ("[sweep]\nrun.seed = [1, 2]", "sweep: run.seed: the seeds are set by `seeds` alone"),
        ("[set]\nrun.seed = 1", "set: run.seed: the seeds are set by `seeds` alone"),
        ("[set]\nwind = {}", "set.wind: an empty table sets nothing"),
        ('[set]\n"wind.mean_n" = 1\nwind.mean_n = 2', "set.wind.mean_n: stands twice"),
        ("[set]\nwind.mean_n = 1\n[sweep]\nwind.mean_n = [2]", "sweep: wind.mean_n: set sets wind.mean_n"),
        (
            '[[cases]]\nname = "a"\nfaults = []\n[sweep]\nfaults = [[]]',
            "sweep: faults: case 'a' sets faults",
        ),
        ("[[cases]]\nwind.mean_n = 1", "cases[0].name: expected a name"),
        ('[[cases]]\nname = "a"\n[[cases]]\nname = "a"', "cases: two are named 'a'"),
        # ... and by the scenario itself: case, swept values, and the field
        (
            "[sweep]\nwind.mean_n = [0, -1]",
            f"case 'campaign', wind.mean_n = -1: {ARTICLE}: wind.mean_n: expected",
        ),
        ('[[cases]]\nname = "a"\nwind.mean = 1', f"case 'a': {ARTICLE}: wind: unknown key `mean`"),
        ('[[cases]]\nname = "a"\nname.x = 1', "not TOML"),
        ("[set]\nagents.x = 1", "case 'campaign': agents.x=1: agents is a value, not a table"),
    ],
)  # fmt: skip
def test_a_wrong_campaign_is_an_error_line_with_file_case_and_field(tmp_path, text, line):
    assert refused(tmp_path, text).startswith(line)


def test_a_packaged_scenario_is_named_from_any_folder(tmp_path):
    path = tmp_path / "campaign.toml"
    path.write_text('scenario = "article"')
    assert load(path).scenario == ARTICLE


def test_an_override_has_precedence_over_the_file_but_not_over_compared_values(tmp_path):
    path = write(
        tmp_path, "[set]\nwind.mean_n = 1\n[[cases]]\nname = 'a'\nagents = 4\n[sweep]\nwind.gusts = [[]]"
    )
    (run,) = expand(load(path, ["wind.mean_n=2"]), state="")
    assert run.scenario.wind.mean_n == 2.0
    for override, where in (
        ("agents=8", "case 'a'"), ("wind.gusts=[]", "sweep"), ("wind={}", "sweep"), ("run.seed=2", "seeds")
    ):  # fmt: skip
        with pytest.raises(CampaignError, match=f"--set {override}: {where} sets ".replace("[]", r"\[\]")):
            load(path, [override])


def test_a_missing_or_invalid_file_is_one_line(tmp_path):
    with pytest.raises(CampaignError, match=r"nowhere\.toml: there is no such file; campaigns by name"):
        load(tmp_path / "nowhere.toml")
    missing = tmp_path / "campaign.toml"
    missing.write_text('scenario = "nowhere.toml"')
    with pytest.raises(
        CampaignError,
        match=r"campaign\.toml: case 'campaign': .*nowhere\.toml: there is no such file",
    ):
        expand(load(missing), state="")
    assert "not TOML" in refused(tmp_path, "seeds = ")


def test_a_dry_run_lists_the_runs_and_creates_nothing(tmp_path, capfd):
    path = write(tmp_path, "seeds = 2\n[sweep]\nwind.mean_n = [0, 5]")
    assert cli.main([str(path), "--out", str(tmp_path / "out"), "--dry-run", "--json"]) == exit_status.FINE
    plan = json.loads(capfd.readouterr().out)
    assert [(run["wind.mean_n"], run["seed"]) for run in plan["runs"]] == [(0, 1), (0, 2), (5, 1), (5, 2)]
    assert {run["status"] for run in plan["runs"]} == {"to be flown"}
    assert plan["to_be_flown"] == 4
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()
    assert cli.main([str(path), "--out", str(tmp_path / "out"), "--dry-run"]) == exit_status.FINE
    assert list((tmp_path / "out").iterdir()) == []
    capfd.readouterr()
    assert cli.main([str(path), "--set", "wind.mean_n=1"]) == exit_status.BAD_INPUT
    assert (
        capfd.readouterr().err
        == f"campaign: {path}: --set wind.mean_n=1: sweep sets wind.mean_n too; change it there\n"
    )
    with pytest.raises(CampaignError, match="nonsense: expected the address of a dask scheduler"):
        run(load(path), out=tmp_path / "out", scheduler="nonsense")
