"""The on-board application: takes off, sends beacons, flies the consensus law, and reports the meeting."""

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Annotated

from msgspec import Meta, Struct

from coflight import Application, Context, Delivery, Reports, Status
from rendezvous.beacon import Beacon, decode
from rendezvous.consensus import offsets_m, spread_m, velocity_m_s

CLIMB_GAIN_1_S = 1.0
CLIMB_SPEED_M_S = 1.0
"""Greatest speed of the correction of the height."""


class Phase(IntEnum):
    """Phases of the flight."""

    CLIMBING = 0
    MEETING = 1
    MET = 2
    LANDED = 3


class Settings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The scenario's table ``[onboard.settings]``."""

    beacon_period_ms: Annotated[int, Meta(ge=40, le=5_000)] = 200
    """Period of the beacons; a multiple of ``onboard.loop_period_ms``, or the next one is used."""
    gain_1_s: Annotated[float, Meta(gt=0.0, le=5.0)] = 0.4
    """Gain of the law; its product with the period is less than 1."""
    speed_m_s: Annotated[float, Meta(gt=0.0, le=8.0)] = 3.0
    """Greatest horizontal speed."""
    spacing_m: Annotated[float, Meta(gt=0.0, le=1_000.0)] = 10.0
    """Least distance of two offsets from the meeting point. Positions are those of the GPS
    receivers, so it has to exceed the difference of two receivers' errors by the size of the UAVs."""
    height_m: Annotated[float, Meta(ge=1.0, le=500.0)] = 5.0
    """Height above the ground."""
    forget_after_s: Annotated[float, Meta(gt=0.0, le=60.0)] = 1.5
    """Age from which a beacon is not used."""
    tolerance_m: Annotated[float, Meta(gt=0.0, le=100.0)] = 1.0
    """Spread below which the UAV has met those that it receives. It has to exceed the velocity errors,
    divided by the gain: with the default sensors the spread is 0.5 to 0.7 m in the mean after the meeting."""
    hold_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 2.0
    """Time below the tolerance after which it reports so."""

    def __post_init__(self) -> None:
        """Check what depends on two fields; raises ValueError."""
        period_s = 1e-3 * self.beacon_period_ms
        if self.gain_1_s * period_s >= 1.0:
            raise ValueError(
                f"gain_1_s: {self.gain_1_s}; expected less than {1.0 / period_s:g}, 1 / beacon_period_ms"
            )
        if self.forget_after_s <= period_s:
            raise ValueError(
                f"forget_after_s: {self.forget_after_s}; expected more than beacon_period_ms, {period_s}"
            )


class Rendezvous(Application):
    """One UAV of the rendezvous."""

    Settings = Settings
    reports = Reports(
        phases=Phase,
        formed=(Phase.MET,),
        absent=(Phase.LANDED,),
        values=("spread_m", "neighbours", "beacons"),
    )

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._phase = Phase.CLIMBING
        self._beacons: dict[int, Beacon] = {}
        """The newest beacon of each other UAV."""
        self._near_since_us: int | None = None
        """Since when the spread is below the tolerance."""
        self._spread_m = float("nan")
        self._sent = self._bad_beacons = 0

    def start(self, context: Context) -> None:
        """Choose the offsets of all UAVs, which depend on the scenario's places alone."""
        self._uav, self._radio, self._autopilot = context.uav, context.radio, context.autopilot
        places_m = [(float(n), float(e)) for n, e, _ in context.places_ned_m]
        self._offsets_m = offsets_m(places_m, self._settings.spacing_m)
        self._rng, self._loop_period_us = context.rng, context.loop_period_us

    def on_radio(self, items: Iterable[object], now_us: int) -> None:  # noqa: ARG002  as the protocol has it
        """Store beacons."""
        for item in items:
            if isinstance(item, Delivery):
                beacon = decode(item.payload)
                if beacon is None or item.source >= len(self._offsets_m):
                    self._bad_beacons += 1
                else:
                    self._beacons[item.source] = beacon

    def on_timer(self, now_us: int) -> None:
        """Send a beacon if one is due, and fly."""
        autopilot, settings = self._autopilot, self._settings
        autopilot.take_off(settings.height_m)
        if autopilot.landed:
            self._phase = Phase.LANDED
            return
        position = autopilot.pos_ned_m
        if position is None:
            return
        if now_us % (1_000 * settings.beacon_period_ms) < self._loop_period_us:
            # a random time until the next iteration, so that the beacons of all UAVs do not contend at once
            at_us = now_us + int(self._rng.integers(self._loop_period_us))
            beacon = Beacon(now_us, *position[:2], *autopilot.vel_ned_m_s[:2])
            self._radio.broadcast(beacon.encode(), at_us=at_us)
            self._sent += 1
        own_m = self._state(self._uav, position[:2])
        others_m = self._others(now_us)
        self._spread_m = spread_m([own_m, *others_m])
        if autopilot.follows:
            north_m_s, east_m_s = velocity_m_s(own_m, others_m, settings.gain_1_s, settings.speed_m_s)
            climb_m_s = CLIMB_GAIN_1_S * (-settings.height_m - position[2])
            down_m_s = min(max(climb_m_s, -CLIMB_SPEED_M_S), CLIMB_SPEED_M_S)
            autopilot.fly(vel_ned_m_s=(north_m_s, east_m_s, down_m_s))
            self._judge(now_us, len(others_m))

    def status(self) -> Status:
        """Return phase, text and numbers."""
        met = self._phase is Phase.MET
        return Status(
            self._phase,
            text=f"met {len(self._beacons)} UAVs" if met else "",
            values={"spread_m": self._spread_m, "neighbours": len(self._beacons), "beacons": self._sent},
        )

    def troubles(self) -> Mapping[str, int]:
        """Return the number of datagrams that are no beacons."""
        return {"bad_beacons": self._bad_beacons}

    def _others(self, now_us: int) -> list[tuple[float, float]]:
        """Return the states of the other UAVs, and forget those whose beacons are too old."""
        oldest_us = now_us - int(1e6 * self._settings.forget_after_s)
        self._beacons = {uav: beacon for uav, beacon in self._beacons.items() if beacon.time_us >= oldest_us}
        return [self._state(uav, self._beacons[uav].at(now_us)) for uav in sorted(self._beacons)]

    def _state(self, uav: int, position_m: tuple[float, ...]) -> tuple[float, float]:
        """Return the position without the UAV's offset."""
        north_m, east_m = self._offsets_m[uav]
        return position_m[0] - north_m, position_m[1] - east_m

    def _judge(self, now_us: int, received: int) -> None:
        """Set the phase: met after the hold time below the tolerance, no more above twice the tolerance."""
        settings = self._settings
        if self._phase is Phase.CLIMBING:
            self._phase = Phase.MEETING
        limit_m = settings.tolerance_m * (2.0 if self._phase is Phase.MET else 1.0)
        if not received or self._spread_m > limit_m:
            self._phase, self._near_since_us = Phase.MEETING, None
        elif self._near_since_us is None:
            self._near_since_us = now_us
        elif now_us - self._near_since_us >= 1e6 * settings.hold_s:
            self._phase = Phase.MET
