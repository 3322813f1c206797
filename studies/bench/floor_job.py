"""What the bench tells the process that measures the floors, and what it answers; imports nothing else."""

from msgspec import Struct


class FloorJob(Struct, frozen=True, kw_only=True):
    """What is to be measured."""

    agents: int
    wall_s: float
    """For each of the two"""


class FloorSpeed(Struct, frozen=True, kw_only=True):
    """One floor's cost."""

    real_time_factor: float
    server_cpu_s_per_simulated_s: float
    vehicles_cpu_s_per_simulated_s: float
    """Of all together"""


class FloorCost(Struct, frozen=True, kw_only=True):
    """Both floors' cost."""

    agents: int
    lockstep: FloorSpeed
    echo: FloorSpeed
