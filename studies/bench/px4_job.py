"""Messages between the comparison with PX4s and the process that serves them as a bare simulator."""

from msgspec import Struct


class BareJob(Struct, frozen=True, kw_only=True):
    """Parameters of a measurement."""

    scenario: str
    settings: tuple[str, ...]
    """Settings of the scenario, ``section.key=value``: build, command and parameters of the PX4s"""
    agents: int
    duration_s: float
    """Simulated time that is measured"""
    folder: str
    """Folder for the PX4s' working folders and consoles"""
    flies: bool
    """Whether they hold a height in offboard mode; otherwise they stand disarmed"""
    yields: bool
    """Whether their threads are scheduled as in coflight's swarms"""


class BareCost(Struct, frozen=True, kw_only=True):
    """Costs of PX4s with a bare simulator."""

    real_time_factor: float
    px4_cpu_s_per_simulated_s: float
    """Of all PX4s together"""
    simulator_cpu_s_per_simulated_s: float
    late_answers: int
    """Steps that continued without a PX4's answer"""
    height_m: float
    """Lowest height at the end"""
