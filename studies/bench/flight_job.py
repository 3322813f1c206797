"""Messages between the benchmark and the launcher of a measured flight."""

from msgspec import Struct

from foundation.profiling.profiler import KindProfile
from harness.launch.process_commands import PHYSICS, PREFORK, RADIO
from harness.launch.profiling import VEHICLES

LAUNCHER = "launcher"
KINDS = (PHYSICS, RADIO, VEHICLES, PREFORK, LAUNCHER)
"""Kinds of processes in the order of the tables; others follow."""


class FlightJob(Struct, frozen=True, kw_only=True):
    """Parameters of a flight."""

    scenario: str
    agents: int
    seed: int
    duration_s: float
    """Simulated time in formation"""
    folder: str
    """Run folder, which must not exist"""
    wall_launched_s: float
    """By `time.monotonic`, which all processes of a machine share"""
    profile_from_s: float | None = None
    settings: tuple[str, ...] = ()
    """Settings of the scenario, ``section.key=value``"""


class Span(Struct, frozen=True, kw_only=True):
    """Costs in a part of a flight."""

    simulated_s: float
    wall_s: float
    cpu_s_per_simulated_s: dict[str, float]
    """By kind of process"""
    other_processors: float
    """Mean number of processors busy with other processes: 0 on an idle machine"""

    @property
    def real_time_factor(self) -> float:
        """Simulated against wall time."""
        return self.simulated_s / self.wall_s


class FlightCost(Struct, frozen=True, kw_only=True):
    """Costs of a flight."""

    startup_s: float
    """From the launch to the end of the first step"""
    formed_s: float | None
    """Simulated time at which the formation was reached; None if not in time"""
    whole: Span
    """From the first step on"""
    steady: Span
    """From the formation, or from its time limit on"""
    uss_mb: dict[str, float]
    """Unshared memory at the end, by kind, median over processes"""
    pss_mb: float
    """Memory of all processes, shared memory counted once, or not counted if the system has no PSS"""
    profile: dict[str, KindProfile]
