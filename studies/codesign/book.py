"""All flights of an experiment, by case and seed, as its tables and figures ask for them."""

from collections.abc import Callable, Mapping

from msgspec import Struct

from studies.codesign.cases import CodesignCase, CodesignPlan
from studies.codesign.measures import Measures
from studies.codesign.results import CodesignFlown
from studies.codesign.statistics import Interval, mean_interval, ratio_interval


class Book(Struct, frozen=True, kw_only=True):
    """What was flown of a plan."""

    plan: CodesignPlan
    flights: Mapping[tuple[str, int], CodesignFlown]
    """By case's name and seed"""

    def measures(self, case: CodesignCase) -> list[Measures | None]:
        """Of every seed, in their order; None of those that were not flown or are broken."""
        return [None if flown is None else flown.measures for flown in self._flights(case)]

    def pairs(self, one: CodesignCase, other: CodesignCase) -> list[tuple[Measures, Measures]]:
        """Of the seeds that have both, flown by the same sources."""
        return [
            (a.measures, b.measures)
            for a, b in zip(self._flights(one), self._flights(other), strict=True)
            if a is not None and b is not None and a.state == b.state and a.measures and b.measures
        ]

    def flown(self, case: CodesignCase) -> list[Measures]:
        """Of the seeds that have one."""
        return [each for each in self.measures(case) if each is not None]

    def values(self, case: CodesignCase, what: str) -> list[float | None]:
        """One of the numbers of `Measures` of every seed."""
        return [None if each is None else getattr(each, what) for each in self.measures(case)]

    def mean(self, case: CodesignCase, what: str) -> Interval:
        """Its mean over the seeds that have it."""
        return mean_interval(self.values(case, what))

    def ratio(self, above: CodesignCase, below: CodesignCase, what: str) -> Interval:
        """Ratio of the means of two cases over their pairs."""
        pairs = self.pairs(above, below)
        return ratio_interval([getattr(a, what) for a, _ in pairs], [getattr(b, what) for _, b in pairs])

    def count(self, case: CodesignCase, condition: Callable[[Measures], bool]) -> int:
        """Flights of which something holds."""
        return sum(map(condition, self.flown(case)))

    def collided(self, case: CodesignCase) -> int:
        """Flights with a collision."""
        return self.count(case, lambda flight: flight.collisions > 0)

    def formed(self, case: CodesignCase) -> int:
        """Flights that reached their formation."""
        return self.count(case, lambda flight: flight.formed_s is not None)

    def begun(self, case: CodesignCase) -> int:
        """Flights that were flown, with numbers or broken."""
        return sum(flown is not None for flown in self._flights(case))

    def of_flights(self, number: int, case: CodesignCase) -> str:
        """As ``number of flights``."""
        return f"{number} of {len(self.flown(case))}"

    def least(self, case: CodesignCase, what: str) -> str:
        """Smallest over the flights, in metres."""
        known = [value for value in self.values(case, what) if value is not None]
        return f"{min(known):.2f}" if known else "–"

    def broken(self) -> list[CodesignFlown]:
        """Flights without numbers."""
        return [flown for flown in self.flights.values() if flown.broken is not None]

    def _flights(self, case: CodesignCase) -> list[CodesignFlown | None]:
        return [self.flights.get((case.name, seed)) for seed in range(1, self.plan.seeds + 1)]
