"""Applications as users write them, named by scenarios and tests by their paths."""

from enum import IntEnum
from typing import Annotated

from msgspec import Meta, Struct

from coflight import Application, Delivery, FtmResult, Reports, Sent, Status


class Phase(IntEnum):
    CLIMBING = 0
    MEETING = 3
    MET = 7


class EchoSettings(Struct, frozen=True):
    prefix: Annotated[str, Meta(max_length=4)] = ""
    greets: bool = False


class Echo(Application):
    """Sends back each datagram that it receives; greets until one arrives, as greetings may collide."""

    Settings = EchoSettings
    reports = Reports(phases=Phase, formed=(Phase.MET,), values=("echoes", "distance_m"))

    def __init__(self, settings):
        self.prefix = settings.prefix.encode()
        self.greets = settings.greets
        self.seen, self.payloads, self.count = set(), [], 0

    def start(self, context):
        self.context = context

    def on_mavlink(self, message, now_us):
        self.seen.add(message.get_type())

    def on_radio(self, items, now_us):
        self.payloads += [item.payload for item in items if isinstance(item, Delivery)]
        self.greets = self.greets and not self.payloads

    def on_timer(self, now_us):
        for payload in [b"hello"] if self.greets else self.payloads:
            self.context.radio.broadcast(self.prefix + payload)
            self.count += 1
        self.payloads = []

    def status(self):
        return Status(Phase.MEETING, text=f"{self.count} echoes", values={"echoes": self.count})

    def troubles(self):
        return {"echoes_lost": 0}


class ChangesNumbers(Application):
    """Reports numbers that it changes in place."""

    reports = Reports(values=("echoes",))

    def __init__(self):
        self.numbers = {"echoes": 0.0}

    def on_timer(self, now_us):
        if isinstance(self.numbers, dict) and isinstance(self.numbers["echoes"], float):
            self.numbers["echoes"] += 1.0

    def status(self):
        return Status(values=self.numbers)


class Hop(Application):
    """Takes off, flies a metre north of its place with a unicast and a range to the next UAV, and lands."""

    reports = Reports(phases=Phase, formed=(Phase.MET,), values=("distance_m",))

    def start(self, context):
        self.context, self.phase, self.distance_m, self.acknowledged = context, Phase.CLIMBING, None, 0

    def on_radio(self, items, now_us):
        for item in items:
            if isinstance(item, FtmResult) and item.status == "ok":
                self.distance_m = item.distance_m
            elif isinstance(item, Sent) and item.status == "acknowledged":
                self.acknowledged += 1

    def on_timer(self, now_us):
        context, autopilot = self.context, self.context.autopilot
        autopilot.take_off(3.0)
        if now_us % 1_000_000 == 0 and autopilot.pos_ned_m is not None:
            peer = (context.uav + 1) % len(context.places_ned_m)
            if peer != context.uav:
                context.radio.unicast(peer, b"hop")
                context.radio.range_to(peer)
        if autopilot.follows:
            self.phase = max(self.phase, Phase.MEETING)
            north_m, east_m, down_m = context.places_ned_m[context.uav]
            autopilot.fly(pos_ned_m=(north_m + 1.0, east_m, down_m))
            if abs(autopilot.pos_ned_m[2] - down_m) < 0.5:
                self.phase = Phase.MET

    def status(self):
        values = {} if self.distance_m is None else {"distance_m": self.distance_m}
        return Status(self.phase, values=values)


class Raises(Application):
    """Raises an exception on UAV 1 after two seconds."""

    def start(self, context):
        self.context = context

    def on_timer(self, now_us):
        if self.context.uav == 1 and now_us >= 2_000_000:
            raise ZeroDivisionError("as written")


class Slide(Application):
    """Takes off, and flies north at 1 m/s at a height of 4 m."""

    def start(self, context):
        self.autopilot = context.autopilot

    def on_timer(self, now_us):
        self.autopilot.take_off(3.0)
        self.autopilot.fly(vel_ned_m_s=(1.0, 0.0, None), pos_ned_m=(None, None, -4.0))
