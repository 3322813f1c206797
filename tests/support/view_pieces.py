"""Pieces of a made-up flight, for tests of views."""

import numpy as np

from harness.records.pieces import Piece
from harness.records.tables import FLIGHT_RECORD
from harness.simulator.truth_record import AIR_RECORD, SENSOR_RECORD
from netsim.emulator.log_layout import FRAME_LOG, SESSION_LOG

PERIOD_US, INSTANTS = 40_000, 5


def line_of_vehicles(scenario, *, after_us=0, busy_ns=()):
    """Return a piece of 0.2 s in which level vehicles, 3 m apart in the east, rise by 1 m in each instant."""
    until_us = after_us + PERIOD_US * INSTANTS
    flight = np.zeros((INSTANTS, scenario.agents), FLIGHT_RECORD)
    flight["time_us"] = after_us + PERIOD_US * np.arange(1, INSTANTS + 1)[:, None]
    flight["uav"] = np.arange(scenario.agents)
    flight["alive"] = True
    flight["pos_ned_m"][:, :, 1] = 3.0 * np.arange(scenario.agents)
    flight["pos_ned_m"][:, :, 2] = -np.arange(1.0, INSTANTS + 1.0)[:, None]
    flight["q_ned_frd"][:, :, 0] = 1.0
    flight["desired_pos_ned_m"] = flight["onboard_pos_ned_m"] = flight["pos_ned_m"]
    air = np.zeros(len(busy_ns), AIR_RECORD)
    air["time_us"], air["busy_ns"] = until_us, list(busy_ns)
    return Piece(
        after_us=after_us,
        until_us=until_us,
        flight=flight,
        frames=np.empty(0, FRAME_LOG),
        sessions=np.empty(0, SESSION_LOG),
        air=air,
        sensors=np.empty(0, SENSOR_RECORD),
        events=[],
    )
