"""The user's code that a scenario names is imported when the scenario is read; an error is one line."""

import pytest
from paths import SCENARIOS

from harness.scenario.scenario import ScenarioError
from harness.scenario.scenario_file import load

ARTICLE = SCENARIOS / "article.toml"


def test_a_scenario_with_the_users_code_keeps_its_names_and_settings_for_each_vehicle():
    scenario = load(
        ARTICLE,
        [
            "autopilot.controller='user_extensions:CascadeAgain'",
            "autopilot.modes=['user_extensions:ClimbMode']",
            "autopilot.mode_settings={'user_extensions:ClimbMode'={climb_m_s=2}}",
        ],
    )
    for instance in (0, 7):
        autopilot = scenario.autopilot.for_uav(instance)
        assert autopilot.controller == "user_extensions:CascadeAgain"
        assert autopilot.modes == ("user_extensions:ClimbMode",)
        assert autopilot.mode_settings == {"user_extensions:ClimbMode": {"climb_m_s": 2}}


@pytest.mark.parametrize(
    ("setting", "line"),
    [
        ("autopilot.controller='user_extensions:Cascade'", "autopilot.controller: user_extensions ("),
        ("autopilot.services=['no_module:Service']", "autopilot.services[0]: no module no_module; "),
        ("autopilot.controller=3", "autopilot.controller: expected `str`, got `int`"),
        ("autopilot.modes=['a:B','c:D','e:F','g:H','i:J','k:L','m:N','o:P','q:R']", "autopilot.modes: "),
    ],
)
def test_code_that_cannot_be_used_is_one_line_with_file_and_field(setting, line):
    with pytest.raises(ScenarioError) as caught:
        load(ARTICLE, [setting])
    assert str(caught.value).startswith(f"{ARTICLE}: {line}")
    assert "\n" not in str(caught.value)
