"""The warning before a flight whose formation ranging does not determine, and formations that it determines.

All packaged scenarios and all examples of the documentation are of the second kind.
"""

import ast
import re
import shlex
from itertools import pairwise

import pytest
from paths import ROOT

from harness.scenario import packaged
from harness.scenario.localisability import PAGE, predict, warning
from harness.scenario.scenario_file import load

ADVISED = [
    *sorted((ROOT / "docs").rglob("*.md")),
    *(ROOT / "harness" / "launch" / name for name in ("swarm.py", "one_process.py", "pytest_plugin.py")),
    ROOT / "README.md",
    ROOT / "coflight" / "__init__.py",
]
COMMAND = re.compile(
    r"^ {4}(?:\S*/)?(?:coflight (?:fly|hold)|launch_swarm\.py|python \S*launch_swarm\.py) (.+)$", re.MULTILINE
)
CALL = re.compile(
    r"\b(?:Swarm|OneProcessSwarm|swarm)\((?:SCENARIO|\"[^\"]+\"),[^\n]*?\)(?= as |$)", re.MULTILINE
)
OPTIONS = {"--agents": "agents={}", "--set": "{}"}


def commands(text):
    """Yield the scenarios that command lines of a text fly, with their overrides."""
    for line in COMMAND.findall(text):
        words = shlex.split(line, comments=True)
        overrides = [OPTIONS[a].format(b) for a, b in pairwise(words) if a in OPTIONS]
        if not words[0].startswith("["):  # a synopsis
            yield words[0], overrides


def calls(text):
    """Yield the scenarios that Python calls of a text fly, with their overrides; constants are looked up."""
    constants = {
        name: ast.literal_eval(value)
        for name, value in re.findall(r"^([A-Z]+) = ([\"\[].*)$", text, re.MULTILINE)
    }
    for match in CALL.findall(text):
        call = ast.parse(match, mode="eval").body
        names = {argument.arg: argument.value for argument in call.keywords}
        given = {
            name: eval(compile(ast.Expression(value), "example", "eval"), {}, constants)  # noqa: S307  the repository's own text
            for name, value in names.items()
            if name in {"agents", "overrides"}
        }
        agents = [f"agents={given['agents']}"] if "agents" in given else []
        scenario = eval(compile(ast.Expression(call.args[0]), "example", "eval"), {}, constants)  # noqa: S307
        yield scenario, [*agents, *given.get("overrides", ())]


def examples():
    for path in ADVISED:
        text = path.read_text(encoding="utf-8")
        shown = re.findall(r"^[^\n]*`(\S+\.toml)`.*:$", text, re.MULTILINE)
        for scenario, overrides in [*commands(text), *calls(text)]:
            if scenario in shown:  # a file that the page shows: it flies an application of its own
                continue
            yield pytest.param(scenario, overrides, id=f"{path.name}: {scenario} {' '.join(overrides)}")


@pytest.mark.parametrize("name", [name for name in packaged.names() if "/" not in name])
def test_ranging_determines_every_packaged_scenario(name):
    assert predict(load(name)).localises
    assert warning(load(name)) is None


@pytest.mark.parametrize(("scenario", "overrides"), list(examples()))
def test_ranging_determines_every_formation_of_an_example(scenario, overrides):
    path = packaged.find(scenario, root=ROOT)
    assert predict(load(path, overrides)).localises


def test_the_examples_are_found():
    found = [example.values for example in examples()]
    assert ("article", ["agents=3", "formation.columns=2"]) in found  # a command and a docstring
    assert ("scenarios/article.toml", ["agents=3", "formation.columns=2", "wind.mean_n=2"]) in found
    assert len(found) >= 10


@pytest.mark.parametrize("agents", [3, 4])
def test_a_line_of_the_articles_grid_is_warned_of_with_what_to_do(agents):
    text = warning(load("article", [f"agents={agents}"]))
    assert "\n" not in text
    assert f"the places of all {agents} UAVs lie on a line" in text
    assert "as inaccurate as GPS (about 1.5 m)" in text
    assert "take-off waits up to 10 s" in text
    assert "use --set formation.columns=2 or --agents 5 or " in text
    assert PAGE in text


@pytest.mark.parametrize(
    ("scenario", "overrides", "what"),
    [
        ("article", ["agents=3"], "on a line"),
        ("article", ["agents=5", "formation.columns=5"], "on a line"),
        ("article", ["agents=4", "formation.shape=line"], "on a line"),
        ("swarm64", ["agents=8"], "on a line"),
        ("article", ["agents=4", "onboard.ranging=scheduled"], "on a line"),
        (
            "article",
            ["agents=3", "formation.shape=file", "formation.points_m=[[0,0,0],[8,0.2,0],[16,0,0]]"],
            "within 0.13 m of a line",
        ),
        ("article", ["onboard.neighbours=2"], "UAV 1 and its 3 neighbours"),
        ("article", ["formation.shape=ring", "onboard.range_floor_std_m=1"], "0.71 m of standard error"),
    ],
)  # fmt: skip
def test_ranging_determines_the_formation_with_each_remedy(scenario, overrides, what):
    text = warning(load(scenario, overrides))
    assert what in text
    remedies = re.findall(r"--(?:set )?(\S+?)[ =](\S+)(?= or |;| \()", text.partition("; use ")[2])
    assert ("onboard.localisation", "gps") in remedies
    assert len(remedies) > 1
    for path, value in remedies:
        repaired = load(scenario, [*overrides, f"{path}={value}"])
        assert warning(repaired) is None
        assert predict(repaired).localises or path == "onboard.localisation"


@pytest.mark.parametrize(
    "setting",
    [
        "onboard.localisation=gps", "onboard.localisation=truth", "onboard.hold=true",
        "onboard.enabled=false",
        "formation.columns=2", "formation.shape=ring", "agents=1", "agents=2", "agents=5", "agents=8",
        "onboard.gps_bias_std_m=0.2",  # GPS alone is accurate enough
    ],
)  # fmt: skip
def test_nothing_is_said_where_take_off_does_not_wait(setting):
    assert warning(load("article", ["agents=3"])) is not None
    assert warning(load("article", ["agents=3", setting])) is None


def test_options_with_which_the_scenario_is_invalid_are_not_advised():
    """Rows 0.5 m apart are too near each other."""
    text = warning(load("article", ["agents=3", "formation.endfire_spacing_lambda=0.05"]))
    assert "use --set onboard.localisation=gps (" in text


def test_a_star_of_distances_determines_no_shape():
    """The UAV in the middle is the only neighbour of each of the others."""
    star = "[[0,0,0],[20,0,0],[-20,0,0],[0,20,0],[0,-20,0]]"
    places = ["agents=5", "formation.shape=file", f"formation.points_m={star}"]
    assert predict(load("article", places)).localises
    text = warning(load("article", [*places, "onboard.neighbours=1"]))
    assert "the distances between all 5 UAVs, each with " in text
    assert "determine their shape to 1.16 m only" in text


def test_a_triangle_with_inaccurate_distances_is_not_called_a_line():
    triangle = ["agents=3", "formation.columns=2", "radio.ftm.round_trip_std_ps=20000"]
    text = warning(load("article", triangle))
    assert "each with 0.80 m of standard error, determine their shape to 0.57 m only" in text
    assert "line:" not in text


def test_the_page_of_the_warning_exists():
    path, _, anchor = PAGE.partition("#")
    headings = re.findall(r"^#+ (.+)$", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE)
    assert anchor in {heading.lower().replace(" ", "-") for heading in headings}
