"""ArduPilot's JSON interface to simulators: states as lines of text, motor outputs as binary packets.

Sources: libraries/SITL/SIM_JSON.cpp and examples/JSON/readme.md of ArduPilot. ArduPilot sends a servo packet
and waits for the next state; the time stamp of a state advances its clock. It models barometer, compass and
receiver itself from the state, so

- ``position`` carries the barometer's altitude instead of the true one: ArduPilot uses the height for its
  barometer only, whose own noise is off (SIM_BARO_RND),
- the receiver's fixes are sent as GPS_INPUT on a MAVLink link,
- the compass is ArduPilot's, from the true attitude, with its own noise (SIM_MAG_RND).

No I/O: `harness.simulator.ardupilot_link` has the sockets.
"""

import struct
from collections.abc import Iterable
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from autopilot.commander.battery import BatteryParams, BatterySample, BatterySimParams, BatterySimulator
from autopilot.estimation.atmosphere import altitude_m
from autopilot.mavlink.codec import Encoder
from autopilot.mavlink.hil import HilActuatorControls
from autopilot.parameters.config import Site
from foundation.types import Array
from harness.simulator.hil_frames import SIMULATOR_COMPONENT_ID, SIMULATOR_SYSTEM_ID
from harness.simulator.parameter_check import ParameterCheck
from harness.world.physics.truth import Truth
from harness.world.sensors.suite import GpsFixes, SensorFrame

SERVO_PACKETS = {18_458: struct.Struct("<HHI16H"), 29_569: struct.Struct("<HHI32H")}
"""By magic number: frame rate in Hz, number of the frame, and pulse widths in us."""
_MAGIC = struct.Struct("<H")
PWM_MIN_US, PWM_MAX_US = 1_000, 2_000
"""Pulse widths of controls 0 and 1: MOT_PWM_MIN and MOT_PWM_MAX."""
CONTROLS, ROTORS = 16, 4
"""Outputs of an answer, and those of the Iris, the only airframe that an ArduPilot may fly."""
_HALF_US = 0.5
"""ArduPilot adds the difference of two time stamps, as a floating-point number of us, to an integer and cuts
off the fraction: half a microsecond more in each step makes the sum exact."""
_SATELLITES = 10
_HDOP, _VDOP = 0.9, 1.4
"""Dilutions of precision of ten satellites in an open sky; the accuracies in metres are the model's."""
_GPS_EPOCH_UNIX_S, _LEAP_S, _WEEK_S = 315_964_800, 18, 604_800


class ServoPacket(NamedTuple):
    """One packet of ArduPilot."""

    frame_rate_hz: int
    frame_count: int
    pwm_us: tuple[int, ...]
    """(16,) or (32,); 0: no output yet."""

    def answer(self, time_us: int) -> HilActuatorControls:
        """Return the packet as the answer to the state of ``time_us``.

        The motors are outputs 1 to 4, in PX4's order, which ArduPilot's frame "quad X" has too. An armed
        motor turns at MOT_SPIN_ARM at least, so all pulses at `PWM_MIN_US` or below are those of a disarmed
        vehicle.
        """
        span_us = PWM_MAX_US - PWM_MIN_US
        motors = [min(max((pulse_us - PWM_MIN_US) / span_us, 0.0), 1.0) for pulse_us in self.pwm_us[:ROTORS]]
        armed = common.MAV_MODE_FLAG_SAFETY_ARMED if any(motors) else 0
        return HilActuatorControls(time_us, (*motors, *[0.0] * (CONTROLS - ROTORS)), armed, 0)


def servo_packet(data: bytes | memoryview) -> ServoPacket | None:
    """Return the packet in a datagram; None if it is none of ArduPilot's."""
    if len(data) < _MAGIC.size:
        return None
    layout = SERVO_PACKETS.get(_MAGIC.unpack_from(data)[0])
    if layout is None or len(data) != layout.size:
        return None
    _, rate_hz, count, *pwm_us = layout.unpack(data)
    return ServoPacket(rate_hz, count, tuple(pwm_us))


