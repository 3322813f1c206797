"""What phases of the formation application mean in a `VehicleTruth`."""

from autopilot.onboard.app import OnboardApp
from harness.simulator.application_status import ApplicationStatus

LAYOUT = OnboardApp.reports.layout()


def standing(phase: str) -> dict[str, object]:
    """Return the fields ``phase``, ``aim`` and ``is_placed`` for the name of a phase; empty: unknown."""
    status = ApplicationStatus(LAYOUT)
    status.phase = {name: number for number, name in LAYOUT.phases.items()}.get(phase)
    return {"phase": phase, "aim": status.aim, "is_placed": status.is_placed}
