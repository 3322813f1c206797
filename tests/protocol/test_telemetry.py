"""Telemetry: the fields on which clients base decisions."""

import math

import numpy as np
import pytest
from protocol_bench import EVERYTHING, make_flight, make_telemetry, over_the_wire
from pymavlink.dialects.v20 import common

from autopilot.commander.arming_checks import Condition
from autopilot.commander.failsafe import Cause
from autopilot.mavlink.codec import Encoder, Parser
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.flight_mode import ManualInput
from autopilot.services.manual_control import ManualControlService
from autopilot.services.status import TEXT_BYTES, Chunks, status_text
from autopilot.services.telemetry import Telemetry
from autopilot.services.telemetry_sensors import Vibration
from foundation.types import TrajectorySetpoint

GEOFENCE, RECEIVER = common.MAV_SYS_STATUS_GEOFENCE, common.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
MERIDIAN_RADIUS_AT_47_M = 6_378_137.0 * (1.0 - 0.00669438) / (1.0 - 0.00669438 * 0.5348783) ** 1.5
"""WGS 84's a (1 - e^2) / (1 - e^2 sin^2)^1.5"""
EPOCH_US = 1_767_225_600_000_000


def sensor(**values):
    fields = dict.fromkeys(
        (
            "xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro", "xmag", "ymag", "zmag",
            "abs_pressure", "diff_pressure", "pressure_alt", "temperature",
        ),
        0.0,
    )  # fmt: skip
    return common.MAVLink_hil_sensor_message(**({"time_usec": 0, "fields_updated": 0} | fields | values))


def test_before_the_first_estimate_every_builder_returns_none_or_a_valid_message():
    encoder = Encoder(system=1, component=1)
    for message_id, build in make_telemetry(make_flight()).builders.items():
        message = build()
        if message is not None:
            (decoded,) = Parser().push(encoder.encode(message))
            assert decoded.get_msgId() == message_id


# ---- texts


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 99, 100, 101, 150, 12_000])
def test_a_text_of_any_length_arrives_complete(length):
    text = "".join(chr(ord("a") + i % 26) for i in range(length))
    pieces = [over_the_wire(piece) for piece in Chunks().split(status_text(4, text))]
    assert "".join(piece.text for piece in pieces) == text
    assert {piece.severity for piece in pieces} == {4}
    if length <= TEXT_BYTES:
        assert [piece.id for piece in pieces] == [0]
    else:
        assert {piece.id for piece in pieces} == {1}
        assert [piece.chunk_seq for piece in pieces] == list(range(len(pieces)))
        assert all(len(piece.text) == TEXT_BYTES for piece in pieces[:-1])
        assert len(pieces[-1].text) < TEXT_BYTES  # which marks the last chunk for the receiver


def test_chunks_of_different_texts_have_different_ids_and_other_messages_pass():
    chunks = Chunks()
    ids = {chunks.split(status_text(4, "x" * 60))[0].id for _ in range(100)}
    assert len(ids) == 100
    assert 0 not in ids
    other = common.MAVLink_system_time_message(0, 0)
    assert chunks.split(other) == (other,)


def test_a_fix_has_equal_heights_above_ellipsoid_and_sea_level():
    flight = make_flight()
    flight.gps = common.MAVLink_hil_gps_message(0, 3, 47, 8, 488_123, 90, 178, 0, 0, 0, 0, 0, 10)
    gps = over_the_wire(make_telemetry(flight).sensors.gps_raw_int())
    assert (gps.alt, gps.alt_ellipsoid) == (488_123, 488_123)


# ---- health


def status_of(flight, **more):
    return make_telemetry(flight, **more).system.sys_status()


def test_a_vehicle_that_may_be_armed_reports_all_present_sensors_as_healthy():
    flight = make_flight()
    flight.commander.update(0, conditions=EVERYTHING, landed=True)
    status = status_of(flight)
    assert status.onboard_control_sensors_health == status.onboard_control_sensors_present | GEOFENCE
    assert status.onboard_control_sensors_present == status.onboard_control_sensors_enabled
    assert status.onboard_control_sensors_present & common.MAV_SYS_STATUS_PREARM_CHECK
    assert not status.onboard_control_sensors_present & (GEOFENCE | RECEIVER)


