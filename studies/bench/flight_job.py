"""What the bench tells the launcher of a flight that is measured, and what it answers."""

from msgspec import Struct

from harness.launch.processes import PHYSICS, PREFORK, RADIO
from harness.launch.profiling import VEHICLES, KindProfile

LAUNCHER = "launcher"
KINDS = (PHYSICS, RADIO, VEHICLES, PREFORK, LAUNCHER)
"""Of processes, in the order in which they are told; others, if there are any, come after them."""


class FlightJob(Struct, frozen=True, kw_only=True):
    """What is to be flown."""

    scenario: str
    agents: int
    seed: int
    duration_s: float
    """After the formation is reached"""
    folder: str
    """For what the flight writes; not there yet"""
    wall_launched_s: float
    """By `time.monotonic`, which all processes of a machine share"""
    profile_from_s: float | None = None


class Span(Struct, frozen=True, kw_only=True):
    """A stretch of a flight."""

    simulated_s: float
    wall_s: float
    cpu_s_per_simulated_s: dict[str, float]
    """By kind of process"""
    other_processors: float
    """That were busy with what is not of the flight, on average: 0 on a quiet machine"""

    @property
    def real_time_factor(self) -> float:
        """Simulated against wall time."""
        return self.simulated_s / self.wall_s


class FlightCost(Struct, frozen=True, kw_only=True):
    """What the flight cost."""

    startup_s: float
    """From the launch to the end of the first step"""
    formed_s: float | None
    """Simulated time at which the formation was reached; None: it was not in time"""
    whole: Span
    """From the first step on"""
    steady: Span
    """From the formation, or the limit for it, on"""
    uss_mb: dict[str, float]
    """Memory that goes with the process, by kind, a process's median, at the end"""
    pss_mb: float
    """Memory of all processes, what they share counted once, or not at all where the system does not tell"""
    profile: dict[str, KindProfile]
