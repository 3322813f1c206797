"""Evaluates conditions and causes: the bits from which the commander decides.

Their sources are estimator, sensors, links, battery, geofence and failure detector. Those that tolerate a
delay are evaluated at 10 Hz. The monitor does not decide anything.
"""

from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.battery import BatteryMonitor, BatterySimulator, BatteryWarning
from autopilot.commander.failsafe import US_PER_S, Cause
from autopilot.commander.failure_detector import AttitudeFailure, FailureDetector
from autopilot.commander.geofence import Breach, Geofence, Origin
from autopilot.estimation.sensor_input import TIMEOUTS_US, SensorInput
from autopilot.mavlink.codec import Message
from autopilot.parameters.table import ParameterSet
from autopilot.services.flight_data import FlightData
from autopilot.services.manual_control import ManualControlService
from autopilot.services.offboard import OffboardService
from foundation.airframe.description import Airframe

SLOW_PERIOD_US = 100_000
_TERMINATE = 4
"""Value of GF_ACTION."""


class Monitor:
    """`Condition` and `Cause` bits of one vehicle; call `update` before the commander's."""

    def __init__(
        self,
        parameters: ParameterSet,
        *,
        geofence: Geofence,
        sensors: SensorInput,
        offboard: OffboardService,
        manual: ManualControlService,
        airframe: Airframe,
    ) -> None:
        settings = parameters.settings
        self.battery = BatteryMonitor(settings.battery)
        self.geofence = geofence
        self.breach: Breach | None = None
        """Breach found at the last check."""
        self.failures = FailureDetector(settings.failure_detector)
        self._pack = BatterySimulator(settings.battery_sim, settings.battery, airframe)
        self._sensors = sensors
        self._offboard = offboard
        self._manual = manual
        self._esc_us = 0
        self._ground_station_us: int | None = None
        self._slow_us = 0
        self._slow_causes = int(Cause.GCS_LOST)
        self._slow_conditions = 0
        """POSITION and VELOCITY if their standard deviation is within limits; CHARGE."""
        self._breached_before = False
        self._aligned = False
        """Whether the attitude was valid once; a later loss is an estimator failure."""
        self._parameters = parameters
        parameters.subscribe(self.battery.set_params, "battery")
        parameters.subscribe(self._pack.set_params, "battery_sim", "battery")
        parameters.subscribe(self.geofence.set_params, "geofence")
        parameters.subscribe(self.failures.set_params, "failure_detector")

    def on_message(self, message: Message, now_us: int) -> None:
        """Record the heartbeat of a ground station."""
        if message.get_msgId() == common.MAVLINK_MSG_ID_HEARTBEAT and message.type == common.MAV_TYPE_GCS:
            self._ground_station_us = now_us

    def update(self, flight: FlightData, *, has_mission: bool) -> None:
        """Set conditions and causes of ``flight``, whose other values are those of this step.

        ``has_mission``: there is a mission that may be flown.
        """
        now_us, armed, motors = flight.now_us, flight.commander.armed, flight.motors()
        sample = self._pack.update(now_us, motors, armed=armed)
        if sample is not None:
            self.battery.update(sample, armed=armed)
        sensors = self._sensors
        if sensors.motor_currents_us > self._esc_us and sensors.motor_currents_a is not None:
            self._esc_us = sensors.motor_currents_us
            if armed:
                thrust_model_factor = self._parameters.settings.control.allocation.thrust_model_factor
                self.failures.on_esc(self._esc_us, sensors.motor_currents_a, motors, thrust_model_factor)
        if now_us >= self._slow_us:
            self._slow_us = now_us + SLOW_PERIOD_US
            self._update_slow(flight)
        flight.conditions, flight.causes = self._evaluate(flight, now_us, has_mission=has_mission)

    def _evaluate(self, flight: FlightData, now_us: int, *, has_mission: bool) -> tuple[int, int]:
        """Return conditions and causes."""
        state, slow, params = flight.state, self._slow_conditions, self._parameters.settings.commander
        causes = self._slow_causes | _OF_BATTERY[self.battery.warning]
        conditions = self._sensors.conditions(now_us) | slow & _CHARGE
        if now_us - flight.clock.estimate_us <= _IMU_TIMEOUT_US:  # otherwise the estimate is outdated
            if state.attitude_valid:
                conditions |= _ATTITUDE
            if state.height_valid:
                conditions |= _HEIGHT
            if state.velocity_valid:
                conditions |= _VELOCITY & slow
            if state.position_valid:
                conditions |= _POSITION & slow
        if flight.home is not None:
            conditions |= _HOME
        if self._offboard.is_fresh(now_us, round(params.offboard_loss_s * US_PER_S)):
            conditions |= _SETPOINTS
        if self._manual.sticks is not None:
            if self._manual.is_fresh(now_us, round(params.manual_loss_s * US_PER_S)):
                conditions |= _MANUAL
            else:
                causes |= _MANUAL_LOST
        if has_mission:
            conditions |= _MISSION
        if not conditions & _GPS:
            causes |= _GPS_LOST
        if conditions & _ATTITUDE:
            self._aligned = True
            failures = self.failures.update(now_us, state.q_ned_frd, armed=flight.commander.armed)
            if failures & _TIPPED:
                causes |= _TIPPED_OVER
            if failures & _MOTOR:
                causes |= _MOTOR_FAILED
        elif self._aligned:
            causes |= _ESTIMATOR_FAILED
        if state.navigation_failed:
            causes |= _ESTIMATOR_FAILED
        return conditions, causes

    def _update_slow(self, flight: FlightData) -> None:
        """Evaluate what tolerates a delay of 0.1 s."""
        params, state = self._parameters.settings.commander, flight.state
        north_m, east_m, _ = state.pos_std_m.tolist()
        vel_north_m_s, vel_east_m_s, _ = state.vel_std_m_s.tolist()
        conditions = 0
        if params.pos_error_max_m < 0.0 or max(north_m, east_m) <= params.pos_error_max_m:
            conditions |= _POSITION
        if params.vel_error_max_m_s == 0.0 or max(vel_north_m_s, vel_east_m_s) <= params.vel_error_max_m_s:
            conditions |= _VELOCITY
        if self.battery.sampled_us is None or self.battery.remaining >= params.arming_battery_min:
            conditions |= _CHARGE
        self._slow_conditions = conditions
        causes = 0
        received_us = self._ground_station_us
        if received_us is None or flight.now_us - received_us > params.gcs_loss_s * US_PER_S:
            causes |= int(Cause.GCS_LOST)
        if state.position_valid and state.height_valid:
            self.breach = self._find_breach(flight)
        if self.breach is not None and self._breached_before:  # twice: once may be a reset
            causes |= int(Cause.GEOFENCE)
        self._breached_before = self.breach is not None
        self._slow_causes = causes

    def _find_breach(self, flight: FlightData) -> Breach | None:
        state = flight.state
        origin = Origin(state.origin_lat_deg, state.origin_lon_deg, state.origin_alt_m)
        home_ned_m = None if flight.home is None else flight.home.pos_ned_m
        terminates = self._parameters.settings.commander.geofence_action == _TERMINATE
        if not self.geofence.params.predict or terminates:  # never terminate because of a predicted breach
            return self.geofence.check(state.pos_ned_m, home_ned_m, origin)
        return self.geofence.check_braking(
            state.pos_ned_m, state.vel_ned_m_s, home_ned_m, origin,
            deceleration_m_s2=self._parameters.settings.control.trajectory.acc_xy_m_s2,
            reaction_s=SLOW_PERIOD_US / US_PER_S,
        )  # fmt: skip


