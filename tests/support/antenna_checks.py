"""Helpers of the antenna's validation tests."""

from studies.antenna.plan import AntennaPlan
from studies.common.report import Section

PLAN = AntennaPlan(
    formations=4, other_formations=2, witness_formations=1, samples=40, curve_samples=4, benchmark_s=0.0
)


def missed(of):
    return [one.name for one in (of.checks if isinstance(of, Section) else of) if not one.passed]
