"""pytest plugin: the `swarm` fixture flies real multi-process swarms in tests.

Every test run with coflight installed loads this module, so it imports little beside pytest until a test
requests a swarm. A test calls the fixture once per swarm:

    def test_hover(swarm):
        flight = swarm("scenarios/article.toml", agents=3, overrides=["formation.columns=2"])
        flight.run_until_formed(timeout_s=60)

In addition to `harness.launch.swarm.Swarm` it sets a wall-time limit, adds the ends of the processes' logs to
the report of a failed test, and fails the test if a process or a bound port is left behind.
"""

import contextlib
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from harness.scenario import packaged

if TYPE_CHECKING:
    from harness.launch.swarm import Swarm
    from harness.scenario.scenario import Scenario

DEADLINE_S = 120.0
"""Default wall-time limit of a swarm of the fixture."""
LOG_TAIL_LINES = 20

SwarmFactory = Callable[..., "Swarm"]
_flown: "pytest.StashKey[list[Swarm]]" = pytest.StashKey()


@pytest.fixture
def swarm(request: pytest.FixtureRequest) -> Generator[SwarmFactory, None, None]:
    """Provide a factory of running swarms: ``swarm(scenario, **options of Swarm)``.

    A relative path refers to pytest's root directory; a packaged scenario may be named. ``wall_limit_s`` is
    `DEADLINE_S` by default. All swarms are stopped when the test ends, and it fails if one of them left a
    process or a port behind.
    """
    flown: list[Swarm] = request.node.stash.setdefault(_flown, [])

    def start(scenario: "str | Path | Scenario", **options: Any) -> "Swarm":  # noqa: ANN401  Swarm's own signature checks them
        from harness.launch.swarm import Swarm  # noqa: PLC0415  slow to import, and most tests need no swarm

        if isinstance(scenario, str | Path):
            scenario = packaged.find(scenario, root=request.config.rootpath)
        options.setdefault("wall_limit_s", DEADLINE_S)
        flight = Swarm(scenario, **options)
        flown.append(flight)
        flight.start()
        return flight

    with contextlib.ExitStack() as stack:  # stops all, even if one raises
        yield start
        for flight in flown:
            stack.callback(flight.stop)
    left = [line for flight in flown for line in flight.leftovers()]
    if left:
        pytest.fail("the swarm left behind: " + "; ".join(left), pytrace=False)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the ends of the processes' logs to the report of a failed test."""
    report = yield
    if report.failed:
        for flight in item.stash.get(_flown, []):
            for name, tail in flight.log_tails(LOG_TAIL_LINES).items():
                if tail:
                    report.sections.append((f"log of {name}", tail))
    return report
