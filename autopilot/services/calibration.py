"""MAV_CMD_PREFLIGHT_CALIBRATION, told in the words that MAVSDK and QGroundControl read: "[cal] ...".

The estimator learns the sensors' biases by itself, so nothing is stored: a calibration watches a vehicle at
rest for some seconds and says whether it stood still. What needs somebody who turns the vehicle by hand,
as compass and accelerometer do, is refused.
"""

import math
from collections.abc import Callable, Sequence

from pymavlink.dialects.v20 import common

from autopilot.mavlink.codec import Message
from autopilot.services.command import ACCEPTED, DENIED, REJECTED, UNSUPPORTED, Answer, CommandRequest, whole
from autopilot.services.flight_data import FlightData
from autopilot.services.service import ALL, NEVER_US, Addressed, Partner, reply
from autopilot.services.status import status_text

PERIOD_US = 100_000
SAMPLES = 30
"""Looks at the sensors: three seconds of them, as long as a gyroscope's thousand samples at PX4's rate."""
STILL_MAX_RAD_S = 0.1
"""Between the first look and any other, on each axis: a vehicle that turns faster is not at rest."""
PROGRESS_EVERY = SAMPLES // 5


class Calibration:
    """One calibration at a time, begun by `command`."""

    takes: frozenset[int] = frozenset()

    def __init__(self, flight: FlightData, *, wake: Callable[[], None]) -> None:
        """``wake`` is called when something has become due other than by a message that this takes."""
        self._flight = flight
        self._wake = wake
        self._what: str | None = None
        self._looks = 0
        self._first_rad_s = (0.0, 0.0, 0.0)
        self._due_us = NEVER_US

    def command(self, request: CommandRequest) -> Answer:
        """Begin one; all parameters zero cancels it."""
        if self._flight.commander.armed:
            return Answer(REJECTED)
        gyro, compass, baro, radio, accelerometer, airspeed, motors = (
            whole(value) if math.isfinite(value) else 0 for value in request.params
        )
        if gyro == 1 or baro == 1 or accelerometer == 2:
            return self._begin("gyro" if gyro == 1 else "baro" if baro == 1 else "level", request.now_us)
        if compass == 1 or accelerometer in {1, 4}:
            text = "Calibration denied: nobody here can turn the vehicle"
            return Answer(DENIED, (status_text(common.MAV_SEVERITY_CRITICAL, text),))
        if not any((gyro, compass, baro, radio, accelerometer, airspeed, motors)):
            return Answer(ACCEPTED, self._stop("[cal] calibration cancelled"))
        return Answer(UNSUPPORTED)

    def on_message(self, message: Message, now_us: int, partner: Partner) -> Sequence[Addressed]:  # noqa: ARG002
        """No message is for it."""
        return ()

    def on_timer(self, now_us: int) -> Sequence[Addressed]:
        """Look at the sensors, and say how far it has come."""
        if now_us < self._due_us:
            return ()
        if self._flight.commander.armed or self._flight.sensor is None:
            return reply(ALL, *self._stop("[cal] calibration cancelled"))
        sensor = self._flight.sensor
        turn_rad_s = (sensor.xgyro, sensor.ygyro, sensor.zgyro)
        if self._looks == 0:
            self._first_rad_s = turn_rad_s
        if not all(abs(a - b) <= STILL_MAX_RAD_S for a, b in zip(turn_rad_s, self._first_rad_s, strict=True)):
            return reply(ALL, *self._stop("[cal] calibration failed: motion"))
        self._looks += 1
        self._due_us = now_us + PERIOD_US
        texts = []
        if self._looks % PROGRESS_EVERY == 0:
            texts.append(_say(f"[cal] progress <{100 * self._looks // SAMPLES}>"))
        if self._looks == SAMPLES:
            texts += self._stop(f"[cal] calibration done: {self._what}")
        return reply(ALL, *texts)

    def next_deadline_us(self) -> int:
        """When it next looks at the sensors."""
        return self._due_us

    def _begin(self, what: str, now_us: int) -> Answer:
        if self._what is not None:
            return Answer(REJECTED)
        self._what, self._looks, self._due_us = what, 0, now_us + PERIOD_US
        self._wake()
        return Answer(messages=(_say(f"[cal] calibration started: 2 {what}"),))

    def _stop(self, text: str) -> tuple[Message, ...]:
        if self._what is None:
            return ()
        self._what, self._due_us = None, NEVER_US
        return (_say(text),)


def _say(text: str) -> Message:
    return status_text(common.MAV_SEVERITY_INFO, text)
