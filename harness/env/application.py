"""The on-board application that an environment flies: applies actions, stores what it receives. No I/O.

Until the first action it takes off and flies to its place of the formation.
"""

import math
import struct
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from autopilot.onboard.application import Application
from autopilot.onboard.context import Context
from foundation.types import Vector
from harness.env.settings import EnvSettings, Neighbours
from netsim.wire.messages import Delivery, FtmResult, RxItem

NEAR_M, SLOW_M_S = 0.5, 0.3
"""Estimated distance from the place and speed within which a UAV hovers there."""
TAKE_OFF_M = 2.5
_ZERO: Vector = (0.0, 0.0, 0.0)
_STATE = 6
"""Numbers of a beacon before those of the message: position and velocity."""


class EnvApplication(Application):
    """One agent of an environment, which calls it directly in its process.

    Attributes:
        action: numbers of `EnvSettings.action_names`; None, or NaN in the first: hold the place.

    """

    Settings = EnvSettings

    def __init__(self, settings: EnvSettings) -> None:
        self.settings = settings
        self._beacon = struct.Struct(f"<{_STATE + settings.message_size}f")
        self.action: NDArray[np.float64] | None = None
        self.bad_beacons = 0

    def start(self, context: Context) -> None:
        """Store the context."""
        self._context = context
        settings, agents = self.settings, len(context.places_ned_m)
        north_m, east_m, down_m = context.places_ned_m[context.uav].tolist()
        self._place_ned_m: Vector = (north_m, east_m, down_m)
        self._neighbours = Neighbours(context.uav, agents, settings.message_size)
        self._message = (0.0,) * settings.message_size
        loop_s = context.loop_period_us * 1e-6
        self._beacon_loops = max(1, round(settings.beacon_period_s / loop_s))
        self._range_loops = max(1, round(settings.range_period_s / loop_s))
        # UAVs take turns within the periods
        self._loops = round(context.uav * max(self._beacon_loops, self._range_loops) / agents)
        self._ranged = 0
        self._now_us = 0
        self._observation = self._observed(0)

    @property
    def follows(self) -> bool:
        """Whether the autopilot follows the actions."""
        return self._context.autopilot.follows

    @property
    def is_hovering(self) -> bool:
        """Whether the UAV has reached its place, by its own estimate."""
        autopilot = self._context.autopilot
        if not autopilot.follows or autopilot.pos_ned_m is None:
            return False
        near = math.dist(autopilot.pos_ned_m, self._place_ned_m) < NEAR_M
        return bool(near and math.hypot(*autopilot.vel_ned_m_s) < SLOW_M_S)

    def observation(self) -> NDArray[np.float64]:
        """Return the observation of the last iteration, not yet limited to its bounds.

        What was received after that iteration is part of the next one.
        """
        return self._observation

    def on_radio(self, items: Iterable[RxItem], now_us: int) -> None:  # noqa: ARG002  items have times
        """Store beacons and ranges."""
        for item in items:
            if isinstance(item, Delivery):
                if len(item.payload) != self._beacon.size:
                    self.bad_beacons += 1
                    continue
                north_m, east_m, down_m, vel_n, vel_e, vel_d, *message = self._beacon.unpack(item.payload)
                self._neighbours.on_beacon(
                    item.source, item.received_ns // 1_000, pos_ned_m=(north_m, east_m, down_m),
                    vel_ned_m_s=(vel_n, vel_e, vel_d), message=tuple(message),
                )  # fmt: skip
            elif isinstance(item, FtmResult) and item.status == "ok":
                self._neighbours.on_range(item.peer, item.measured_ns // 1_000, item.distance_m)

    def on_timer(self, now_us: int) -> None:
        """Apply the action, and send what is due."""
        autopilot, action = self._context.autopilot, self.action
        self._now_us = now_us
        self._observation = self._observed(now_us)
        self._loops += 1
        autopilot.take_off(TAKE_OFF_M)
        if action is None or math.isnan(action[0]):
            autopilot.fly(pos_ned_m=self._place_ned_m)
            self._send(beacon=self._loops % self._beacon_loops == 0, ranging=self._is_range_due())
            return
        settings = self.settings
        north, east, down = action[:3].tolist()
        if settings.setpoint == "velocity":
            scale = settings.speed_max_m_s
            autopilot.fly(vel_ned_m_s=(scale * north, scale * east, scale * down))
        else:
            scale = settings.acc_max_m_s2
            autopilot.fly(acc_ned_m_s2=(scale * north, scale * east, scale * down))
        self._message = tuple(action[3 : 3 + settings.message_size].tolist())
        if settings.radio == "chosen":
            send, ranging = action[-2:].tolist()
            self._send(beacon=send > 0.0, ranging=ranging > 0.0)
        else:
            self._send(beacon=self._loops % self._beacon_loops == 0, ranging=self._is_range_due())

    def _observed(self, now_us: int) -> NDArray[np.float64]:
        autopilot = self._context.autopilot
        return self._neighbours.observation(
            now_us,
            pos_ned_m=autopilot.pos_ned_m or _ZERO,
            vel_ned_m_s=autopilot.vel_ned_m_s,
            place_ned_m=self._place_ned_m,
        )

    def _is_range_due(self) -> bool:
        return self._loops % self._range_loops == 0

    def _send(self, *, beacon: bool, ranging: bool) -> None:
        """Send a beacon, and range to the next of the others, each at a random time of this iteration."""
        context, pos_ned_m = self._context, self._context.autopilot.pos_ned_m
        if beacon and pos_ned_m is not None:
            state = (*pos_ned_m, *context.autopilot.vel_ned_m_s)
            context.radio.broadcast(self._beacon.pack(*state, *self._message), at_us=self._moment_us())
        others = len(context.places_ned_m) - 1
        if ranging and others:
            self._ranged = self._ranged % others + 1
            peer = (context.uav + self._ranged) % (others + 1)
            context.radio.range_to(peer, at_us=self._moment_us())

    def _moment_us(self) -> int:
        return self._now_us + int(self._context.rng.integers(self._context.loop_period_us))
