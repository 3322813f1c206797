"""Timelines of the land detector, at 4 ms steps."""

import numpy as np
from control_fixtures import estimate

from autopilot.commander.land_detector import (
    GROUND_CONTACT_US,
    LANDED_US,
    LEFT_GROUND_HEIGHT_M,
    MAYBE_LANDED_US,
    LandDetector,
    LandDetectorParams,
    LandStage,
)

STEP = 4_000
HOVER = {"vel_down_m_s": 0.0, "down_demand_m_s": 0.0, "thrust_of_hover": 1.0}
DESCENT = {"vel_down_m_s": 0.7, "down_demand_m_s": 0.7, "thrust_of_hover": 0.95}
ON_GROUND = {"vel_down_m_s": 0.0, "down_demand_m_s": 0.7, "thrust_of_hover": 0.2}


class Timeline:
    def __init__(self):
        self.detector = LandDetector(LandDetectorParams())
        self.now_us = 0

    def run(self, duration_us, *, vel_down_m_s, armed=True, down_m=-2.0, rotation_rad_s=0.0, **demand):
        """Return when each new stage was reached, relative to the start of this run."""
        begin_us, reached = self.now_us, {}
        for _ in range(duration_us // STEP):
            self.now_us += STEP
            before = self.detector.stage
            self.detector.update(
                self.now_us,
                estimate(
                    pos_ned_m=np.array((0.0, 0.0, down_m)),
                    vel_ned_m_s=np.array((0.0, 0.1, vel_down_m_s)),
                    omega_frd_rad_s=np.array((0.0, rotation_rad_s, 0.0)),
                ),
                armed=armed,
                **demand,
            )
            if self.detector.stage is not before:
                reached[self.detector.stage] = self.now_us - begin_us
        return reached

    def take_off(self):
        self.run(STEP, down_m=0.0, vel_down_m_s=0.0, down_demand_m_s=-1.5, thrust_of_hover=0.5)
        self.run(STEP, down_m=-1.0, vel_down_m_s=-1.0, down_demand_m_s=-1.5, thrust_of_hover=1.1)
        assert self.detector.stage is LandStage.AIRBORNE


def test_an_armed_vehicle_on_the_ground_stays_landed():
    line = Timeline()
    assert line.run(10_000_000, down_m=0.0, **ON_GROUND) == {}
    assert line.detector.landed


def test_take_off_is_detected_at_a_height_above_the_start_of_the_climb_demand():
    line = Timeline()
    climb = {"vel_down_m_s": -0.2, "down_demand_m_s": -1.5, "thrust_of_hover": 1.0}
    line.run(1_000_000, down_m=0.4, **climb)  # on the ground the estimate may be at any height
    assert line.detector.landed
    line.run(STEP, down_m=0.4 - LEFT_GROUND_HEIGHT_M + 0.01, **climb)
    assert line.detector.landed
    line.run(STEP, down_m=0.4 - LEFT_GROUND_HEIGHT_M - 0.01, **climb)
    assert not line.detector.landed


def test_a_drifting_height_without_a_climb_demand_is_no_take_off():
    line = Timeline()
    line.run(STEP, down_m=-1.0, **HOVER)
    line.run(STEP, down_m=-3.0, **HOVER)
    assert line.detector.landed


def test_landing_has_three_successive_stages():
    #  | contact 0.35 s | maybe landed 0.25 s | landed 0.3 s |
    line = Timeline()
    line.take_off()
    assert line.run(2_000_000, **DESCENT) == {}
    contact = GROUND_CONTACT_US + (-GROUND_CONTACT_US) % STEP
    maybe = contact + MAYBE_LANDED_US + (-MAYBE_LANDED_US) % STEP
    landed = maybe + LANDED_US + (-LANDED_US) % STEP
    reached = line.run(2_000_000, **ON_GROUND)
    assert list(reached) == [LandStage.GROUND_CONTACT, LandStage.MAYBE_LANDED, LandStage.LANDED]
    for stage, expected in zip(reached, (contact, maybe, landed), strict=True):
        assert abs(reached[stage] - expected) <= STEP


def test_hovering_and_a_bounce_are_not_landing():
    line = Timeline()
    line.take_off()
    assert line.run(20_000_000, **HOVER) == {}
    line.run(600_000, **ON_GROUND)
    line.run(STEP, vel_down_m_s=-0.6, down_demand_m_s=0.7, thrust_of_hover=0.2)
    assert line.detector.stage is LandStage.AIRBORNE


def test_standing_with_thrust_is_only_ground_contact():
    line = Timeline()
    line.take_off()
    line.run(5_000_000, vel_down_m_s=0.0, down_demand_m_s=0.7, thrust_of_hover=0.6)
    assert line.detector.stage is LandStage.GROUND_CONTACT


def test_tumbling_is_not_resting():
    line = Timeline()
    line.take_off()
    line.run(5_000_000, rotation_rad_s=1.0, **ON_GROUND)
    assert line.detector.stage is LandStage.GROUND_CONTACT


def test_disarmed_counts_as_landed():
    line = Timeline()
    line.take_off()
    line.run(STEP, armed=False, **DESCENT)
    assert line.detector.landed
