"""Telemetry over serial modems in one process: rates, flow control, loss of the link by range."""

import contextlib

import pytest
from ground_flight import GroundFlight, in_process

from autopilot.mavlink.codec import Parser
from autopilot.mavlink.modes import FlightMode
from autopilot.mavlink.serial_carrier import MODEM_COMPONENT, MODEM_SYSTEM
from autopilot.services.flow_control import BYTES_S
from autopilot.services.service import GROUND_STATION
from harness.ground_station.serial_relay import SerialRelay

LINK_BYTES_S = 3_300
"""More than one modem of 64 kbit/s transports of short MAVLink frames (docs/concepts/radio.md)."""
LOSS_S, DELAY_S = 5.0, 1.0
RANGE_M = 30.6
"""Where 0 dBm less 31.7 dB at 1 m and 50 dB a decade are -106 dBm, the sensitivity at 64 kbit/s."""
BEHIND_M = 15.0
SERIAL = [
    "agents=1", "formation.columns=1", "formation.rows=1", "onboard.enabled=false", "wind.mean_n=0",
    "links.telemetry=serial-radio", f"stations=[{{name='ground', pos_ned_m=[{-BEHIND_M}, 0.0, 0.0]}}]",
]  # fmt: skip
TAKE_OFF = "{command='takeoff', height_m=4.0}"
FAR_AWAY = "{command='waypoint', north_m=300.0, east_m=0.0, height_m=4.0}"
OUT_OF_RANGE = [
    "radio.path_loss_exponent=5.0", "serial_radio.tx_power_dbm=0.0", "autopilot.params.NAV_DLL_ACT=2",
    f"autopilot.params.COM_DL_LOSS_T={LOSS_S}", f"autopilot.params.COM_FAIL_ACT_T={DELAY_S}",
    "autopilot.params.RTL_RETURN_ALT=4", "autopilot.params.MPC_XY_CRUISE=10",
    f"autopilot.mission=[{TAKE_OFF}, {FAR_AWAY}]",
]  # fmt: skip


class SerialFlight(GroundFlight):
    """The ground station's modem."""

    def __init__(self, flight):
        super().__init__(flight, SerialRelay(1))
        self._parser = Parser()
        self.received = []
        """Messages that the ground station has received."""

    def on_datagram(self, datagram):
        self.received += self._parser.push(datagram)

    @property
    def counts(self):
        return self.link_counts["serial"]["ground"]

    @property
    def ground_bytes(self):
        return self.relay.counts["uav 0"]["received_bytes"]

    def count(self, kind):
        return sum(message.get_type() == kind for message in self.received)

    def run(self, seconds, each_second=lambda: None):
        end_s = self.time_s + seconds
        self.until(lambda: self.time_s >= end_s, seconds + 1.0, each_second)


@pytest.fixture
def fly(tmp_path):
    with contextlib.ExitStack() as stack:
        yield lambda *overrides: SerialFlight(
            stack.enter_context(in_process(tmp_path / "run", [*SERIAL, *overrides]))
        )


def test_telemetry_keeps_to_the_data_rate_of_a_telemetry_port(fly):
    flight = fly()
    flight.run(5.0)
    bytes_before, heartbeats = flight.ground_bytes, flight.count("HEARTBEAT")
    flight.run(10.0)
    rate_bytes_s = (flight.ground_bytes - bytes_before) / 10.0
    assert 0.5 * BYTES_S < rate_bytes_s < 1.2 * BYTES_S
    assert flight.count("HEARTBEAT") - heartbeats in range(9, 12)
    # both modems report after the heartbeats of their hosts
    reports = [message for message in flight.received if message.get_type() == "RADIO_STATUS"]
    assert len(reports) >= 13
    assert {(each.get_srcSystem(), each.get_srcComponent()) for each in reports} == {
        (MODEM_SYSTEM, MODEM_COMPONENT)
    }
    assert min(each.rssi for each in reports) > max(each.noise for each in reports)
    assert flight.counts["radio_status"] >= 13


def test_streams_adapt_to_a_link_that_is_slower_than_they_are(fly):
    flight = fly("links.bandwidth_bytes_s=20000")
    streams = flight.vehicle.messaging.streams[GROUND_STATION]
    for kind in (30, 31, 32, 33, 83, 85):
        assert streams.set_interval(kind, 20_000, 0)
    assert sum(streams.needs_bytes_s) > 4 * LINK_BYTES_S
    factors, lost = [], []

    def note():
        factors.append(streams.rate_factor)
        lost.append(flight.is_lost)

    flight.run(20.0, note)
    sent, received, heartbeats = flight.counts["sent_bytes"], flight.ground_bytes, flight.count("HEARTBEAT")
    flight.run(20.0, note)
    assert max(factors[:2]) == 1.0
    assert max(factors[20:]) < 0.5
    sent_bytes_s, received_bytes_s = (
        (flight.counts["sent_bytes"] - sent) / 20,
        (flight.ground_bytes - received) / 20,
    )
    assert 0.7 * LINK_BYTES_S < received_bytes_s < LINK_BYTES_S
    assert sent_bytes_s == pytest.approx(received_bytes_s, rel=0.1)
    assert flight.count("HEARTBEAT") - heartbeats >= 15
    assert not any(lost[3:])


def test_a_vehicle_out_of_range_of_its_modem_returns(fly):
    flight = fly(*OUT_OF_RANGE)
    commander = flight.vehicle.commander

    flight.until(lambda: commander.armed, 20.0, flight.begin_mission)
    assert not flight.is_lost
    flight.until(lambda: flight.is_lost, 30.0)
    lost_s = flight.time_s
    # at 10 m/s or less; 1 s of heartbeats and 1 dB of range
    assert RANGE_M - BEHIND_M - 2.0 < flight.north_m < RANGE_M - BEHIND_M + 10.0 * (LOSS_S + 2.0)
    flight.until(lambda: commander.mode is FlightMode.RETURN, 5.0)
    assert flight.time_s - lost_s == pytest.approx(DELAY_S, abs=0.2)
    flight.until(lambda: not flight.is_lost, 60.0)
    assert commander.mode is FlightMode.RETURN
