"""How much a vehicle's validation flies."""

from msgspec import Struct

from studies.common.runner import Job, Results

__all__ = ["QUICK", "Job", "Results", "VehiclePlan"]


class VehiclePlan(Struct, frozen=True, kw_only=True):
    """How much is flown."""

    seeds: int = 20
    """Flights of each condition; of the comparison with PX4 half as many"""
    measure_s: float = 60.0
    """Of each hover"""
    recoveries: int = 400
    throws: int = 30
    demands: int = 100_000
    estimator_runs: int = 20


QUICK = VehiclePlan(seeds=6, measure_s=20.0, recoveries=40, throws=6, demands=10_000, estimator_runs=20)
