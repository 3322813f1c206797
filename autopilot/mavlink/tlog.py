"""The tlog of a ground link: MAVLink frames of both directions with their times.

Ground stations record the same. Each frame follows its time, 8 bytes, big endian, in microseconds since 1970:
the scenario's epoch plus simulated time. pymavlink's ``mavlogfile``, MAVExplorer and QGroundControl's replay
read it. SETUP_SIGNING, which contains a key, is left out.
"""

import os
from pathlib import Path
from struct import Struct

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import kind_of
from foundation.records.private_files import open_private

TIME = Struct(">Q")
MOST_BUFFERED = 1 << 14
"""Bytes that wait for a write."""
FLUSH_PERIOD_US = 1_000_000
_SECRET = common.MAVLINK_MSG_ID_SETUP_SIGNING


class TelemetryLog:
    """Writer of one file; close it."""

    def __init__(self, path: Path, *, epoch_unix_us: int) -> None:
        """Create the file, in place of another of its name. Raises OSError."""
        self._file = os.fdopen(open_private(path), "wb", buffering=0)
        self._path, self._epoch_us = path, epoch_unix_us
        self._buffer = bytearray()
        self._flush_us = 0

    def add(self, now_us: int, frame: bytes) -> None:
        """Add a whole frame at a simulated time. Raises OSError."""
        if kind_of(frame) == _SECRET:
            return
        self._buffer += TIME.pack(self._epoch_us + now_us) + frame
        if len(self._buffer) >= MOST_BUFFERED or now_us >= self._flush_us:
            self._flush_us = now_us + FLUSH_PERIOD_US
            self._flush()

    def close(self) -> None:
        """Write the rest and close the file; repeated calls have no effect. Raises OSError."""
        if not self._file.closed:
            with self._file:
                self._flush()

    def _flush(self) -> None:
        data = bytes(self._buffer)
        self._buffer.clear()
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            error.filename = error.filename or str(self._path)
            raise
