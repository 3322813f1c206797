"""Path loss from a table of distances and losses, such as one measured along a line."""

import csv
from itertools import pairwise

import numpy as np
from msgspec import Struct

from foundation.text_file import TextFileError, read_text
from netsim.phy.interfaces import RadioContext
from netsim.phy.path_loss import Doubles

HEADER = ["distance_m", "loss_db"]


class TableSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the path loss ``table``."""

    file: str
    """CSV file with the header ``distance_m,loss_db`` and increasing distances, relative to the scenario."""


class LossTable:
    """Losses of a table, interpolated over the logarithm of the distance; see `PathLoss`.

    Before the first and beyond the last row the loss rises by 20 dB per decade of distance, as in free space,
    from that row; it is at least 0.
    """

    Settings = TableSettings

    def __init__(self, radio: RadioContext, settings: TableSettings) -> None:
        path = radio.folder / settings.file
        try:
            text = read_text(path)
        except TextFileError as error:
            raise ValueError(f"file: {error}") from None
        try:
            rows = read_rows(text)
        except ValueError as error:
            raise ValueError(f"file: {path}: {error}") from None
        self._logs = np.log10([row[0] for row in rows])
        self._losses_db = np.array([row[1] for row in rows])

    def loss_db(self, _from_ned_m: Doubles, _to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        """See `netsim.phy.interfaces.PathLoss`."""
        logs = np.log10(distance_m)
        first, last = self._logs[0], self._logs[-1]
        losses_db = np.interp(logs, self._logs, self._losses_db)
        losses_db += 20.0 * (np.minimum(logs - first, 0.0) + np.maximum(logs - last, 0.0))
        return np.asarray(np.maximum(losses_db, 0.0))


def read_rows(text: str) -> list[tuple[float, float]]:
    """Return distances in m and losses in dB of a CSV text. Raises ValueError with the line's number."""
    lines = csv.reader(text.splitlines())
    header = [name.strip() for name in next(lines, [])]
    if header != HEADER:
        raise ValueError(f"line 1: {','.join(header)!r}; expected {','.join(HEADER)}")
    rows: list[tuple[float, float]] = []
    numbers: list[int] = []
    for fields in lines:
        if not fields:
            continue
        try:
            distance_m, loss_db = map(float, fields)
        except ValueError:
            raise ValueError(f"line {lines.line_num}: {','.join(fields)!r}; expected two numbers") from None
        if not (0.0 < distance_m < np.inf and 0.0 <= loss_db < np.inf):
            raise ValueError(
                f"line {lines.line_num}: {distance_m:g} m, {loss_db:g} dB; expected a distance above 0 and a "
                "loss of 0 or more"
            )
        rows.append((distance_m, loss_db))
        numbers.append(lines.line_num)
    if len(rows) < 2:
        raise ValueError(f"{len(rows)} rows; expected at least 2")
    for number, (before, after) in zip(numbers[1:], pairwise(rows), strict=True):
        if after[0] <= before[0]:
            raise ValueError(
                f"line {number}: {after[0]:g} m after {before[0]:g} m; expected increasing distances"
            )
    return rows
