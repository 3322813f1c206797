"""Number and length of the flights of the soak study."""

from msgspec import Struct


class SoakPlan(Struct, frozen=True, kw_only=True):
    """Number and length of the flights."""

    hours: float = 10.0
    """Simulated time of the long flights together"""
    piece_s: float = 3_600.0
    """Simulated time of each long flight"""
    agents: int = 8
    sample_s: float = 30.0
    """Simulated time between two measurements of the processes"""
    swarms: int = 500
    """Swarms that one process starts and ends, one after the other"""
    repeats: int = 100
    """Flights of one seed under random load"""
    repeat_s: float = 9.0
    sizes: tuple[int, ...] = (64, 128, 254)
    size_s: float = 4.0
    """Simulated time of the flights of each size"""

    @property
    def pieces(self) -> int:
        """Number of long flights."""
        return max(1, round(self.hours * 3_600.0 / self.piece_s))


QUICK_SOAK = SoakPlan(
    hours=0.05,
    piece_s=90.0,
    agents=3,
    sample_s=3.0,
    swarms=6,
    repeats=3,
    repeat_s=5.0,
    sizes=(16,),
    size_s=1.0,
)
