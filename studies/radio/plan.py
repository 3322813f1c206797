"""Number and length of the runs in the radio's validation."""

from msgspec import Struct


class RadioPlan(Struct, frozen=True, kw_only=True):
    """Number and length of the runs."""

    seeds: int = 3
    """Runs of each condition; their mean is judged"""
    stations: int = 100
    """Reference rows with more stations are skipped"""
    packets: int = 4_000
    """Delivered in each saturated run, approximately: the same relative error for every rate"""
    datagrams: int = 30_000
    """Broadcasts sent in all runs of a condition together; conditions with few stations have more runs, at
    most four times ``seeds``"""
    phase_seeds: int = 6
    """Runs of broadcasts in short periods with phases drawn once, which have few draws each"""
    sessions: int = 2_000
    """Fine Time Measurement sessions in each condition and seed"""
    mesh_stations: int = 12
    mesh_s: float = 2.0


QUICK_RADIO = RadioPlan(
    seeds=1, stations=16, packets=2_000, datagrams=8_000, phase_seeds=2, sessions=500, mesh_stations=8,
    mesh_s=1.0,
)  # fmt: skip
