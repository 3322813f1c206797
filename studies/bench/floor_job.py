"""Messages between the benchmark and the process that measures the floors; no further imports."""

from msgspec import Struct


class FloorJob(Struct, frozen=True, kw_only=True):
    """Parameters of the measurement."""

    agents: int
    wall_s: float
    """Wall time of each floor"""


class FloorSpeed(Struct, frozen=True, kw_only=True):
    """Cost of one floor."""

    real_time_factor: float
    server_cpu_s_per_simulated_s: float
    vehicles_cpu_s_per_simulated_s: float
    """Of all vehicles together"""


class FloorCost(Struct, frozen=True, kw_only=True):
    """Costs of both floors."""

    agents: int
    lockstep: FloorSpeed
    echo: FloorSpeed
