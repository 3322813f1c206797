"""One run of a campaign as its workers receive it, and the result of a run that failed."""

from msgspec import Struct

from harness.campaign.store import FAILED, Flown
from harness.scenario.scenario import Scenario


class Task(Struct, frozen=True, kw_only=True):
    """A run to be flown, as a worker is told."""

    digest: str
    state: str
    """Of the sources that shall fly it, ..."""
    state_bytes: str
    """... and of their bytes, for a worker that has the very same files"""
    scenario: Scenario
    settings: tuple[str, ...]
    keep: tuple[str, ...]


def failed(task: Task, reason: str) -> Flown:
    """Make what is written down of a run without numbers."""
    return Flown(digest=task.digest, status=FAILED, reason=reason, settings=task.settings)
