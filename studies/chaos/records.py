"""The file of a study's flights, to which each is appended when it ends: JSON lines."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from msgspec import Struct

from studies.chaos.faults import Fault
from studies.chaos.flight import Outcome
from studies.common.record_lines import RecordsError, read_records


class FlightRecord(Struct, frozen=True, kw_only=True):
    """One flight of a study."""

    seed: int
    number: int
    """Place in the plan, from 0"""
    commit: str
    again: bool = False
    """Whether this is the repetition of a flight that did not end as required"""
    outcome: Outcome


def read(path: Path, faults: Sequence[Fault], seed: int) -> list[FlightRecord]:
    """Return the flights in a file of this plan, as `read_records` does. Raises RecordsError."""
    flown = read_records(path, FlightRecord, b'{"seed":%d,"number":' % seed)
    for line, each in enumerate(flown, 1):
        if each.seed != seed:
            raise RecordsError(
                f"{path}, line {line}: flown with seed {each.seed}, not {seed}; give another file"
            )
        if each.number < len(faults) and each.outcome.fault != faults[each.number]:
            raise RecordsError(
                f"{path}, line {line}: the fault of flight {each.number} is not that of the plan, which has "
                "changed since; give another file"
            )
    return flown


def first_and_again(
    flights: Iterable[FlightRecord],
) -> tuple[dict[int, FlightRecord], dict[int, FlightRecord]]:
    """Return the first flights and the last repetitions by their place in the plan."""
    first: dict[int, FlightRecord] = {}
    again: dict[int, FlightRecord] = {}
    for flown in flights:
        if flown.again:
            again[flown.number] = flown
        else:
            first.setdefault(flown.number, flown)
    return first, again
