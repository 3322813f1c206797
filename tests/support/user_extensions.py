"""A user's controllers, flight modes and services, named by tests as ``user_extensions:Class``."""

# ruff: noqa: ARG002 - methods have the signatures of the protocols

from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta, Struct
from pymavlink.dialects.v20 import common

from autopilot.commander.mode_table import FLIES_TO_A_PLACE
from autopilot.control import FlightController
from autopilot.services.service import ALL, NEVER_US, Service, reply
from autopilot.services.status import status_text
from coflight import ModeTraits, StopMode, ThrustTorque, TrajectorySetpoint


class CascadeAgain:
    """The built-in cascade as a controller of the user: it returns the demand that the cascade allocates."""

    def __init__(self, context):
        self.cascade = FlightController(context.params)
        self.resets = self.updates = 0

    def reset(self, state):
        self.resets += 1

    def update(self, inputs):
        self.updates += 1
        cascade = self.cascade
        cascade.update(inputs.state, inputs.setpoint, dt_s=inputs.dt_s, landed=inputs.landed)
        record = cascade.block[0]
        thrust = (
            inputs.setpoint.thrust if hasattr(inputs.setpoint, "thrust") else record.position.output.thrust
        )
        if record.by_tilt:
            thrust *= max(record.attitude.tilt_cosine, 0.0)
        return ThrustTorque(float(thrust), record.torque.copy())


class Failing(CascadeAgain):
    """Raises an exception on UAV 1 a second after it was first used."""

    def __init__(self, context):
        super().__init__(context)
        self.fails = context.instance == 1

    def update(self, inputs):
        if self.fails and self.updates == 250:
            raise RuntimeError("diverged")
        return super().update(inputs)


class ClimbMode(StopMode):
    """Climbs at a speed of its settings."""

    class Settings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
        climb_m_s: Annotated[float, Meta(gt=0.0, le=3.0)] = 1.0

    traits = ModeTraits(needs=FLIES_TO_A_PLACE, of_one_flight=True, name="Climb")

    def __init__(self, context, settings):
        super().__init__(context)
        self.up_m_s = settings.climb_m_s

    def update(self, inputs):
        return TrajectorySetpoint(vel_ned_m_s=np.array((0.0, 0.0, -self.up_m_s)))


class BrokenMode(StopMode):
    """Returns a setpoint that is not finite."""

    traits = ModeTraits(needs=FLIES_TO_A_PLACE)

    def update(self, inputs):
        return TrajectorySetpoint(vel_ned_m_s=np.array((0.0, np.nan, 0.0)))


class Counter(Service):
    """Answers DEBUG with the number of them, and reports it once a second of simulated time."""

    made: ClassVar[list] = []

    def __init__(self, context):
        super().__init__(DEBUG=self.count)
        self.context = context
        self.number = 0
        self.due_us = 1_000_000
        self.made.append(self)

    def count(self, message, now_us, partner):
        self.number += 1
        return reply(partner, common.MAVLink_debug_message(message.time_boot_ms, 0, float(self.number)))

    def on_timer(self, now_us):
        self.due_us = now_us + 1_000_000
        return reply(
            ALL, status_text(common.MAV_SEVERITY_INFO, f"{self.number} of UAV {self.context.instance}")
        )


class TakesCommands(Counter):
    """Handles a message that a built-in service handles."""

    def __init__(self, context):
        super().__init__(context)
        self.takes = frozenset({common.MAVLINK_MSG_ID_COMMAND_LONG})


class BrokenService:
    """Fails when it has to send something."""

    takes = frozenset()

    def __init__(self, _context):
        pass

    def on_message(self, message, now_us, partner):
        return ()

    def on_timer(self, now_us):
        return ["text"]

    def next_deadline_us(self):
        return 500_000


class NeverDue(BrokenService):
    def next_deadline_us(self):
        return NEVER_US


class NoController:
    """Lacks a method."""

    def __init__(self, context):
        pass

    def update(self, inputs):
        return ThrustTorque(0.0, (0.0, 0.0, 0.0))


def a_function(context):
    return context
