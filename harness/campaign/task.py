"""The task of a worker, one run of a campaign, and the result of a failed run."""

from typing import Any

from msgspec import Struct

from harness.campaign.store import FAILED, Flown
from harness.scenario.scenario import Scenario


class Flying(Struct, frozen=True):
    """The function that flies a run and returns its summary, with ``status`` and ``reason``."""

    function: str = "harness.launch.one_process:fly"
    """``module:name``; it is called with scenario, folder and the run's options"""
    measured_by: tuple[str, ...] = ()
    """Further modules that determine its summary, as paths from the root of the sources"""


PLAIN_FLIGHT = Flying()


class Task(Struct, frozen=True, kw_only=True):
    """A run for a worker."""

    digest: str
    state: str
    """Hash of the campaign's sources and libraries"""
    state_bytes: str
    """Hash of the sources' bytes, a faster check for identical files"""
    scenario: Scenario
    settings: tuple[str, ...]
    keep: tuple[str, ...]
    flying: Flying = PLAIN_FLIGHT
    options: dict[str, Any] = {}
    """Further arguments of the function that flies"""


def failed(task: Task, reason: str) -> Flown:
    """Return the result of a failed run."""
    return Flown(digest=task.digest, status=FAILED, reason=reason, settings=task.settings, state=task.state)
