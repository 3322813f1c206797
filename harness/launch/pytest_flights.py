"""The swarms of one test: their start and end, their part of the report, their folders."""

import contextlib
import warnings
from pathlib import Path
from typing import Any

from foundation.system_error import described
from harness.cli.progress import describe
from harness.launch import pytest_folders
from harness.launch.pytest_settings import Settings
from harness.launch.swarm import SetupError, Swarm, SwarmError
from harness.scenario.scenario import Scenario, ScenarioError

LOG_LINES, EVENT_LINES = 20, 12
"""Last lines that a report shows of each log, and of the events of each swarm."""
MANY = 'fly it in many processes: --coflight-processes many, or swarm(..., processes="many")'


class _Flown:
    """A swarm, once it is made, and its folder; None: the test has named one."""

    def __init__(self, place: pytest_folders.RunPlace | None) -> None:
        self.place = place
        self.swarm: Swarm | None = None
        self.is_started = False

    @property
    def path(self) -> Path | None:
        """Folder with the run; None if nothing was written."""
        if self.place is not None:
            return None if self.place.is_empty else self.place.path
        return self.swarm.path if self.swarm is not None and self.swarm.path.exists() else None


class Flights:
    """The swarms of one test. Relative paths are shown below ``invocation_dir``."""

    def __init__(self, settings: Settings, nodeid: str, *, invocation_dir: Path) -> None:
        self._settings = settings
        self._nodeid = nodeid
        self._invocation_dir = invocation_dir
        self._flown: list[_Flown] = []
        self.is_failed = False
        """Whether the test has failed."""
        self.problems: list[str] = []
        """A line for each run folder without tables."""

    def start(
        self, scenario: str | Path | Scenario, *, processes: str | None, options: dict[str, Any]
    ) -> Swarm:
        """Start a swarm with options of its class. Raises as `Swarm` and its ``start``.

        The report of an error has the line of the test and the text, not the lines in between.
        """
        __tracebackhide__ = True
        try:
            return self._start(scenario, processes=processes, options=options)
        except (ScenarioError, SwarmError) as error:
            raise error.with_traceback(None) from error.__cause__

    def _start(
        self, scenario: str | Path | Scenario, *, processes: str | None, options: dict[str, Any]
    ) -> Swarm:
        if processes not in {None, "one", "many"}:
            raise SetupError(f"processes {processes!r}: expected one or many")
        kind: type[Swarm] = Swarm
        if self._settings.one_process if processes is None else processes == "one":
            from harness.launch.one_process import OneProcessSwarm  # noqa: PLC0415  loads the physics

            kind = OneProcessSwarm
            _remove_unusable(options)
        options.setdefault("wall_limit_s", self._settings.wall_limit_s)
        place = None
        if options.get("out") is None:
            try:
                place = pytest_folders.claim(self._settings.out, self._nodeid)
            except OSError as error:
                raise SetupError(
                    f"{error.filename}: no folder for a run: {error.strerror}"
                    " (--coflight-out selects another place)"
                ) from None
            options["out"] = place.path
        flown = _Flown(place)
        self._flown.append(flown)
        flown.swarm = kind(scenario, **options)
        flown.swarm.start()
        flown.is_started = True
        return flown.swarm

    def stop(self) -> list[str]:
        """End all swarms; returns a line for each process or port that is left."""
        swarms = [flown.swarm for flown in self._flown if flown.swarm is not None]
        with contextlib.ExitStack() as stack:  # stops all, even if one raises
            for swarm in swarms:
                stack.callback(swarm.stop)
        return [line for swarm in swarms for line in swarm.leftovers()]

    def sections(self) -> list[tuple[str, str]]:
        """Return titles and texts for a report: folders, last events and ends of the logs."""
        found = []
        for number, flown in enumerate(self._flown, 1):
            if flown.swarm is None:
                continue
            which = f", swarm {number}" if len(self._flown) > 1 else ""
            found.append((f"run{which}", self._described(flown.swarm, flown.path)))
            tails = flown.swarm.log_tails(LOG_LINES)
            found += [(f"log of {name}{which}", tail) for name, tail in tails.items() if tail]
        return found

    def _described(self, swarm: Swarm, path: Path | None) -> str:
        lines = [] if path is None else [f"run folder: {self.shown(path)}"]
        try:
            events = [line for event in swarm.events if (line := describe(event)) is not None]
        except Exception as error:  # noqa: BLE001  of a test's own on_message: the test's failure is reported
            events = [f"not read: {described(error)}"]
        lines.append(f"simulated time: {swarm.simulated_s:.3f} s")
        lines.append(f"last events of {len(events)}:" if len(events) > EVENT_LINES else "events:")
        lines += [f"  {line}" for line in events[-EVENT_LINES:] or ["none"]]
        return "\n".join(lines)

    def write_tables(self) -> None:
        """Write tables and summary of each stopped run; stores `problems` instead of raising."""
        for flown in self._flown:
            if flown.swarm is None or not flown.is_started or flown.path is None:
                continue
            try:
                with warnings.catch_warnings():  # a test session may turn warnings of libraries into errors
                    warnings.simplefilter("ignore")
                    flown.swarm.summary(draw=False)
            except Exception as error:  # noqa: BLE001  the failure of the test has precedence
                self.problems.append(f"no tables in {self.shown(flown.path)}: {described(error)}")

    def settle(self, *, keep: bool) -> list[Path]:
        """Keep or remove the folders of the stopped swarms; returns those that are kept."""
        kept = []
        for flown in self._flown:
            path = flown.path if keep else None
            if path is not None:
                kept.append(path)
            if flown.place is not None:
                (flown.place.remove if path is None else flown.place.keep)()
        self._flown.clear()
        return kept

    def shown(self, path: Path) -> str:
        """Return the path for a user: relative if it is below the working folder."""
        return pytest_folders.shown(path, self._invocation_dir)


def _remove_unusable(options: dict[str, Any]) -> None:
    """Remove the options that only a swarm of many processes has. Raises SetupError for one in use."""
    if options.pop("ports", "free") != "free" or options.pop("port_offset", 0):
        raise SetupError(f"ports: a swarm of one process opens no port for connections from outside; {MANY}")
    if options.pop("profile_from_s", None) is not None:
        raise SetupError(f"profile_from_s: a swarm of one process has no processes to profile; {MANY}")