@pytest.mark.parametrize(
    ("missing", "bit"),
    [
        (Condition.IMU, common.MAV_SYS_STATUS_SENSOR_3D_GYRO),
        (Condition.IMU, common.MAV_SYS_STATUS_SENSOR_3D_ACCEL),
        (Condition.MAG, common.MAV_SYS_STATUS_SENSOR_3D_MAG),
        (Condition.BARO, common.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE),
        (Condition.GPS, common.MAV_SYS_STATUS_SENSOR_GPS),
    ],
)
def test_a_failed_sensor_is_present_but_unhealthy_and_prevents_arming(missing, bit):
    flight = make_flight()
    flight.conditions = EVERYTHING & ~missing
    flight.commander.update(0, conditions=flight.conditions, landed=True)
    status = status_of(flight)
    assert status.onboard_control_sensors_present & bit
    assert not status.onboard_control_sensors_health & (bit | common.MAV_SYS_STATUS_PREARM_CHECK)


def test_an_absent_fence_is_not_breached():
    """MAVProxy evaluates its health bit alone, and would report "fence breach" on connection."""
    status = status_of(make_flight(), fenced=lambda: False)
    assert status.onboard_control_sensors_health & GEOFENCE
    assert not (status.onboard_control_sensors_present | status.onboard_control_sensors_enabled) & GEOFENCE


def test_a_fence_is_reported_as_present_and_is_unhealthy_when_breached():
    flight = make_flight()
    assert status_of(flight, fenced=lambda: True).onboard_control_sensors_health & GEOFENCE
    flight.causes = int(Cause.GEOFENCE)
    status = status_of(flight, fenced=lambda: True)
    assert status.onboard_control_sensors_present & GEOFENCE
    assert not status.onboard_control_sensors_health & GEOFENCE


def test_sticks_are_reported_as_a_receiver_and_channels():
    flight = make_flight()
    manual = ManualControlService(flight.commander)
    telemetry = Telemetry(flight, system=1, manual=manual)
    assert telemetry.sensors.rc_channels() is None
    manual.sticks = ManualInput(time_us=0, roll=-1.0, pitch=0.5, yaw=0.0, throttle=1.0)
    channels = over_the_wire(telemetry.sensors.rc_channels())
    assert channels.chancount == 4
    assert [channels.chan1_raw, channels.chan2_raw, channels.chan3_raw, channels.chan4_raw] == [
        1000, 1750, 2000, 1500,
    ]  # fmt: skip
    assert channels.chan5_raw == channels.chan18_raw == 65_535
    assert telemetry.system.sys_status().onboard_control_sensors_health & RECEIVER
    flight.conditions &= ~Condition.MANUAL
    status = telemetry.system.sys_status()
    assert status.onboard_control_sensors_present & RECEIVER
    assert not status.onboard_control_sensors_health & RECEIVER


# ---- versions and time


def test_versions_and_ids():
    version = over_the_wire(make_telemetry(make_flight()).system.autopilot_version())
    parts = [version.flight_sw_version >> shift & 0xFF for shift in (24, 16, 8, 0)]
    assert parts == [1, 17, 0, common.FIRMWARE_VERSION_TYPE_OFFICIAL]
    for needed in ("MISSION_INT", "MISSION_FENCE", "MISSION_RALLY", "FTP", "COMMAND_INT", "MAVLINK2"):
        assert version.capabilities & getattr(common, f"MAV_PROTOCOL_CAPABILITY_{needed}")
    assert not version.capabilities & common.MAV_PROTOCOL_CAPABILITY_TERRAIN
    other = Telemetry(make_flight(), system=8, manual=None).system.autopilot_version()
    assert (version.uid, version.uid2) != (other.uid, other.uid2)
    assert version.uid != other.uid
    assert list(version.uid2) != list(other.uid2)


def test_system_time_starts_at_the_scenarios_date():
    flight = make_flight()
    flight.clock.now_us = 12_345_678
    time = over_the_wire(make_telemetry(flight, epoch_unix_us=EPOCH_US).system.system_time())
    assert (time.time_unix_usec, time.time_boot_ms) == (EPOCH_US + 12_345_678, 12_345)


