"""HIL_STATE_QUATERNION and the delivery flag of HIL_SENSOR, decoded as the vehicle decodes them."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from world_truth import truth_with

from autopilot.mavlink.hil import HilParser, HilSensor
from autopilot.parameters.config import Site
from foundation.geometry.geodesy import geodetic_to_ned
from harness.simulator.hil import SensorEncoder
from harness.world.sensors.suite import SensorFrame
from netsim.wire.lockstep import BATCH_DELIVERED

SITE = Site(latitude_deg=60.2, longitude_deg=24.8, altitude_m=30.0)


def truth_of(pos_ned_m, vel_ned_m_s):
    n = len(pos_ned_m)
    return truth_with(
        pos_ned_m=np.array(pos_ned_m),
        vel_ned_m_s=np.array(vel_ned_m_s),
        q_ned_frd=np.tile((1.0, 0.0, 0.0, 0.0), (n, 1)),
        omega_frd_rad_s=np.zeros((n, 3)),
        acc_ned_m_s2=np.zeros((n, 3)),
        rotor_speed_rad_s=np.zeros((n, 4)),
        specific_force_frd_m_s2=np.zeros((n, 3)),
        mean_omega_frd_rad_s=np.zeros((n, 3)),
    )


def quiet_frame(n):
    return SensorFrame(
        time_us=1_000_000,
        accel_frd_m_s2=np.zeros((n, 3)),
        gyro_frd_rad_s=np.zeros((n, 3)),
        mag_frd_gauss=None,
        baro=None,
        gps=None,
    )


def test_the_true_position_precedes_the_sensors_and_is_exact_to_a_centimetre():
    pos_ned_m = [(0.0, 0.0, -10.0), (123.456, -654.321, -42.0)]
    truth = truth_of(pos_ned_m, [(0.0, 0.0, 0.0), (1.25, -2.5, 0.75)])
    for vehicle, frame in enumerate(SensorEncoder(SITE).encode(1_000_000, quiet_frame(2), truth=truth)):
        state, sensor = HilParser(HilSensor).push(frame)
        assert state.get_msgId() == common.MAVLINK_MSG_ID_HIL_STATE_QUATERNION
        assert isinstance(sensor, HilSensor)
        found_ned_m = geodetic_to_ned(
            state.lat * 1e-7, state.lon * 1e-7, state.alt * 1e-3,
            origin_lat_deg=SITE.latitude_deg, origin_lon_deg=SITE.longitude_deg, origin_alt_m=SITE.altitude_m,
        )  # fmt: skip
        # half a unit of 1e-7 degrees is 5.6 mm on a meridian
        assert found_ned_m == pytest.approx(pos_ned_m[vehicle], abs=6e-3)
        assert np.array((state.vx, state.vy, state.vz)) * 1e-2 == pytest.approx(truth.vel_ned_m_s[vehicle])


def test_sequence_numbers_run_on_with_and_without_the_truth():
    encoder, truth, numbers = SensorEncoder(SITE), truth_of([(0.0, 0.0, 0.0)], [(0.0, 0.0, 0.0)]), []
    for sent in (None, truth, None, truth):
        (frame,) = encoder.encode(1_000, quiet_frame(1), truth=sent)
        while frame:
            size = 10 + frame[1] + 2
            numbers.append(frame[4])
            frame = frame[size:]
    assert numbers == [0, 1, 2, 3, 4, 5]


def test_a_delivery_is_flagged_in_hil_sensor_beside_its_updated_fields():
    quiet, notified = (
        [
            HilParser(HilSensor).push(bytes(frame))[0]
            for frame in SensorEncoder().encode(1_000, quiet_frame(3), **more)
        ]
        for more in ({}, {"delivered": (0, 2)})
    )
    assert [s.fields_updated & BATCH_DELIVERED for s in notified] == [BATCH_DELIVERED, 0, BATCH_DELIVERED]
    cleared = [s._replace(fields_updated=s.fields_updated & ~BATCH_DELIVERED) for s in notified]
    assert cleared == quiet
