"""Accepted faults can be represented in all messages; others are refused by name. 1 s."""

import math

import msgspec
import numpy as np
import pytest
from faults_fixtures import BEGIN_US, ROTORS, N, fault_of, faults_of, fly

from autopilot.mavlink.codec import Parser
from harness.simulator.hil import SensorEncoder
from harness.world import faults as catalogue
from harness.world.faults import AnyFault, UserFault, validated
from netsim.wire.lockstep import Advance


def test_a_fault_of_a_program_is_validated_before_it_is_sent():
    with pytest.raises(ValueError, match=r"^fault\.motor: 7 is none of the 4 motors of UAV 0"):
        validated(catalogue.MotorStop(uav=0, motor=7), ROTORS)
    with pytest.raises(ValueError, match=r'^fault\.uav: .*, expected a number or "all"$'):
        validated(catalogue.GpsLoss(uav="some"), ROTORS)
    with pytest.raises(ValueError, match=r"fault\.uav: 3 is none of 3 vehicles"):
        validated(catalogue.GpsLoss(uav=3), ROTORS)
    sound = catalogue.GpsBias(uav=2, offset_ned_m=(1.0, 2.0, 3.0))
    assert validated(sound, ROTORS) == sound


LIMITS = {
    "gps_bias": {"offset_ned_m": 10_000.0, "rate_m_s": 100.0},
    "gps_noise": {"position_std_m": 1000.0, "velocity_std_m_s": 50.0},
    "accel_bias": {"offset_frd_m_s2": 100.0},
    "gyro_bias": {"offset_frd_rad_s": 35.0},
    "mag_bias": {"offset_frd_gauss": 10.0},
    "mag_yaw": {"heading_error_deg": 180.0},
    "baro_bias": {"offset_m": 5000.0},
    "motor": {"effectiveness": 1.0},
    "radio_attenuation": {"attenuation_db": 300.0},
    "ranging_bias": {"offset_m": 1000.0},
    "gps_loss": {"start_s": 1e6, "duration_s": 1e6},
}
FIELDS = [(name, field, most) for name, limits in LIMITS.items() for field, most in limits.items()]


@pytest.mark.parametrize(("name", "field", "most"), FIELDS)
def test_every_number_has_a_finite_limit(name, field, most):
    """The limit itself is accepted; larger, infinite and NaN values are refused by name.

    So it is in a scenario, and in a fault that a program injects.
    """

    def put(value):
        return {field: (0.0, value, 0.0) if field.startswith("offset_") and field != "offset_m" else value}

    sound = fault_of(name, **put(most))
    for value in (most * (1.0 + 1e-9), math.inf, -math.inf, math.nan):
        with pytest.raises(msgspec.ValidationError, match=field):
            fault_of(name, **put(value))
        with pytest.raises(ValueError, match=rf"^fault\.{field}"):
            validated(msgspec.structs.replace(sound, **put(value)), ROTORS)


def test_every_float_of_every_fault_has_a_test_of_its_limit():
    """Fails if a field without a limit is added."""
    for member in set(AnyFault.__args__) - {UserFault}:
        for field in msgspec.structs.fields(member):
            if field.name in {"uav", "motor", "start_s", "duration_s"}:
                continue
            assert field.name in LIMITS[member.__struct_config__.tag]


def test_a_duration_below_a_step_and_zero_noise_are_refused():
    with pytest.raises(msgspec.ValidationError, match="duration_s"):
        fault_of("gps_loss", duration_s=0.0039)
    with pytest.raises(msgspec.ValidationError, match="expected one of them above 0"):
        fault_of("gps_noise", position_std_m=0.0, velocity_std_m_s=0.0)
    fault_of("gps_noise", position_std_m=0.0)


def test_the_channel_is_attenuated_for_all_or_not_at_all():
    assert catalogue.RadioAttenuation(attenuation_db=20.0).uav == "all"
    with pytest.raises(msgspec.ValidationError, match='uav: expected "all"'):
        fault_of("radio_attenuation", uav=1)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_worst_of_all_faults_together_can_be_sent(sign):
    """300 of each: 3000 km and 17 km/s per axis, 1500 km of pressure altitude. Values saturate."""
    worst = [
        fault_of("gps_bias", uav="all", offset_ned_m=(sign * 1e4,) * 3, rate_m_s=100.0, duration_s=None),
        fault_of("gps_bias", uav="all", offset_ned_m=(sign * 1e4,) * 3, duration_s=None),
        fault_of("gps_noise", uav="all", position_std_m=1000.0, velocity_std_m_s=50.0, duration_s=None),
        fault_of("baro_bias", uav="all", offset_m=sign * 5000.0, duration_s=None),
        fault_of("accel_bias", uav="all", offset_frd_m_s2=(sign * 100.0,) * 3, duration_s=None),
        fault_of("gyro_bias", uav="all", offset_frd_rad_s=(sign * 35.0,) * 3, duration_s=None),
        fault_of("mag_bias", uav="all", offset_frd_gauss=(sign * 10.0,) * 3, duration_s=None),
    ]
    encoder, seen = SensorEncoder(), {}
    for frame in fly(*worst * 300, until_us=1_600_000):
        for data in encoder.encode(frame.time_us, frame):
            for message in Parser().push(data):
                seen.setdefault(message.get_type(), []).append(message)
    last = seen["HIL_GPS"][-1]
    assert (last.vn, last.ve, last.vd) == ((32_767,) * 3 if sign > 0.0 else (-32_768,) * 3)
    assert last.vel == 65_535
    # the barometer saturates at the limits of its range, up to its error
    pressures_hpa = [m.abs_pressure for m in seen["HIL_SENSOR"] if m.time_usec > BEGIN_US and m.abs_pressure]
    limit_hpa = 10.0 if sign > 0.0 else 1200.0
    assert len(pressures_hpa) > 20
    np.testing.assert_allclose(pressures_hpa, limit_hpa, atol=2.0)


def test_the_worst_of_all_radio_faults_together_can_be_sent():
    """2000 of each: 600 000 dB and 2000 km, which are limited to 1000 dB and 1000 km."""
    worst = [
        fault_of("radio_attenuation", attenuation_db=300.0),
        fault_of("ranging_bias", uav="all", offset_m=-1000.0),
    ]
    state = faults_of(*worst * 2000)
    state.advance(BEGIN_US)
    request = Advance(
        to_us=0, release_us=0, at_us=0, pos_ned_m=b"", vel_ned_m_s=b"", q_ned_frd=b"",
        extra_attenuation_db=state.extra_attenuation_db, range_offsets_m=tuple(state.range_offsets_m.items()),
    )  # fmt: skip
    assert msgspec.msgpack.decode(msgspec.msgpack.encode(request), type=Advance) == request
    assert request.extra_attenuation_db == 1000.0
    assert request.range_offsets_m == tuple((uav, -1e6) for uav in range(N))
