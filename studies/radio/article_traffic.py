"""Record the radio traffic of a hovering swarm, beacons and ranging, without simulating its vehicles.

The applications' scheduler (`autopilot.onboard.radio.traffic`) sends, receives and ranges through the
emulator; its transmissions are recorded, so that they can be replayed without the applications.
"""

import math

import numpy as np
from msgspec import Struct

from autopilot.onboard.client.own_state import OwnState
from autopilot.onboard.context import Radio
from autopilot.onboard.radio.traffic import Traffic
from foundation.types import Array
from harness.scenario.scenario import Scenario
from netsim.emulator.emulator import Emulator
from netsim.wire.messages import Delivery, FtmResult, RxItem, TxBatch, TxItem

SWAY_M = 0.2
SWAY_HZ = 0.3
TILT_RAD = 0.1
"""Approximate motion of vehicles that hold their positions in wind, so that no link is static."""


class Step(Struct, frozen=True, kw_only=True):
    """One lockstep interval: the transmissions submitted for it, and the state of the vehicles."""

    at_us: int
    to_us: int
    batches: tuple[TxBatch, ...]
    motion: tuple[Array, Array, Array]
    """Positions NED (n, 3), velocities NED (n, 3) and attitudes (n, 4)"""


def emulator_of(scenario: Scenario) -> Emulator:
    """Return a new emulator with the scenario's radio."""
    seed = np.random.SeedSequence([scenario.run.seed])
    return Emulator(config=scenario.radio, stations=scenario.agents, seed=seed)


def record(scenario: Scenario, seconds: float) -> list[Step]:
    """Record the traffic of a scenario's applications for ``seconds``."""
    emulator, step_us = emulator_of(scenario), scenario.run.step_us
    places_ned_m = scenario.places_ned_m()
    applications = [_Application(scenario, i, places_ned_m[i]) for i in range(scenario.agents)]
    arrived: list[dict[int, list[RxItem]]] = [{}, {}]
    steps = []
    for number in range(round(1e6 * seconds / step_us)):
        now_us = number * step_us
        # deliveries of an interval are available two steps after its start
        for station, received in arrived.pop(0).items():
            for item in received:
                applications[station].receive(item, now_us)
        batches = tuple(
            TxBatch(station=i, now_us=now_us, items=items)
            for i, application in enumerate(applications)
            if (items := application.send(now_us, now_us + step_us))
        )
        motion = _motion(places_ned_m, 1e-6 * now_us)
        step = Step(at_us=now_us, to_us=now_us + step_us, batches=batches, motion=motion)
        steps.append(step)
        arrived.append(advance(emulator, step))
    return steps


def advance(emulator: Emulator, step: Step) -> dict[int, list[RxItem]]:
    """Submit the transmissions of a step and simulate it; return the received items by station."""
    for batch in step.batches:
        emulator.submit(batch)
    pos_ned_m, vel_ned_m_s, q_ned_frd = step.motion
    return emulator.advance(
        to_us=step.to_us, at_us=step.at_us, pos_ned_m=pos_ned_m, vel_ned_m_s=vel_ned_m_s, q_ned_frd=q_ned_frd
    )


class _Application:
    """Radio part of one vehicle's application."""

    def __init__(self, scenario: Scenario, station: int, place_ned_m: Array) -> None:
        config = scenario.vehicle_config(station, run_id="bench", radio_endpoint=None, log_path=None)
        self.own = OwnState(site=config.site, gps_delay_s=config.devices.gps_delay_s)
        self.own.time_us = 0
        north_m, east_m, down_m = place_ned_m.tolist()
        self.own.odometry_ned_m = (north_m, east_m, down_m)
        self._radio = Radio(station=station, stations=scenario.agents, loop_us=config.onboard.loop_period_us)
        self.traffic = Traffic(
            radio=self._radio, config=config.onboard, devices=config.devices,
            rng=np.random.default_rng([scenario.run.seed, station]),
        )  # fmt: skip

    def send(self, now_us: int, until_us: int) -> tuple[TxItem, ...]:
        self._radio.now_us = now_us
        self.traffic.send(self.own, now_us, until_us, ranging=True)
        return self._radio.take()

    def receive(self, item: RxItem, now_us: int) -> None:
        if isinstance(item, Delivery):
            self.traffic.table.pages.put(item.source, item.payload)
            self.traffic.table.read(now_us)
        elif isinstance(item, FtmResult):
            self.traffic.measured(item)


def _motion(places_ned_m: Array, time_s: float) -> tuple[Array, Array, Array]:
    """Return `Step.motion` of vehicles that sway independently."""
    stations = len(places_ned_m)
    phases = np.arange(3 * stations).reshape(stations, 3) + 2.0 * math.pi * SWAY_HZ * time_s
    half_rad = 0.5 * TILT_RAD * np.sin(phases[:, 0])
    q_ned_frd = np.stack([np.cos(half_rad), np.sin(half_rad), np.zeros(stations), np.zeros(stations)], axis=1)
    vel_ned_m_s = 2.0 * math.pi * SWAY_HZ * SWAY_M * np.cos(phases)
    return places_ned_m + SWAY_M * np.sin(phases), vel_ned_m_s, q_ned_frd