_IMU_TIMEOUT_US = TIMEOUTS_US[Condition.IMU]
# plain integers: operations on the flag types would take longer than the rest
_CHARGE = int(Condition.CHARGE)
_GPS, _ATTITUDE, _HEIGHT = int(Condition.GPS), int(Condition.ATTITUDE), int(Condition.HEIGHT)
_VELOCITY, _POSITION, _HOME = int(Condition.VELOCITY), int(Condition.POSITION), int(Condition.HOME)
_SETPOINTS, _MANUAL, _MISSION = int(Condition.SETPOINTS), int(Condition.MANUAL), int(Condition.MISSION)
_GPS_LOST, _MANUAL_LOST = int(Cause.GPS_LOST), int(Cause.MANUAL_LOST)
_TIPPED_OVER, _MOTOR_FAILED = int(Cause.TIPPED_OVER), int(Cause.MOTOR_FAILED)
_ESTIMATOR_FAILED = int(Cause.ESTIMATOR_FAILED)
_TIPPED, _MOTOR = int(AttitudeFailure.ROLL | AttitudeFailure.PITCH), int(AttitudeFailure.MOTOR)
_OF_BATTERY = {
    BatteryWarning.NONE: 0,
    BatteryWarning.LOW: int(Cause.BATTERY_LOW),
    BatteryWarning.CRITICAL: int(Cause.BATTERY_CRITICAL),
    BatteryWarning.EMERGENCY: int(Cause.BATTERY_EMERGENCY),
}