def test_the_current_mode_has_the_intended_mode_if_known():
    flight = make_flight()
    telemetry = make_telemetry(flight)
    flight.commander.mode = FlightMode.RETURN
    mode = over_the_wire(telemetry.system.current_mode())
    assert mode.custom_mode == mode.intended_custom_mode == FlightMode.RETURN.custom_mode
    assert mode.standard_mode == common.MAV_STANDARD_MODE_SAFE_RECOVERY
    flight.commander.failsafe = True
    assert telemetry.system.current_mode().intended_custom_mode == 0


def test_flight_information_has_times_since_the_start():
    flight = make_flight()
    flight.armed_us, flight.took_off_us, flight.landed_us, flight.flights = 5_000_000, 7_000_000, 9_000_000, 2
    information = over_the_wire(make_telemetry(flight).system.flight_information())
    assert (information.arming_time_utc, information.takeoff_time_utc) == (5_000_000, 7_000_000)
    assert (information.flight_uuid, information.landing_time) == (2, 9_000)


# ---- sensors and outputs


def test_scaled_units():
    flight = make_flight()
    flight.sensor = sensor(xacc=9.80665, zgyro=-0.5, ymag=0.25, temperature=21.5)
    scaled = over_the_wire(make_telemetry(flight).sensors.scaled_imu())
    assert (scaled.xacc, scaled.zgyro, scaled.ymag, scaled.temperature) == (1_000, -500, 250, 2_150)
    flight.sensor = sensor(xacc=math.inf, ygyro=math.nan, zmag=-1e30)
    scaled = over_the_wire(make_telemetry(flight).sensors.scaled_imu())
    assert (scaled.xacc, scaled.ygyro, scaled.zmag) == (32_767, 0, -32_768)


def test_vibration_is_the_mean_step_between_samples():
    vibration = Vibration()
    for i in range(2_000):
        vibration.update(
            sensor(time_usec=4_000 * i, zacc=-9.8 + 0.3 * (i % 2), xgyro=0.1 * (i % 2), ygyro=0.2)
        )
    assert vibration.accel == pytest.approx(0.3, rel=1e-3)
    assert vibration.gyro == pytest.approx(0.1, rel=1e-3)
    assert vibration.coning == pytest.approx(0.004**2 * 0.1 * 0.2, rel=1e-3)


def test_outputs_are_the_motor_controls():
    flight = make_flight()
    flight.motors = lambda: (0.1, 0.2, 0.3, 0.4)
    status = over_the_wire(make_telemetry(flight).motion.actuator_output_status())
    assert status.active == 4
    assert status.actuator[:5] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.0])


def test_a_setpoint_is_reported_in_geodetic_coordinates_as_in_the_local_frame():
    flight = make_flight()
    flight.state.origin_lat_deg, flight.state.origin_lon_deg, flight.state.origin_alt_m = 47.0, 8.0, 400.0
    flight.origin_known = True
    flight.setpoint = TrajectorySetpoint(pos_ned_m=np.array((100.0, 0.0, -7.0)), yaw_rad=0.5)
    target = over_the_wire(make_telemetry(flight).motion.position_target_global_int())
    north_m = math.radians(target.lat_int * 1e-7 - 47.0) * MERIDIAN_RADIUS_AT_47_M
    assert north_m == pytest.approx(100.0, abs=0.02)
    assert (target.lon_int, target.yaw) == (80_000_000, 0.5)
    assert target.alt == pytest.approx(407.0, abs=0.01)
    local = make_telemetry(flight).motion.position_target_local_ned()
    assert target.type_mask == local.type_mask


def test_the_true_state_is_reported_only_if_available():
    flight = make_flight()
    telemetry = make_telemetry(flight)
    assert telemetry.sensors.hil_state_quaternion() is None
    flight.truth = common.MAVLink_hil_state_quaternion_message(1, [1.0, 0.0, 0.0, 0.0], *[0.0] * 3, *[0] * 11)
    assert telemetry.sensors.hil_state_quaternion() is flight.truth
