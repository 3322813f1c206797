"""On-board application of the study: a line that takes off, waits, and closes up towards its centre."""

from enum import IntEnum
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from coflight import Application, Context, Reports, Status


class Phase(IntEnum):
    """Phases of the flight."""

    APART = 0
    CLOSING = 1


class ClosingSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Times and scale of the manoeuvre."""

    height_m: Annotated[float, Meta(ge=1.0, le=100.0)] = 5.0
    close_at_s: Annotated[float, Meta(ge=0.0)] = 20.0
    """Simulated time at which the line begins to close up"""
    scale: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.15
    """Final over initial distances"""


class ClosingLine(Application):
    """Flies to its place, later to the place that is nearer to the centre of all places."""

    Settings = ClosingSettings
    reports = Reports(phases=Phase, formed=(Phase.CLOSING,))

    def __init__(self, settings: ClosingSettings) -> None:
        self._settings = settings
        self._phase = Phase.APART

    def start(self, context: Context) -> None:
        """Compute both places."""
        self._autopilot = context.autopilot
        places_m = np.asarray(context.places_ned_m)[:, :2]
        centre_m = places_m.mean(axis=0)
        self._apart_m = places_m[context.uav]
        self._closed_m = centre_m + self._settings.scale * (self._apart_m - centre_m)

    def on_timer(self, now_us: int) -> None:
        """Fly to the place of the phase."""
        settings, autopilot = self._settings, self._autopilot
        autopilot.take_off(settings.height_m)
        if now_us >= 1e6 * settings.close_at_s:
            self._phase = Phase.CLOSING
        north_m, east_m = self._apart_m if self._phase is Phase.APART else self._closed_m
        if autopilot.follows:
            autopilot.fly(pos_ned_m=(float(north_m), float(east_m), -settings.height_m))

    def status(self) -> Status:
        """Return the phase."""
        return Status(self._phase)
