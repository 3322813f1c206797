"""The file of a vehicle's ULog, which ground stations can read while it is written.

It is opened on the first message from a station; flights without one have no such file. Its content is not
reproducible between equal runs, since the arrival times of a station's messages are not.
"""

import os
import sys
from pathlib import Path

from pymavlink.dialects.v20 import common

from autopilot.logs.ulog import UlogWriter
from autopilot.services.files import LOG_FOLDER, Log
from autopilot.services.service import BROADCAST, GROUND_STATION
from autopilot.vehicle.vehicle import StepOutput, Vehicle

PERIOD_US = 100_000


class FlightLog:
    """One log that is written and read at the same time; close it."""

    def __init__(self, path: Path, vehicle: Vehicle, now_us: int) -> None:
        """Create or truncate the file, and add it to the vehicle's list of logs. Raises OSError."""
        self._file = path.open("w+b", buffering=0)
        self._size = 0
        self._vehicle = vehicle
        self._due_us = now_us
        self._failed = False
        self._name = f"uav {vehicle.config.instance}"
        self._writer = UlogWriter(self._name, vehicle.parameters)
        self._write(self._writer.begin(now_us))
        begun_s = (vehicle.config.epoch_unix_us + now_us) // 1_000_000
        vehicle.messaging.files.add_log(Log(f"{LOG_FOLDER}/{path.name}", self, begun_s))

    def on_step(self, output: StepOutput, link_active: tuple[bool, ...]) -> None:
        """Write the step's texts and, ten times a second while armed or with a listener, samples."""
        now_us = output.now_us
        for partner, message in output.links:
            if (
                message.get_msgId() == common.MAVLINK_MSG_ID_STATUSTEXT
                and partner.link == GROUND_STATION
                and partner.number == BROADCAST
            ):
                text = message.text
                sent = text.decode("ascii", "replace") if isinstance(text, bytes) else str(text)
                self._write(self._writer.text(message.severity, now_us, sent.rstrip("\0")))
        if now_us >= self._due_us:
            self._due_us = now_us + PERIOD_US
            if any(link_active) or self._vehicle.commander.armed:
                self._write(self._writer.samples(self._vehicle))

    def size(self) -> int:
        """Size in bytes so far."""
        return self._size

    def read(self, offset: int, count: int) -> bytes:
        """Up to ``count`` bytes from ``offset``; none after the file was closed."""
        try:
            return b"" if self._file.closed else os.pread(self._file.fileno(), count, offset)
        except OSError:
            return b""

    def close(self) -> None:
        """Close the file; idempotent."""
        self._file.close()

    def _write(self, data: bytes) -> None:
        """Write; after an error nothing more is written, since the log would have a gap."""
        if self._failed or not data:
            return
        try:
            self._failed = self._file.write(data) != len(data)
        except OSError as error:
            self._failed = True
            sys.stderr.write(f"{self._name}: log ended: {error}\n")
        if not self._failed:
            self._size += len(data)
