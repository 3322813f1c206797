"""A whole vehicle in the one-process simulation, with several sources of setpoints."""

import numpy as np
from pymavlink.dialects.v20 import common
from vehicle_world import STEP_US, Flight, vehicle_config

from autopilot.mavlink.modes import FlightMode
from autopilot.services.service import GROUND_STATION, Partner
from foundation.geometry.geodesy import ned_to_geodetic
from foundation.geometry.rotations import quat_to_euler

NAN = float("nan")
ACCEPTED = common.MAV_RESULT_ACCEPTED
TAKE_OFF = common.MAV_CMD_NAV_TAKEOFF
STATION = Partner(GROUND_STATION, 0)
PERIOD = 12
"""Steps between setpoints: 21 Hz."""
QUICK = {"COM_SPOOLUP_TIME": 0.0, "MPC_TKO_RAMP_T": 0.5}


class Streamed(Flight):
    """In addition to the ground station of `Flight`, other sources may send setpoints."""

    def __init__(self, **params):
        super().__init__(vehicle_config(params=QUICK | params))
        self.streams = {}
        """Messages that each source sends repeatedly."""

    def step(self, **details):
        if self.now_us // STEP_US % PERIOD == 0:
            for source, message in self.streams.items():
                self.vehicle.offboard.on_message(message, self.now_us, source)
        return super().step(**details)

    @property
    def state(self):
        return self.vehicle.flight.state

    @property
    def yaw_rad(self):
        return quat_to_euler(self.state.q_ned_frd)[2]

    @property
    def mode(self):
        return self.vehicle.commander.mode

    def lift(self, height_m=5.0):
        """Take off, and run until the vehicle is at rest."""
        commander = self.vehicle.commander
        assert self.run(20.0, until=lambda: commander.arm(self.now_us) is None)
        assert self.command(TAKE_OFF, *[NAN] * 6, self.state.origin_alt_m + height_m) == ACCEPTED
        assert self.run(20.0, until=lambda: self.mode is FlightMode.HOLD)
        self.run(2.0)

    def offboard(self, message, source=STATION):
        self.streams[source] = message
        self.run(0.1)
        self.vehicle.offboard.ask(source, self.now_us)
        assert self.vehicle.commander.set_mode(FlightMode.OFFBOARD) is None

    def place(self, north_m, east_m):
        """Return latitude and longitude of a position from the estimator's origin."""
        state = self.state
        lat, lon, _ = ned_to_geodetic(
            [north_m, east_m, 0.0], origin_lat_deg=state.origin_lat_deg, origin_lon_deg=state.origin_lon_deg,
            origin_alt_m=state.origin_alt_m,
        )  # fmt: skip
        return float(lat), float(lon)

    def amsl(self, height_m):
        return self.state.origin_alt_m + height_m

    def gather(self, seconds, what):
        rows = []
        self.run(seconds, until=lambda: rows.append(np.array(what())))
        return np.array(rows)
