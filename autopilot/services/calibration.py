"""MAV_CMD_PREFLIGHT_CALIBRATION, reported in the texts that MAVSDK and QGroundControl parse: "[cal] ...".

The estimator estimates the sensors' biases itself, so nothing is stored: a calibration monitors a resting
vehicle for three seconds and reports whether it moved. Compass and accelerometer calibrations are refused,
since they require the vehicle to be turned by hand.
"""

import math
from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.services.command import ACCEPTED, DENIED, REJECTED, UNSUPPORTED, Answer, CommandRequest, whole
from autopilot.services.flight_data import FlightData
from autopilot.services.service import ALL, NEVER_US, Addressed, Service, reply
from autopilot.services.status import status_text

PERIOD_US = 100_000
SAMPLES = 30
"""Samples of the sensors: three seconds, as long as a gyroscope's thousand samples at PX4's rate."""
STILL_MAX_RAD_S = 0.1
"""Largest change of a body rate since the first sample, per axis, at which the vehicle counts as at rest."""
PROGRESS_EVERY = SAMPLES // 5


class Calibration(Service):
    """At most one calibration at a time, started by `command`."""

    def __init__(self, flight: FlightData, *, wake: Callable[[], None]) -> None:
        """``wake`` is called when a deadline was set by something other than a message in `takes`."""
        super().__init__()
        self._flight = flight
        self._wake = wake
        self._what: str | None = None
        self._samples = 0
        self._first_rad_s = (0.0, 0.0, 0.0)

    def command(self, request: CommandRequest) -> Answer:
        """Start a calibration; all parameters zero cancels the current one."""
        if self._flight.commander.armed:
            return Answer(REJECTED)
        gyro, compass, baro, radio, accelerometer, airspeed, motors = (
            whole(value) if math.isfinite(value) else 0 for value in request.params
        )
        if gyro == 1 or baro == 1 or accelerometer == 2:
            return self._begin("gyro" if gyro == 1 else "baro" if baro == 1 else "level", request.now_us)
        if compass == 1 or accelerometer in {1, 4}:
            text = "Calibration denied: the vehicle cannot be turned by hand"
            return Answer(DENIED, (status_text(common.MAV_SEVERITY_CRITICAL, text),))
        if not any((gyro, compass, baro, radio, accelerometer, airspeed, motors)):
            return Answer(ACCEPTED, self._stop("[cal] calibration cancelled"))
        return Answer(UNSUPPORTED)

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Check the sensors and report progress."""
        if now_us < self.due_us:
            return ()
        if self._flight.commander.armed or self._flight.sensor is None:
            return reply(ALL, *self._stop("[cal] calibration cancelled"))
        sensor = self._flight.sensor
        turn_rad_s = (sensor.xgyro, sensor.ygyro, sensor.zgyro)
        if self._samples == 0:
            self._first_rad_s = turn_rad_s
        if not all(abs(a - b) <= STILL_MAX_RAD_S for a, b in zip(turn_rad_s, self._first_rad_s, strict=True)):
            return reply(ALL, *self._stop("[cal] calibration failed: motion"))
        self._samples += 1
        self.due_us = now_us + PERIOD_US
        texts = []
        if self._samples % PROGRESS_EVERY == 0:
            texts.append(_info(f"[cal] progress <{100 * self._samples // SAMPLES}>"))
        if self._samples == SAMPLES:
            texts += self._stop(f"[cal] calibration done: {self._what}")
        return reply(ALL, *texts)

    def _begin(self, what: str, now_us: int) -> Answer:
        if self._what is not None:
            return Answer(REJECTED)
        self._what, self._samples, self.due_us = what, 0, now_us + PERIOD_US
        self._wake()
        return Answer(messages=(_info(f"[cal] calibration started: 2 {what}"),))

    def _stop(self, text: str) -> tuple[Message, ...]:
        if self._what is None:
            return ()
        self._what, self.due_us = None, NEVER_US
        return (_info(text),)


def _info(text: str) -> Message:
    return status_text(common.MAV_SEVERITY_INFO, text)
