"""Number and length of the flights in a vehicle's validation."""

from msgspec import Struct


class VehiclePlan(Struct, frozen=True, kw_only=True):
    """Number and length of the flights and cases."""

    seeds: int = 20
    """Flights of each condition; half as many in the comparison with PX4"""
    measure_s: float = 60.0
    """Measured time of each hover"""
    recoveries: int = 400
    throws: int = 30
    demands: int = 100_000
    estimator_runs: int = 20


QUICK = VehiclePlan(seeds=6, measure_s=20.0, recoveries=40, throws=6, demands=10_000, estimator_runs=20)
