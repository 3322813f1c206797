"""How much the radio's validation simulates."""

from msgspec import Struct


class RadioPlan(Struct, frozen=True, kw_only=True):
    """How much is simulated."""

    seeds: int = 3
    """Runs of each condition; their mean is judged"""
    stations: int = 100
    """Rows of the references with more are left out"""
    packets: int = 12_000
    """Delivered in each saturated run, more or less: the same relative error for every rate"""
    phase_seeds: int = 12
    """Runs of the broadcasts whose stations draw their phases once: few draws, so more of them"""
    sessions: int = 2_000
    """Of Fine Time Measurement in each condition and seed"""
    mesh_stations: int = 12
    mesh_s: float = 5.0


QUICK_RADIO = RadioPlan(
    seeds=1, stations=16, packets=4_000, phase_seeds=1, sessions=500, mesh_stations=8, mesh_s=1.0
)
