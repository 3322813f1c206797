"""How much the antenna's validation computes."""

from msgspec import Struct


class AntennaPlan(Struct, frozen=True, kw_only=True):
    """How much is computed."""

    formations: int = 300
    """Random ones in each comparison of the batch solver with NEC2 that is required"""
    other_formations: int = 60
    """In each of the further ones"""
    witness_formations: int = 12
    """In each comparison of nec2c with PyNEC"""
    samples: int = 1_000
    """Random formations of each deviation and wavelength"""
    curve_samples: int = 500
    """Of each point of the curve of gain over deviation"""
    benchmark_s: float = 30.0


QUICK_ANTENNA = AntennaPlan(
    formations=40, other_formations=8, witness_formations=3, samples=300, curve_samples=100, benchmark_s=5.0
)
