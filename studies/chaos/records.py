"""The file of a study's flights, to which each is appended when it ends: JSON lines."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from studies.chaos.faults import Fault
from studies.chaos.flight import Outcome


class FlightRecord(Struct, frozen=True, kw_only=True):
    """One flight of a study."""

    seed: int
    number: int
    """Place in the plan, from 0"""
    commit: str
    again: bool = False
    """Whether this is the repetition of a flight that did not end as required"""
    outcome: Outcome


class RecordsError(ValueError):
    """A file of records that is not of this study: one line."""


def read(path: Path, faults: Sequence[Fault], seed: int) -> list[FlightRecord]:
    """Return the flights in a file of this plan, and cut off a last line that is half-written.

    No file is no flight. Raises `RecordsError` for a file of another seed or plan, or with other content,
    which stays as it is, and OSError.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise RecordsError(f"{path}: cannot be read: {error.strerror or error}") from None
    whole = data[: data.rfind(b"\n") + 1]
    lines = whole.split(b"\n")[:-1]
    flown = [_checked(path, i, line, faults, seed) for i, line in enumerate(lines, 1)]
    if len(whole) < len(data):
        last = data[len(whole) :]
        if not _is_half_written(last, seed, is_first=not lines):
            _checked(path, len(lines) + 1, last, faults, seed)
        with path.open("r+b") as file:
            file.truncate(len(whole))
    return flown


def _is_half_written(line: bytes, seed: int, *, is_first: bool) -> bool:
    """Whether a line is the begin of a flight's, of which a part is missing."""
    begin = b'{"seed":%d,"number":' % seed
    if not line.startswith(begin) and (is_first or not begin.startswith(line)):
        return False
    try:
        msgspec.json.decode(line)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return True
    return False


def _checked(path: Path, line_number: int, line: bytes, faults: Sequence[Fault], seed: int) -> FlightRecord:
    place = f"{path}, line {line_number}"
    try:
        flown = msgspec.json.decode(line, type=FlightRecord)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise RecordsError(f"{place}: not a flight of this study: {error}; give another file") from None
    if flown.seed != seed:
        raise RecordsError(f"{place}: flown with seed {flown.seed}, not {seed}; give another file")
    if flown.number < len(faults) and flown.outcome.fault != faults[flown.number]:
        raise RecordsError(
            f"{place}: the fault of flight {flown.number} is not that of the plan, which has changed since; "
            "give another file"
        )
    return flown


def append(path: Path, flown: FlightRecord) -> None:
    """Append a flight, and return when it is in the file."""
    with path.open("ab") as file:
        file.write(msgspec.json.encode(flown) + b"\n")


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
