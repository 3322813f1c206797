"""A vehicle that flies out of its ground station's range: loss and return of the link by physics."""

import pytest
from ground_flight import GroundFlight, in_process
from pymavlink.dialects.v20 import common

from autopilot.mavlink.modes import FlightMode
from harness.ground_station.relay import Relay

LOSS_S, DELAY_S = 5.0, 1.0
TAKE_OFF = "{command='takeoff', height_m=4.0}"
FAR_AWAY = "{command='waypoint', north_m=300.0, east_m=0.0, height_m=4.0}"
# 10 dBm less 46.8 dB at 1 m and 30 dB a decade are -82 dBm, radio.cca_preamble_dbm, at 32 m
RANGE_M = 32.0
OVERRIDES = [
    "agents=1", "formation.columns=1", "formation.rows=1", "onboard.enabled=false", "wind.mean_n=0",
    "links.telemetry=radio", "stations=[{name='ground', pos_ned_m=[-15.0, 0.0, 0.0]}]",
    "radio.path_loss_exponent=3.0", "radio.tx_power_dbm=10.0", "radio.data_mode=ofdm6",
    "autopilot.params.NAV_DLL_ACT=2", f"autopilot.params.COM_DL_LOSS_T={LOSS_S}",
    f"autopilot.params.COM_FAIL_ACT_T={DELAY_S}", "autopilot.params.RTL_RETURN_ALT=4",
    "autopilot.params.MPC_XY_CRUISE=10",
    f"autopilot.mission=[{TAKE_OFF}, {FAR_AWAY}]",
]  # fmt: skip


class Flight(GroundFlight):
    """The ground station's radio."""

    @property
    def frames(self):
        return self.link_counts["frames"]["ground"]

    @property
    def received(self):
        return self.frames["received"]


@pytest.fixture
def flight(tmp_path):
    with in_process(tmp_path / "run", OVERRIDES) as flown:
        yield Flight(flown, Relay(1, queue_frames=64, queue_lifetime_us=500_000))


def test_a_vehicle_out_of_range_returns_and_the_link_with_it(flight):
    commander = flight.vehicle.commander

    flight.until(lambda: commander.armed, 20.0, flight.begin_mission)
    assert not flight.is_lost
    assert flight.frames["lost"] == 0
    flight.until(lambda: flight.is_lost, 30.0)
    lost_s, known = flight.time_s, flight.received
    # at 10 m/s or less, the last heartbeat having been received up to a second before the range's end
    assert RANGE_M - 15.0 < flight.north_m < RANGE_M - 15.0 + 10.0 * (LOSS_S + 2.0)
    assert flight.frames["lost"] > 100  # telemetry does not get through either
    flight.until(lambda: commander.mode is FlightMode.RETURN, 5.0)
    assert flight.time_s - lost_s == pytest.approx(DELAY_S, abs=0.2)
    farthest_m = flight.north_m
    flight.until(lambda: not flight.is_lost, 30.0)
    assert flight.received == known + 1  # the first heartbeat that arrives
    assert flight.north_m < farthest_m
    # PX4: a link that is there again leaves the return in effect, until another mode is requested
    acknowledged = flight.frames["acknowledged"]
    flight.until(lambda: flight.received >= known + 3, 10.0)
    assert commander.mode is FlightMode.RETURN
    assert flight.frames["acknowledged"] > acknowledged
    flight.command(common.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0)
    flight.until(lambda: commander.mode is FlightMode.HOLD, 2.0)
    assert not commander.failsafe
