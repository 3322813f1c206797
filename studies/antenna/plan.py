"""Number of formations in the antenna's validation."""

from msgspec import Struct


class AntennaPlan(Struct, frozen=True, kw_only=True):
    """Number of formations, and length of the benchmark."""

    formations: int = 300
    """Random formations in each required comparison of the batch solver with NEC2"""
    other_formations: int = 60
    """Random formations in each further comparison"""
    witness_formations: int = 12
    """Random formations in each comparison of nec2c with PyNEC"""
    samples: int = 1_000
    """Random formations of each deviation and wavelength"""
    curve_samples: int = 500
    """Random formations of each point of the curve of gain over deviation"""
    benchmark_s: float = 30.0


QUICK_ANTENNA = AntennaPlan(
    formations=40, other_formations=8, witness_formations=3, samples=300, curve_samples=100, benchmark_s=5.0
)
