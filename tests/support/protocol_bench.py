"""State of a vehicle without the vehicle, and its commands as one partner sends them."""

import math

from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.commander import Commander
from autopilot.commander.params import CommanderParams
from autopilot.estimation.estimator import Estimator
from autopilot.estimation.params import EstimatorParams
from autopilot.mavlink.codec import Encoder, Parser, stamp
from autopilot.navigation.mode_registry import mode_table
from autopilot.parameters.table import ParameterSet, Settings
from autopilot.services.actions_flight import FlightActions, FlightCommands
from autopilot.services.actions_system import SystemCommands
from autopilot.services.calibration import Calibration
from autopilot.services.command import CommandService, TakeoffAltitude
from autopilot.services.flight_data import FlightData, Home
from autopilot.services.manual_control import ManualControlService
from autopilot.services.service import Partner
from autopilot.services.streams import GROUND_STATION_HZ, MessageStreams
from autopilot.services.telemetry import Telemetry

NAN = math.nan
EVERYTHING = sum(Condition)
CLIENT = Partner(0, 3)
HOME = Home(lat_deg=47.0, lon_deg=8.0, alt_m=400.0, pos_ned_m=(0.0, 0.0, 0.0), q_ned_frd=(1.0, 0.0, 0.0, 0.0))
TAKEOFF_HEIGHT_M = 2.5


def make_flight():
    estimator = Estimator(EstimatorParams())
    return FlightData(
        estimator=estimator,
        commander=Commander(CommanderParams(), mode_table()),
        state=estimator.state,
        conditions=EVERYTHING,
    )


def make_telemetry(flight, **more):
    return Telemetry(flight, system=7, manual=ManualControlService(flight.commander), **more)


def over_the_wire(message):
    (decoded,) = Parser().push(Encoder(system=255, component=190).encode(message))
    return decoded


class Commanded:
    """Command service whose flight actions are recorded in ``done`` and return ``refusal``."""

    def __init__(self):
        self.flight = make_flight()
        self.flight.home = HOME
        self.commander = self.flight.commander
        self.altitude = TakeoffAltitude()
        self.telemetry = make_telemetry(self.flight)
        self.streams = MessageStreams(self.telemetry.builders, GROUND_STATION_HZ)
        self.done = []
        self.refusal = None
        self.woken = 0
        self.has_file = True
        self.parameters = ParameterSet(Settings())
        self.mission_items = 5
        self.calibration = Calibration(self.flight, wake=self._wake)
        flying = FlightCommands(
            self.flight,
            self.altitude,
            FlightActions(
                ask_offboard=self._recorder("ask_offboard"),
                reposition=self._recorder("reposition"),
                orbit=self._recorder("orbit"),
                change_speed=self._recorder("change_speed"),
                set_home=self._recorder("set_home"),
                set_home_here=self._recorder("set_home_here"),
                has_mission_item=lambda seq: seq < self.mission_items,
                set_mission_current=lambda seq: (
                    not self.done.append(("seq", seq)) and seq < self.mission_items
                ),
                takeoff_height_m=lambda: TAKEOFF_HEIGHT_M,
            ),
        )
        system = SystemCommands(
            {0: self.streams},
            calibrate=self.calibration.command,
            save_parameters=lambda: self.has_file,
            parameters=self.parameters,
            is_armed=lambda: self.commander.armed,
            modes=self.commander.modes,
        )
        self.table = flying.table | system.table
        self.service = CommandService(self.table)
        self.hold(EVERYTHING)

    def hold(self, conditions, *, landed=True):
        self.flight.conditions = conditions
        self.commander.update(0, conditions=conditions, landed=landed)

    def long(self, command, *params, confirmation=0, now_us=0):
        padded = [*params, *[0.0] * (7 - len(params))]
        return self.send(
            common.MAVLink_command_long_message(1, 1, command, confirmation, *padded), command, now_us
        )

    def int(self, command, *params, frame=common.MAV_FRAME_GLOBAL_INT, x=0, y=0, z=0.0, now_us=0):
        padded = [*params, *[0.0] * (4 - len(params))]
        message = common.MAVLink_command_int_message(1, 1, frame, command, 0, 0, *padded, x, y, z)
        return self.send(message, command, now_us)

    def send(self, message, command, now_us=0):
        """Return result and other messages; assert that there is one acknowledgement, to the sender."""
        answers = self.service.on_message(stamp(message, system=255, component=190), now_us, CLIENT)
        (ack, *others) = [message for _, message in answers]
        assert answers[0].partner == CLIENT
        assert ack.get_type() == "COMMAND_ACK"
        assert (ack.command, ack.target_system, ack.target_component) == (command, 255, 190)
        assert all(other.get_type() != "COMMAND_ACK" for other in others)
        return ack.result, others

    def _recorder(self, name):
        def act(*values):
            self.done.append((name, *values))
            return self.refusal

        return act

    def _wake(self):
        self.woken += 1
