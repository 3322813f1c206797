"""Environments of small swarms for tests."""

from harness.env.client import env_scenario
from harness.env.settings import EnvSettings

ROW = ("formation.columns=1",)
PERIOD_S = 0.04


def small(agents=2, overrides=(), **settings):
    """Return the scenario of an environment with a row of UAVs, and its settings."""
    own = EnvSettings(**settings)
    changes = [*ROW, f"formation.rows={agents}", "formation.height_m=4", *overrides]
    return env_scenario("article", own, agents=agents, overrides=changes), own
