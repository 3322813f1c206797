"""The task of a worker, one run of a campaign, and the result of a failed run."""

from msgspec import Struct

from harness.campaign.store import FAILED, Flown
from harness.scenario.scenario import Scenario


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


def failed(task: Task, reason: str) -> Flown:
    """Return the result of a failed run."""
    return Flown(digest=task.digest, status=FAILED, reason=reason, settings=task.settings)
