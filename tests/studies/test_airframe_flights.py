"""Each packaged airframe flies with the gains of its file; multirotors lose a motor (30 s)."""

import numpy as np
import pytest

from foundation.airframe.files import load, names
from studies.vehicle.airframe_section import _redundant
from studies.vehicle.hover import SENSORS, Hover, fly_hover
from studies.vehicle.moves import fly_move
from studies.vehicle.solo import Solo, solo_config

HOVER = {"seed": 1, "mean_n": 0.0, "gust_rms_n": 0.0, "sensors": "gazebo", "measure_s": 10.0}


@pytest.mark.parametrize("name", names())
def test_it_hovers_and_moves(name):
    assert fly_hover(Hover(**HOVER, airframe=name)).total_m < 0.15
    track = fly_move(1, 5.0, name)
    assert track.max() < 1.1
    assert abs(track[-1] - 1.0) < 0.05


@pytest.mark.parametrize("motor", range(6))
def test_a_hexacopter_holds_its_place_without_a_motor(motor):
    """At most 0.5 m rms from the instant of the failure on, with ESC telemetry as the only notice."""
    assert _redundant() == ("hexacopter", "octocopter")
    assert fly_hover(Hover(**HOVER, airframe="hexacopter", stopped_motor=motor)).total_m < 0.5


def flown_after_failure(name, *, motor, seconds, params=None):
    """Return a vehicle after the failure of a motor in offboard hover at 10 m."""
    sensors = SENSORS["gazebo"]
    config = solo_config(airframe=load(name), params=params, gps_delay_s=sensors.gps_model().delay_s)
    solo = Solo(config, sensors=sensors, seed=np.random.SeedSequence(3))
    solo.take_off(10.0)
    solo.set_position(0.0, 0.0, -10.0)
    solo.offboard()
    solo.run(2.0)
    solo.rotors_stopped[0, motor] = True
    solo.run(seconds)
    return solo


def test_the_failure_is_found_by_telemetry_within_a_quarter_of_a_second_and_reported():
    """Both ESC_STATUS messages are needed: motor 5 is in the second one. 0.1 s of time-out, two of 40 ms."""
    solo = flown_after_failure("hexacopter", motor=5, seconds=0.25)
    assert solo.vehicle.monitor.failures.failed_motors == {5}
    controls = solo.vehicle.pilot.controls
    assert len(controls) == 16
    assert [k for k, control in enumerate(controls) if control] == [0, 1, 3, 4]
    solo.run(1.0)
    assert any("motor failure" in text for text in solo.texts())


def test_without_the_failure_mode_the_hexacopter_falls():
    solo = flown_after_failure("hexacopter", motor=0, seconds=6.0, params={"CA_FAILURE_MODE": 0})
    track = solo.track
    assert np.linalg.norm(track.pos_ned_m[-1] - (0.0, 0.0, -10.0)) > 1.0


def test_an_octocopter_keeps_its_heading_without_a_motor():
    solo = flown_after_failure("octocopter", motor=3, seconds=8.0)
    assert abs(solo.height_m - 10.0) < 0.3
    w, _, _, z = solo.world.truth.q_ned_frd[0]
    assert abs(2.0 * np.arctan2(z, w)) < np.radians(5.0)
