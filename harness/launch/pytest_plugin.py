"""pytest plugin: the `swarm` fixture flies real multi-process swarms in tests.

Every test run with coflight installed loads this module, so it imports little beside pytest until a test
requests a swarm. A test calls the fixture once per swarm:

    def test_hover(swarm):
        flight = swarm("scenarios/article.toml", agents=3, overrides=["formation.columns=2"])
        flight.run_until_formed(timeout_s=60)

In addition to `harness.launch.swarm.Swarm` it compiles the kernels before the first test, sets a wall-time
limit, and fails the test if a process or a bound port is left behind. A failed test keeps the run folder of
each swarm, with tables; its report names the folder and shows the last events and the ends of the logs.
Options of the command line and of ini files are in the tutorial "A test of your own".
"""

import os
from collections.abc import Callable, Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from foundation.kernels import cache_folder
from foundation.kernels.cache_trust import UntrustedCache
from harness.launch import pytest_folders, pytest_settings
from harness.launch.pytest_settings import Settings
from harness.scenario import packaged

if TYPE_CHECKING:
    from harness.launch.pytest_flights import Flights
    from harness.launch.swarm import Swarm
    from harness.scenario.scenario import Scenario

PROPERTY = "coflight_run"
"""Name of the property of a test's report that holds the path of a kept run folder."""

SwarmFactory = Callable[..., "Swarm"]
_settings: pytest.StashKey[Settings] = pytest.StashKey()
_flights: "pytest.StashKey[Flights]" = pytest.StashKey()
_unsettled: "pytest.StashKey[dict[str, Flights]]" = pytest.StashKey()
"""Of the running tests, by node id."""
_interrupted: pytest.StashKey[list[tuple[str, Path]]] = pytest.StashKey()
"""Node ids and kept folders of tests that were interrupted."""
_compile_error: pytest.StashKey[str | None] = pytest.StashKey()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the options."""
    pytest_settings.add_options(parser)


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests() -> None:
    """Set the cache folder of kernels before a conftest.py or a test imports Numba, which reads it once."""
    try:
        os.environ.update(cache_folder.environment())
    except UntrustedCache as error:
        raise pytest.UsageError(f"coflight: {error}") from None


def pytest_configure(config: pytest.Config) -> None:
    """Read the options. Raises UsageError for an invalid value."""
    config.stash[_settings] = pytest_settings.read(config)


@pytest.hookimpl(trylast=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile the kernels if a test uses a swarm: before any test, whose own time limit would pass."""
    config = session.config
    runs_no_test = config.getoption("collectonly") or config.getoption("setupplan", default=False)
    breaks_off = session.testsfailed and not config.getoption("continue_on_collection_errors")
    uses = any(coflight_settings.__name__ in getattr(item, "fixturenames", ()) for item in session.items)
    if uses and not runs_no_test and not breaks_off:
        _compile(config)


@pytest.fixture(scope="session")
def coflight_settings(request: pytest.FixtureRequest) -> Settings:
    """Provide the options of swarms, after the kernels are compiled."""
    error = _compile(request.config)
    if error is not None:
        pytest.fail(error, pytrace=False)
    return request.config.stash[_settings]


@pytest.fixture
def swarm(request: pytest.FixtureRequest, coflight_settings: Settings) -> Generator[SwarmFactory, None, None]:
    """Provide a factory of running swarms: ``swarm(scenario, **options of Swarm)``.

    A relative path refers to pytest's root directory; a packaged scenario may be named. ``wall_limit_s`` is
    that of ``--coflight-wall-limit`` by default. ``processes="one"`` or ``"many"`` selects `OneProcessSwarm`
    or `Swarm` instead of ``--coflight-processes``. All swarms are stopped when the test ends, and it fails if
    one of them left a process or a port behind.
    """
    from harness.launch.pytest_flights import Flights  # noqa: PLC0415  slow to import, and most tests need no swarm

    item, config = request.node, request.config
    flights = Flights(coflight_settings, item.nodeid, invocation_dir=config.invocation_params.dir)
    item.stash[_flights] = flights
    config.stash.setdefault(_unsettled, {})[item.nodeid] = flights

    def start(
        scenario: "str | Path | Scenario",
        *,
        processes: str | None = None,
        **options: Any,  # noqa: ANN401  Swarm's own signature checks them
    ) -> "Swarm":
        __tracebackhide__ = True
        if isinstance(scenario, str | Path):
            scenario = packaged.find(scenario, root=config.rootpath)
        return flights.start(scenario, processes=processes, options=options)

    yield start
    left = flights.stop()
    if left or flights.is_failed or coflight_settings.keep_all:
        flights.write_tables()
    if left:
        pytest.fail("the swarm left behind: " + "; ".join(left), pytrace=False)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add folder, events and logs to the first report of a failure; keep or remove the folders at the end."""
    report = yield
    flights = item.stash.get(_flights, None)
    if flights is None:
        return report
    if report.failed and not flights.is_failed:
        flights.is_failed = True
        report.sections += flights.sections()
    if report.when == "teardown":
        keep = flights.is_failed or item.config.stash[_settings].keep_all
        report.user_properties += [(PROPERTY, os.fspath(path)) for path in flights.settle(keep=keep)]
        if flights.problems:  # pytest shows sections of a passed teardown by their title
            report.sections.append(("run after teardown", "\n".join(flights.problems)))
        del item.stash[_flights], item.config.stash[_unsettled][item.nodeid]
    return report


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keep the folders of tests that were interrupted; remove the folder of all runs if it holds none."""
    stash = session.config.stash
    stash[_interrupted] = [
        (nodeid, path)
        for nodeid, flights in stash.get(_unsettled, {}).items()
        for path in flights.settle(keep=True)
    ]
    if pytest_settings.worker(session.config) is None:
        pytest_folders.tidy(stash[_settings].out)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """List the kept run folders."""
    kept = [
        (report.nodeid, Path(str(value)))
        for reports in terminalreporter.stats.values()
        for report in reports
        for name, value in getattr(report, "user_properties", ())
        if name == PROPERTY
    ]
    kept = sorted({*kept, *config.stash.get(_interrupted, [])})
    if kept:
        terminalreporter.section("coflight run folders")
    for nodeid, path in kept:
        has_flown = all((path / name).exists() for name in ("manifest.json", "events.jsonl"))
        command = "coflight report " if has_flown else "without tables: "
        terminalreporter.line(
            f"{nodeid}: {command}{pytest_folders.shown(path, config.invocation_params.dir)}"
        )


def _compile(config: pytest.Config) -> str | None:
    """Compile all missing kernels once per session; returns the line of an error."""
    if _compile_error not in config.stash:
        from harness.launch import pytest_kernels  # noqa: PLC0415  slow to import, and most sessions fly no swarm

        config.stash[_compile_error] = pytest_kernels.compile_missing(config)
    return config.stash[_compile_error]