class StateEncoder:
    """Encodes the states and fixes of one vehicle.

    ``epoch_us`` is the date of simulated time 0, Unix time in us; ``parameters`` are those that the vehicle
    must have. Units of a line: s, rad/s, m/s^2, m and m/s in NED from the site's origin, V and A.
    """

    def __init__(
        self, vehicle: int, *, site: Site, step_us: int, epoch_us: int, parameters: Iterable[str] = ()
    ) -> None:
        self._vehicle = vehicle
        self._site = site
        self._step_us = step_us
        self._epoch_us = epoch_us
        self._sensed_height_m = 0.0
        """By the barometer, above the site."""
        self._battery = BatterySimulator(BatterySimParams(), BatteryParams())
        self._pack = ""
        """The newest sample of the battery."""
        self._encoder = Encoder(system=SIMULATOR_SYSTEM_ID, component=SIMULATOR_COMPONENT_ID)
        self.parameters = ParameterCheck(parameters, target_system=vehicle + 1, encoder=self._encoder)

    def encode(
        self, time_us: int, frame: SensorFrame, truth: Truth, controls: Array, *, armed: bool
    ) -> bytes:
        """Return the line of a step, which begins and ends with a line feed, and MAVLink messages after it.

        They are GPS_INPUT if a fix is due, and requests of parameters that are not known to exist.

        ``controls`` (4,) are the motors' of the last step, which the battery has fed.
        """
        sample = self._battery.update(time_us, controls.tolist(), armed=armed)
        if sample is not None:
            self._pack = _battery(sample)
        line = self._line(time_us, frame, truth) + self.parameters.requests(time_us)
        return line if frame.gps is None else line + self._fix(time_us, frame.gps)

    def _line(self, time_us: int, frame: SensorFrame, truth: Truth) -> bytes:
        """Return the state and the sensors, with the newest samples of battery and barometer."""
        vehicle = self._vehicle
        if frame.baro is not None:
            sensed_m = altitude_m(float(frame.baro.pressure_hpa[vehicle]) * 100.0)
            self._sensed_height_m = sensed_m - self._site.altitude_m
        steps = time_us // self._step_us
        time_s = (time_us + steps * _HALF_US) * 1e-6
        (north_m, east_m, _), (vel_n, vel_e, vel_d) = truth.pos_ned_m[vehicle], truth.vel_ned_m_s[vehicle]
        w, x, y, z = truth.q_ned_frd[vehicle]
        gyro_x, gyro_y, gyro_z = frame.gyro_frd_rad_s[vehicle]
        acc_x, acc_y, acc_z = frame.accel_frd_m_s2[vehicle]
        return (
            f'\n{{"timestamp":{time_s:.7f},"imu":{{"gyro":[{gyro_x:.7g},{gyro_y:.7g},{gyro_z:.7g}],'
            f'"accel_body":[{acc_x:.7g},{acc_y:.7g},{acc_z:.7g}]}},'
            f'"position":[{north_m:.4f},{east_m:.4f},{-self._sensed_height_m:.4f}],'
            f'"velocity":[{vel_n:.5f},{vel_e:.5f},{vel_d:.5f}],'
            f'"quaternion":[{w:.7f},{x:.7f},{y:.7f},{z:.7f}]{self._pack}}}\n'
        ).encode()

    def _fix(self, time_us: int, fixes: GpsFixes) -> bytes:
        """Return GPS_INPUT with this vehicle's fix."""
        vehicle, time_unix_us = self._vehicle, time_us + self._epoch_us
        lost = fixes.lost is not None and bool(fixes.lost[vehicle])
        gps_ms = time_unix_us // 1_000 - (_GPS_EPOCH_UNIX_S - _LEAP_S) * 1_000
        week, week_ms = divmod(max(gps_ms, 0), _WEEK_S * 1_000)
        north_m_s, east_m_s, down_m_s = fixes.vel_ned_m_s[vehicle]
        message = common.MAVLink_gps_input_message(
            time_unix_us, 0, common.GPS_INPUT_IGNORE_FLAG_SPEED_ACCURACY, week_ms, week,
            common.GPS_FIX_TYPE_NO_FIX if lost else common.GPS_FIX_TYPE_3D_FIX,
            round(fixes.lat_deg[vehicle] * 1e7), round(fixes.lon_deg[vehicle] * 1e7), fixes.alt_m[vehicle],
            _HDOP, _VDOP, north_m_s, east_m_s, down_m_s, 0.0, fixes.eph_m, fixes.epv_m,
            0 if lost else _SATELLITES,
        )  # fmt: skip
        return self._encoder.encode(message)


def _battery(sample: BatterySample) -> str:
    return f',"battery":{{"voltage":{sample.voltage_v:.3f},"current":{sample.current_a or 0.0:.3f}}}'
