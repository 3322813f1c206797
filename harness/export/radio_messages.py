"""Messages of the channel: frames, receptions, ranging and occupancy."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from harness.export.json_rows import row_contents, schema_of
from harness.export.messages import Message, Topic
from harness.records.columns import AIR, FTM, RADIO, RECEPTIONS, TableKind
from harness.simulator.truth_record import AIR_RECORD
from netsim.emulator.log_layout import FRAME_LOG, RECEPTION_LOG, SESSION_LOG

FRAMES, RECEIVED = "/radio/frames", "/radio/receptions"
RANGING, OCCUPANCY = "/radio/ranging", "/radio/occupancy"
_NAMED = {"outcome", "reception"}
RECEPTION_ROW = np.dtype(
    [(name, "S20" if name in _NAMED else RECEPTION_LOG[name]) for name in RECEPTION_LOG.names or ()]
)
"""A row of receptions.parquet, which has names instead of codes."""
_BUSY = {
    "type": "number",
    "description": "Fraction of the time since the row before, or the start, in which the channel carried a "
    "signal. Unit: 1.",
}


class RadioMessages:
    """Maps records of the channel to messages; it holds the last row of the occupancy."""

    def __init__(self, *, with_receptions: bool) -> None:
        self._last_us, self._last_busy_ns = 0, 0
        self.topics = [
            _topic(FRAMES, "coflight.Frame", RADIO, FRAME_LOG, "when it ends"),
            _topic(RANGING, "coflight.Ranging", FTM, SESSION_LOG, "at the time that its distance belongs to"),
            _topic(OCCUPANCY, "coflight.Occupancy", AIR, AIR_RECORD, "then", more={"busy_fraction": _BUSY}),
        ]
        if with_receptions:
            self.topics.append(
                _topic(RECEIVED, "coflight.Reception", RECEPTIONS, RECEPTION_ROW, "when the frame ends")
            )

    def frames(self, rows: NDArray[Any]) -> Iterator[Message]:
        """Yield the messages of frames (n,)."""
        return _each(FRAMES, rows, rows["end_ns"])

    def receptions(self, rows: NDArray[Any], ends_ns: NDArray[np.int64]) -> Iterator[Message]:
        """Yield the messages of receptions (n,) of frames that end at (n,)."""
        return _each(RECEIVED, rows, ends_ns)

    def sessions(self, rows: NDArray[Any]) -> Iterator[Message]:
        """Yield the messages of ranging requests (n,)."""
        return _each(RANGING, rows, rows["measured_ns"])

    def occupancy(self, rows: NDArray[Any]) -> Iterator[Message]:
        """Yield the messages of the channel's occupancy (n,)."""
        for message in _each(OCCUPANCY, rows, rows["time_us"] * 1_000):
            time_us, busy_ns = message.content["time_us"], message.content["busy_ns"]
            if time_us > self._last_us:
                elapsed_ns = (time_us - self._last_us) * 1_000
                message.content["busy_fraction"] = (busy_ns - self._last_busy_ns) / elapsed_ns
            self._last_us, self._last_busy_ns = time_us, busy_ns
            yield message


def _topic(
    name: str,
    schema: str,
    kind: TableKind,
    layout: np.dtype[Any],
    when: str,
    *,
    more: Any = None,  # noqa: ANN401
) -> Topic:
    return Topic(
        name=name,
        schema=schema,
        json_schema=schema_of(schema, kind, layout, more=more),
        description=f"A row of {kind.name}.parquet, {when}.",
    )


def _each(topic: str, rows: NDArray[Any], times_ns: NDArray[np.int64]) -> Iterator[Message]:
    contents = row_contents(rows, rows.dtype.names or ())
    for time_ns, content in zip(times_ns.tolist(), contents, strict=True):
        yield Message(time_ns, topic, content)
