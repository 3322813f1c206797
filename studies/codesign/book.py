"""All flights of an experiment by case and seed, with the queries for tables and figures."""

from collections.abc import Callable, Iterable, Mapping

from msgspec import Struct

from harness.campaign.intervals import Interval, mean_interval
from studies.codesign.cases import CodesignCase, CodesignPlan
from studies.codesign.measures import Measures
from studies.codesign.results import CodesignFlown
from studies.codesign.statistics import ratio_interval
from studies.common.report import ReportTable

COLUMNS = {
    "shape m": ("shape_m", 3, 1.0), "estimates m": ("estimate_m", 3, 1.0), "control m": ("control_m", 3, 1.0),
    "absolute m": ("absolute_m", 3, 1.0), "busy %": ("busy_fraction", 1, 100.0),
    "sessions/s": ("sessions_per_s", 0, 1.0), "completed %": ("completed_fraction", 1, 100.0),
    "beacons lost %": ("beacons_lost_fraction", 1, 100.0),
}  # fmt: skip
"""Field of `Measures`, digits and factor by column of a table."""


class Book(Struct, frozen=True, kw_only=True):
    """Flights of a plan."""

    plan: CodesignPlan
    flights: Mapping[tuple[str, int], CodesignFlown]
    """By name of the case and seed"""

    def measures(self, case: CodesignCase) -> list[Measures | None]:
        """Return the measures of all seeds in order; None for a flight that is missing or broken."""
        return [None if flown is None else flown.measures for flown in self._flights(case)]

    def pairs(self, one: CodesignCase, other: CodesignCase) -> list[tuple[Measures, Measures]]:
        """Return the measures of the seeds that have both flights, of the same state of the sources."""
        return [
            (a.measures, b.measures)
            for a, b in zip(self._flights(one), self._flights(other), strict=True)
            if a is not None and b is not None and a.state == b.state and a.measures and b.measures
        ]

    def flown(self, case: CodesignCase) -> list[Measures]:
        """Return the measures of the seeds that have them."""
        return [each for each in self.measures(case) if each is not None]

    def values(self, case: CodesignCase, what: str) -> list[float | None]:
        """Return a field of `Measures` for every seed."""
        return [None if each is None else getattr(each, what) for each in self.measures(case)]

    def mean(self, case: CodesignCase, what: str) -> Interval:
        """Return the mean of a field over the seeds that have it."""
        return mean_interval(self.values(case, what))

    def ratio(self, above: CodesignCase, below: CodesignCase, what: str) -> Interval:
        """Return the ratio of the means of two cases over their pairs."""
        pairs = self.pairs(above, below)
        return ratio_interval([getattr(a, what) for a, _ in pairs], [getattr(b, what) for _, b in pairs])

    def count(self, case: CodesignCase, condition: Callable[[Measures], bool]) -> int:
        """Return the number of flights that meet the condition."""
        return sum(map(condition, self.flown(case)))

    def collided(self, case: CodesignCase) -> int:
        """Return the number of flights with a collision."""
        return self.count(case, lambda flight: flight.collisions > 0)

    def formed(self, case: CodesignCase) -> int:
        """Return the number of flights that reached their formation."""
        return self.count(case, lambda flight: flight.formed_s is not None)

    def begun(self, case: CodesignCase) -> int:
        """Return the number of finished flights, with results or broken."""
        return sum(flown is not None for flown in self._flights(case))

    def of_flights(self, count: Callable[[CodesignCase], int], case: CodesignCase) -> str:
        """Format a count of this case as ``number of flights``."""
        return f"{count(case)} of {len(self.flown(case))}"

    def cell(self, case: CodesignCase, column: str) -> str:
        """Return the mean of one of `COLUMNS` with its interval, as text."""
        what, digits, factor = COLUMNS[column]
        return self.mean(case, what).text(digits, factor=factor)

    def means_table(
        self,
        keys: tuple[str, ...],
        columns: tuple[str, ...],
        rows: Iterable[tuple[*tuple[str, ...], CodesignCase]],
    ) -> ReportTable:
        """Return the means of `COLUMNS`: a row for each case, which follows its keys."""
        return ReportTable(
            caption="Means and 95 % confidence intervals.",
            columns=(*keys, *columns, "collided"),
            rows=tuple(
                (*key, *(self.cell(case, column) for column in columns), self.of_flights(self.collided, case))
                for *key, case in rows
            ),
        )

    def least(self, case: CodesignCase, what: str) -> str:
        """Return the smallest value over the flights, in metres, as text."""
        present = [value for value in self.values(case, what) if value is not None]
        return f"{min(present):.2f}" if present else "–"

    def broken(self) -> list[CodesignFlown]:
        """Return the flights without results."""
        return [flown for flown in self.flights.values() if flown.broken is not None]

    def _flights(self, case: CodesignCase) -> list[CodesignFlown | None]:
        return [self.flights.get((case.name, seed)) for seed in range(1, self.plan.seeds + 1)]
