"""Pairs of serial radios with given path gains, and MAVLink frames for them."""

from collections.abc import Sequence

import numpy as np

from netsim.serial_radio.config import SerialRadioConfig
from netsim.serial_radio.links import Delivery, SerialLinks

STRONG = 1e-8
"""A gain without errors: -60 dBm are received of 20 dBm."""
VEHICLE, GROUND = 0, 1
HEARTBEAT = 0


class SetGains:
    """The same gain for all links, which a test may change; no fading."""

    def __init__(self, gain: float = STRONG) -> None:
        self.value = gain

    def gain(self, _a: int, _b: int, _at_ns: int) -> float:
        return self.value

    def fading(self, _a: int, _b: int, _times_ns: list[int]) -> None:
        return None


class Pairs:
    """Pairs of stations (0, 1), (2, 3), ..., with what has been delivered and reported."""

    def __init__(self, *, pairs: int = 1, gain: float = STRONG, seed: int = 1, **settings: object) -> None:
        self.config = SerialRadioConfig(**settings)
        self.gains = SetGains(gain)
        stations = [(2 * pair, 2 * pair + 1) for pair in range(pairs)]
        self.links = SerialLinks(self.config, stations, self.gains, np.random.SeedSequence(seed))
        self.delivered: list[Delivery] = []
        self.reports = []
        self.now_ns = 0

    def run(self, seconds: float, step_s: float = 0.02, feed: dict[int, float] | None = None) -> None:
        """Advance; ``feed`` are rates in bytes/s of bytes that hosts submit in each step."""
        owed = dict.fromkeys(feed or {}, 0.0)
        end_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end_ns:
            for end, rate in (feed or {}).items():
                owed[end] += rate * step_s
                count = int(owed[end])
                owed[end] -= count
                self.links.submit(end, bytes(count), self.now_ns)
            self.now_ns = min(self.now_ns + round(step_s * 1e9), end_ns)
            self.links.run_until(self.now_ns)
            self.delivered += self.links.take()
            self.reports += self.links.take_reports()

    def received(self, end: int) -> bytes:
        return b"".join(delivery.data for delivery in self.delivered if delivery.end == end)

    def send(self, frames: Sequence[tuple[float, int, bytes]], until_s: float) -> dict[bytes, float]:
        """Submit (seconds, end, frame) in their order, run; return the delays of delivered frames in s."""
        sent = {}
        for at_s, end, frame in frames:
            if at_s > self.now_ns * 1e-9:
                self.run(at_s - self.now_ns * 1e-9, step_s=1.0)
            self.links.submit(end, frame, round(at_s * 1e9))
            sent[frame] = at_s
        self.run(until_s - self.now_ns * 1e-9, step_s=1.0)
        return {
            delivery.data: delivery.at_ns * 1e-9 - sent[delivery.data]
            for delivery in self.delivered
            if delivery.data in sent
        }


def mavlink_frame(size: int, number: int, message: int = 30, version: int = 2) -> bytes:
    """Return a frame of ``size`` bytes with unique contents and no valid CRC."""
    payload = size - (12 if version == 2 else 8)
    body = np.random.default_rng((size, number)).integers(0, 250, max(payload, 0), dtype=np.uint8).tobytes()
    if version == 1:
        return bytes((254, payload, number & 255, 1, 1, message)) + body + number.to_bytes(2, "big")
    return bytes((253, payload, 0, 0, number & 255, 1, 1, message, 0, 0)) + body + number.to_bytes(2, "big")
