"""The file of a vehicle's ULog, which ground stations can read while it is written.

It begins with the vehicle, if the scenario asks for it (``logging.ulog``), or with the first message of a
station. Of a log that the scenario asks for, the content is the same for equal runs without stations.
"""

import os
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pymavlink.dialects.v20 import common

from autopilot.logs.ulog import UlogWriter
from autopilot.services.files import LOG_FOLDER, Log
from autopilot.services.service import BROADCAST, GROUND_STATION, Addressed
from autopilot.services.status import TEXT_BYTES
from autopilot.vehicle.vehicle import Vehicle
from foundation.records.private_files import open_private

MOST_BUFFERED = 1 << 15
"""Bytes that wait for a write."""
FLUSH_PERIOD_US = 1_000_000


class FlightLog:
    """One log that is written and read at the same time; close it."""

    def __init__(self, path: Path, vehicle: Vehicle, now_us: int, *, required: bool) -> None:
        """Create or truncate the file, and add it to the vehicle's list of logs. Raises OSError.

        If it is ``required`` a write that fails raises OSError, which ends the vehicle; otherwise the log
        ends, with a line on stderr.
        """
        self._file = os.fdopen(open_private(path, readable=True), "w+b", buffering=0)
        self._path, self._required = path, required
        self._size = 0
        self._buffer = bytearray()
        self._flush_us = now_us + FLUSH_PERIOD_US
        self._vehicle = vehicle
        self._failed = False
        self._text = ""
        """Begin of a text whose other chunks have not come yet."""
        self._name = f"uav {vehicle.config.instance}"
        self._writer = UlogWriter(self._name, _version(), vehicle)
        self._buffer += self._writer.begin(now_us)
        self._flush()
        begun_s = (vehicle.config.epoch_unix_us + now_us) // 1_000_000
        vehicle.messaging.files.add_log(Log(f"{LOG_FOLDER}/{path.name}", self, begun_s))

    def on_step(self, now_us: int, links: Sequence[Addressed]) -> None:
        """Add what a full step has sent as texts, and the samples that are due. Raises OSError: see above."""
        if self._failed:
            self._vehicle.shared.samples.take()
            return
        self.on_texts(now_us, links)
        self._buffer += self._writer.step()
        if len(self._buffer) >= MOST_BUFFERED or now_us >= self._flush_us:
            self._flush_us = now_us + FLUSH_PERIOD_US
            self._flush()

    def on_texts(self, now_us: int, links: Sequence[Addressed]) -> None:
        """Add the texts among messages to the links: those to all ground stations."""
        for partner, message in links:
            if (
                partner.link == GROUND_STATION
                and partner.number == BROADCAST
                and message.get_msgId() == common.MAVLINK_MSG_ID_STATUSTEXT
            ):
                text = message.text
                piece = (text.decode("ascii", "replace") if isinstance(text, bytes) else str(text)).rstrip(
                    "\0"
                )
                self._text += piece
                if not (message.id and len(piece) == TEXT_BYTES):  # the last of its chunks: see `Chunks`
                    self._buffer += self._writer.text(message.severity, now_us, self._text)
                    self._text = ""

    def size(self) -> int:
        """Size of the file in bytes so far."""
        return self._size

    def read(self, offset: int, count: int) -> bytes:
        """Up to ``count`` bytes from ``offset``; none after the file was closed."""
        try:
            return b"" if self._file.closed else os.pread(self._file.fileno(), count, offset)
        except OSError:
            return b""

    def close(self) -> None:
        """Write the rest and close the file; repeated calls have no effect. Raises OSError: see above."""
        if not self._file.closed:
            with self._file:
                if not self._failed:
                    self._buffer += self._writer.rest()
                    self._flush()

    def _flush(self) -> None:
        """Write the buffer; after an error nothing more is written, since the log would have a gap."""
        data = bytes(self._buffer)
        self._buffer.clear()
        try:
            while data:
                written = self._file.write(data) or 0
                self._size += written
                data = data[written:]
        except OSError as error:
            self._failed = True
            if self._required:
                error.filename = error.filename or str(self._path)
                raise
            sys.stderr.write(f"{self._name}: log ended: {error}\n")


def _version() -> str:
    """Return coflight's version."""
    try:
        return version("coflight")
    except PackageNotFoundError:
        return "unknown"
