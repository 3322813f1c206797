"""Number and length of the flights of the programs study."""

from msgspec import Struct


class ProgramsPlan(Struct, frozen=True, kw_only=True):
    """Number and length of the flights; wall times, in which programs live."""

    saturated: tuple[int, ...] = (2, 5, 10)
    """Numbers of senders whose queues are always full"""
    saturated_wall_s: float = 40.0
    saturated_speed: float = 0.2
    """Simulated over wall time: the machine has to keep pace with a full channel"""
    pings: int = 300
    tcp_wall_s: float = 20.0
    seeds: int = 5
    """Flights of each kind with routes"""


QUICK_PROGRAMS = ProgramsPlan(saturated=(2,), saturated_wall_s=12.0, pings=40, tcp_wall_s=6.0, seeds=1)
