"""The range finder measures heights, slopes and boxes, and its messages are those that PX4 takes. 2 s."""

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import common
from world_models import sensor_of, state_of

from autopilot.mavlink.codec import Parser
from foundation.extensions import ExtensionError
from foundation.geometry.rotations import quat_from_euler
from harness.world.interfaces import Reading
from harness.world.obstacles import Box

EXACT = {"noise_std_m": 0.0, "noise_fraction": 0.0}
WALL = Box(from_ned_m=(8.0, -50.0, -30.0), to_ned_m=(9.0, 50.0, 0.0))


def distance_m(settings, height_m=10.0, rpy_rad=(0.0, 0.0, 0.0), boxes=()):
    finder = sensor_of("range_finder", EXACT | settings, boxes=boxes)
    return finder.sample(state_of([(0.0, 0.0, -height_m)] * 3, q_ned_frd=quat_from_euler(*rpy_rad)))[0]


def message_of(values, settings=None, number=0):
    finder = sensor_of("range_finder", settings or {}, number=number)
    (message,) = Parser().push(finder.frame(Reading(1_234_567, values), common.MAVLink(None)))
    return message


def test_tilt_lengthens_the_distance_to_the_ground():
    assert distance_m({}) == pytest.approx(10.0)
    assert distance_m({}, rpy_rad=(0.3, 0.0, 1.0)) == pytest.approx(10.0 / math.cos(0.3))
    assert distance_m({}, rpy_rad=(0.3, -0.2, 2.0)) == pytest.approx(10.0 / (math.cos(0.3) * math.cos(0.2)))


def test_each_direction_is_that_of_the_body():
    """The wall is 8 m north; nose to the east it is on the left."""
    seen = {"forward": 0.0, "left": 0.5 * math.pi, "backward": math.pi, "right": -0.5 * math.pi}
    for direction, yaw_rad in seen.items():
        for other in seen:
            found = distance_m({"direction": other}, rpy_rad=(0.0, 0.0, yaw_rad), boxes=[WALL])
            assert found == pytest.approx(8.0) if other == direction else math.isnan(found)
    assert math.isnan(distance_m({"direction": "up"}))


def test_a_sensor_off_the_centre_measures_from_its_own_place():
    assert distance_m({"position_frd_m": (0.0, 0.0, 0.15)}) == pytest.approx(9.85)
    forward = {"direction": "forward", "position_frd_m": (0.5, 0.0, 0.0)}
    assert distance_m(forward, boxes=[WALL]) == pytest.approx(7.5)


def test_the_range_falls_with_the_root_of_the_incidence_and_the_quality_with_the_power():
    limit_m = 20.0 * math.sqrt(math.cos(0.6)) * math.cos(0.6)  # height at which the slant range is reached
    assert not math.isnan(distance_m({"max_m": 20.0}, height_m=0.999 * limit_m, rpy_rad=(0.6, 0.0, 0.0)))
    assert math.isnan(distance_m({"max_m": 20.0}, height_m=1.001 * limit_m, rpy_rad=(0.6, 0.0, 0.0)))
    finder = sensor_of("range_finder", EXACT | {"max_m": 20.0})
    # half the range: a fourth of the power that is not needed
    assert finder.sample(state_of([(0.0, 0.0, -10.0)] * 3)) == (pytest.approx(10.0), pytest.approx(0.75))
    assert finder.sample(state_of([(0.0, 0.0, -20.5)] * 3))[1] == 0.0


def test_the_noise_has_the_standard_deviation_of_its_settings():
    """2000 samples: 1.6 % of a standard deviation; four of those."""
    finder = sensor_of("range_finder", {"noise_std_m": 0.03, "noise_fraction": 0.004})
    state = state_of([(0.0, 0.0, -10.0)] * 3)
    readings_m = np.array([finder.sample(state)[0] for _ in range(2000)])
    assert readings_m.std() == pytest.approx(0.05, rel=0.064)  # 0.03 and 0.04
    assert readings_m.mean() == pytest.approx(10.0, abs=4 * 0.05 / math.sqrt(2000))


def test_the_message_has_the_units_and_the_orientation_that_px4_takes():
    message = message_of((3.456, 0.75), {"max_m": 40.0, "min_m": 0.2}, number=2)
    assert message.get_type() == "DISTANCE_SENSOR"
    assert (message.time_boot_ms, message.id) == (1234, 2)
    assert (message.min_distance, message.max_distance, message.current_distance) == (20, 4000, 346)
    assert message.orientation == common.MAV_SENSOR_ROTATION_PITCH_270
    assert message.covariance == math.ceil(2.0**2 + 0.6912**2)  # cm^2
    px4_percent = 100 * (message.signal_quality - 1) // 99
    assert px4_percent == 74
    assert message_of((1.0, 0.5), {"direction": "forward"}).orientation == common.MAV_SENSOR_ROTATION_NONE


def test_without_a_return_the_distance_is_out_of_the_limits_and_the_quality_invalid():
    message = message_of((math.nan, 0.0))
    assert message.current_distance == message.max_distance + 1
    assert message.signal_quality == 1  # 0 for PX4, which -1 would be unknown
    assert message.covariance == 255


@pytest.mark.parametrize("values", [(1e6, 7.0), (-3.0, -1.0), (math.nan, 1.0), (1.0, math.nan)])
def test_values_that_a_fault_has_changed_are_still_a_message(values):
    assert message_of(values).get_type() == "DISTANCE_SENSOR"


def test_limits_in_the_wrong_order_are_refused():
    with pytest.raises(ExtensionError, match=r"sensors\.extra\[0\]\.settings: min_m: expected"):
        sensor_of("range_finder", {"min_m": 5.0, "max_m": 4.0})
