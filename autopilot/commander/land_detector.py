"""Land detector: decides from motion and demands whether the vehicle is on the ground.

After PX4's MulticopterLandDetector: on the ground the vehicle does not move vertically although the
controller demands descent, and thrust is low. Three consecutive stages prevent a gust or a stalled descent
from being detected as a landing.
"""

from enum import IntEnum
from math import radians
from typing import Annotated

from msgspec import Meta, Struct

from foundation.types import EstimatorState

GROUND_CONTACT_US = 350_000
MAYBE_LANDED_US = 250_000
LANDED_US = 300_000
"""How long the conditions of each stage must hold, one stage after the other."""
LOW_THRUST_OF_HOVER = 0.3
"""Share of the hover thrust below which the vehicle cannot be flying."""
DESCENT_DEMAND_M_S = 0.27
"""0.9 MPC_LAND_CRWL, PX4's slowest landing speed: at a greater demand no motion means ground contact."""
LEFT_GROUND_HEIGHT_M = 0.15
LEFT_GROUND_CLIMB_M_S = 0.5


class LandStage(IntEnum):
    """Stages of landing, in increasing order of certainty."""

    AIRBORNE = 0
    GROUND_CONTACT = 1
    MAYBE_LANDED = 2
    LANDED = 3


_STAGE_US = {
    LandStage.AIRBORNE: GROUND_CONTACT_US,
    LandStage.GROUND_CONTACT: MAYBE_LANDED_US,
    LandStage.MAYBE_LANDED: LANDED_US,
}


class LandDetectorParams(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Motion thresholds."""

    vertical_speed_max_m_s: Annotated[float, Meta(gt=0.0)] = 0.25
    """LNDMC_Z_VEL_MAX: greatest vertical speed on the ground"""
    horizontal_speed_max_m_s: Annotated[float, Meta(gt=0.0)] = 1.5
    """LNDMC_XY_VEL_MAX: greatest horizontal speed on the ground"""
    rotation_max_rad_s: Annotated[float, Meta(gt=0.0)] = radians(20.0)
    """LNDMC_ROT_MAX: greatest body rate on the ground"""


class LandDetector:
    """Landing stage of one vehicle; call `update` at every check of the flight."""

    def __init__(self, params: LandDetectorParams) -> None:
        self.params = params
        self.stage = LandStage.LANDED
        self._since_us = 0
        """Since when the conditions of the next stage have held."""
        self._climb_from_down_m: float | None = None
        """Down position at which a climb was first demanded on the ground."""

    def set_params(self, params: LandDetectorParams) -> None:
        """Change the settings, in effect from the next update."""
        self.params = params

    @property
    def landed(self) -> bool:
        """Whether the vehicle is on the ground, the last of the stages."""
        return self.stage is LandStage.LANDED

    def update(
        self,
        now_us: int,
        state: EstimatorState,
        *,
        armed: bool,
        down_demand_m_s: float,
        thrust_of_hover: float,
    ) -> None:
        """Update the stage.

        ``down_demand_m_s`` is the demanded vertical speed, positive down; ``thrust_of_hover`` is thrust
        divided by the hover thrust.
        """
        if not armed:
            self.stage = LandStage.LANDED
            self._climb_from_down_m = None
        elif self.stage is LandStage.LANDED:
            self._watch_for_take_off(now_us, state, down_demand_m_s)
        else:
            # in flight neither holds, so the motion is not evaluated
            low_thrust = thrust_of_hover < LOW_THRUST_OF_HOVER
            contact = (low_thrust or down_demand_m_s > DESCENT_DEMAND_M_S) and self._is_still(state)
            resting = contact and low_thrust and not self._rotates(state)
            self._advance(now_us, contact=contact, resting=resting)

    def _is_still(self, state: EstimatorState) -> bool:
        north_m_s, east_m_s, down_m_s = state.vel_ned_m_s.tolist()
        speed_m_s: float = (north_m_s * north_m_s + east_m_s * east_m_s) ** 0.5
        return (
            abs(down_m_s) < self.params.vertical_speed_max_m_s
            and speed_m_s < self.params.horizontal_speed_max_m_s
        )

    def _rotates(self, state: EstimatorState) -> bool:
        p, q, r = state.omega_frd_rad_s.tolist()
        rotation_rad_s: float = (p * p + q * q + r * r) ** 0.5
        return not rotation_rad_s < self.params.rotation_max_rad_s

    def _watch_for_take_off(self, now_us: int, state: EstimatorState, down_demand_m_s: float) -> None:
        down_m, vel_down_m_s = state.pos_ned_m.item(2), state.vel_ned_m_s.item(2)
        if down_demand_m_s >= 0.0:
            self._climb_from_down_m = None
        elif self._climb_from_down_m is None:
            self._climb_from_down_m = down_m
        elif self._climb_from_down_m - down_m > LEFT_GROUND_HEIGHT_M or -vel_down_m_s > LEFT_GROUND_CLIMB_M_S:
            self.stage = LandStage.AIRBORNE
            self._since_us = now_us
            self._climb_from_down_m = None

    def _advance(self, now_us: int, *, contact: bool, resting: bool) -> None:
        if not contact:
            self.stage = LandStage.AIRBORNE
            self._since_us = now_us
        elif not resting and self.stage is not LandStage.AIRBORNE:
            self.stage = LandStage.GROUND_CONTACT
            self._since_us = now_us
        elif now_us - self._since_us >= _STAGE_US[self.stage]:
            self.stage = LandStage(self.stage + 1)
            self._since_us = now_us
