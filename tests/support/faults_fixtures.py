"""Examples of all faults, and frames of simulated sensors with and without faults."""

import msgspec
import numpy as np
from world_truth import truth_with

from autopilot.parameters.config import Site
from foundation.geometry.geodesy import geodetic_to_ned
from foundation.geometry.rotations import quat_from_rotation_vector
from harness.world.active_faults import Faults
from harness.world.faults import AnyFault
from harness.world.sensors.config import SensorsConfig
from harness.world.sensors.suite import SensorSuite

STEP_US = 4_000
SITE = Site()
N = 3
ROTORS = (4,) * N
HIT = 1
"""The vehicle with the faults."""
BEGIN_US, END_US = 1_000_000, 2_000_000
EXAMPLES = {
    "gps_loss": {},
    "gps_bias": {"offset_ned_m": (30.0, -40.0, 5.0)},
    "gps_noise": {"position_std_m": 4.0, "velocity_std_m_s": 0.5},
    "accel_bias": {"offset_frd_m_s2": (1.0, -2.0, 0.5)},
    "gyro_bias": {"offset_frd_rad_s": (0.1, 0.0, -0.2)},
    "mag_bias": {"offset_frd_gauss": (0.05, 0.1, -0.02)},
    "mag_yaw": {"heading_error_deg": 40.0},
    "baro_freeze": {},
    "baro_bias": {"offset_m": 8.0},
    "motor": {"motor": 2, "effectiveness": 0.25},
    "motor_stop": {"motor": 3},
    "radio_attenuation": {"uav": "all", "attenuation_db": 60.0},
    "ranging_bias": {"offset_m": 5.0},
}
SENSOR_FAULTS = [name for name in EXAMPLES if not name.startswith(("motor", "radio", "ranging"))]


def fault_of(name, **fields):
    """Return a fault of a kind, decoded as from a scenario; ``fields`` override its example."""
    table = {"kind": name, "uav": HIT, "start_s": 1.0, "duration_s": 1.0, **EXAMPLES[name], **fields}
    return msgspec.convert(table, AnyFault)


def faults_of(*faults, seed=5):
    return Faults(faults, ROTORS, np.random.default_rng(seed))


def fly(*faults, until_us=3_000_000, profile="consumer", seed=5):
    """Return sensor frames of vehicles that climb, tilted and turning, with active faults."""
    suite = SensorSuite(
        config=SensorsConfig(profile=profile),
        site=SITE,
        vehicles=N,
        step_us=STEP_US,
        seed=np.random.SeedSequence(1),
    )
    state = faults_of(*faults, seed=seed)
    frames = []
    for time_us in range(STEP_US, until_us, STEP_US):
        state.advance(time_us)
        frames.append(suite.sample(time_us, truth_at(time_us), state))
    return frames


def truth_at(time_us):
    t = time_us * 1e-6
    q = [quat_from_rotation_vector(np.array((0.1, 0.2, 0.5 * vehicle + 0.3 * t))) for vehicle in range(N)]
    return truth_with(
        pos_ned_m=np.array([(5.0 * vehicle, 1.0 * t, -10.0 - 2.0 * t) for vehicle in range(N)]),
        vel_ned_m_s=np.tile((0.0, 1.0, -2.0), (N, 1)),
        q_ned_frd=np.array(q),
        omega_frd_rad_s=np.zeros((N, 3)),
        rotor_speed_rad_s=np.zeros((N, 4)),
        acc_ned_m_s2=np.zeros((N, 3)),
        specific_force_frd_m_s2=np.tile((0.0, 0.0, -9.8066), (N, 1)),
        mean_omega_frd_rad_s=np.zeros((N, 3)),
    )


def columns(frame):
    """Return the values of a frame by name: arrays whose first axis is the vehicle."""
    values = {"accel": frame.accel_frd_m_s2, "gyro": frame.gyro_frd_rad_s}
    if frame.mag_frd_gauss is not None:
        values["mag"] = frame.mag_frd_gauss
    if frame.baro is not None:
        values |= {"pressure": frame.baro.pressure_hpa, "temperature": frame.baro.temperature_degc}
    if frame.gps is not None:
        pos = geodetic_to_ned(
            frame.gps.lat_deg, frame.gps.lon_deg, frame.gps.alt_m, origin_lat_deg=SITE.latitude_deg,
            origin_lon_deg=SITE.longitude_deg, origin_alt_m=SITE.altitude_m,
        )  # fmt: skip
        lost = np.zeros(N, bool) if frame.gps.lost is None else frame.gps.lost
        values |= {"gps_pos": pos, "gps_vel": frame.gps.vel_ned_m_s, "gps_lost": lost}
    return values


def differences(healthy, faulty):
    """Return (time_us, name, vehicle, faulty - healthy) of all values with different bits."""
    found = []
    for before, after in zip(healthy, faulty, strict=True):
        here, there = columns(before), columns(after)
        assert here.keys() == there.keys()
        for name, healthy_values in here.items():
            for vehicle in range(N):
                if not np.array_equal(healthy_values[vehicle], there[name][vehicle]):
                    change = there[name][vehicle].astype(float) - healthy_values[vehicle].astype(float)
                    found.append((after.time_us, name, vehicle, change))
    return found
