"""How much the radio's validation simulates."""

from msgspec import Struct


class RadioPlan(Struct, frozen=True, kw_only=True):
    """How much is simulated."""

    seeds: int = 3
    """Runs of each condition; their mean is judged"""
    stations: int = 100
    """Rows of the references with more are left out"""
    packets: int = 4_000
    """Delivered in each saturated run, more or less: the same relative error for every rate"""
    datagrams: int = 30_000
    """Sent in all runs of a condition of the broadcasts, so that few stations make more runs, up to four
    times ``seeds``"""
    phase_seeds: int = 6
    """Runs of the broadcasts whose stations draw their phases once in a short period: few draws, so more"""
    sessions: int = 2_000
    """Of Fine Time Measurement in each condition and seed"""
    mesh_stations: int = 12
    mesh_s: float = 2.0


QUICK_RADIO = RadioPlan(
    seeds=1,
    stations=16,
    packets=2_000,
    datagrams=8_000,
    phase_seeds=2,
    sessions=500,
    mesh_stations=8,
    mesh_s=1.0,
)
