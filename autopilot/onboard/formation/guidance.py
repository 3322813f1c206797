"""Guidance of one UAV: its setpoint from the plan and the state of the formation. No I/O, no MAVLink.

The reference joins the own place of the plan at bounded speed. Without support by distances it moves to a
height layer of its own. Avoidance adds a velocity, and the result is converted to the autopilot's frame, in
which the position estimate contains the GPS error.
"""

from autopilot.onboard.client.own_state import OwnState
from autopilot.onboard.formation.avoidance import Avoidance
from autopilot.onboard.formation.formation_control import Correction, FormationReference
from autopilot.onboard.formation.height_layers import HeightLayers
from autopilot.onboard.formation.motion import MotionStart
from autopilot.onboard.formation.wind_observer import WindObserver
from autopilot.onboard.formation_plan import FormationPlan
from autopilot.onboard.localisation.uncertainty import Others
from autopilot.onboard.radio.neighbour_table import NeighbourTable
from autopilot.onboard.radio.neighbourhood import Neighbourhood
from autopilot.parameters.onboard_config import OnboardConfig
from foundation.types import Vector

SETPOINT_PERIOD_US = 40_000
"""Period of setpoints, if the application's loop runs at its multiples."""
POSITION_GAIN_1_S = 0.95
"""MPC_XY_P assumed until the autopilot has reported it."""
EXTRAPOLATED_US = 50_000
"""Longest extrapolation of the autopilot's position by its velocity; the telemetry period is shorter."""
Setpoint = tuple[Vector, Vector, Vector | None]
"""Setpoint for the autopilot, NED: position from its own origin (m), velocity (m/s) and, if given,
acceleration (m/s^2)."""


class Guidance:
    """One UAV's part of the formation control; ``near`` are the UAVs to avoid."""

    def __init__(
        self, *, station: int, plan: FormationPlan, config: OnboardConfig, near: Neighbourhood
    ) -> None:
        places_ned_m = plan.at(0.0).pos_ned_m
        self.start = MotionStart(station, len(places_ned_m))
        self.correction = Correction()
        self.layers = HeightLayers(
            own=station, places_ned_m=places_ned_m, gps_std_m=config.gps_bias_std_m,
            climb_speed_m_s=config.climb_speed_m_s, drift_m_sqrt_s=config.odometry_drift_m_sqrt_s,
        )  # fmt: skip
        self.wind = WindObserver() if config.wind_feed_forward else None
        self.position_gain_1_s = POSITION_GAIN_1_S
        """MPC_XY_P of the autopilot that follows the setpoints."""
        self.down_error_m = 0.0
        """Vertical odometry minus the true height, down; 0 unless the simulator sends the truth."""
        self._station = station
        self._plan = plan
        self._reference = FormationReference(climb_speed_m_s=config.climb_speed_m_s)
        self._avoidance = Avoidance(
            own=near.own, places_ned_m=places_ned_m, radius_m=config.safety_radius_m, members=near.members
        )

    def place_ned_m(self, now_us: int) -> Vector:
        """Return the own place of the plan, at the height of the own layer, site NED."""
        north_m, east_m, down_m = self._plan.own(self._station, self._since_start_s(now_us)).pos_ned_m
        return north_m, east_m, down_m - self.layers.height_m

    def believed_ned_m(self, own: OwnState, now_us: int) -> Vector:
        """Return the estimated position of the UAV at ``now_us``, site NED."""
        age_us = now_us - own.time_us
        if not 0 <= age_us <= EXTRAPOLATED_US:
            age_us = 0 if age_us < 0 else EXTRAPOLATED_US
        age_s = 1e-6 * age_us
        (north_m, east_m, down_m), (vel_n, vel_e, vel_d) = own.autopilot_ned_m, own.vel_ned_m_s
        error_n_m, error_e_m = self.correction.ne_m
        return (
            north_m + vel_n * age_s - error_n_m,
            east_m + vel_e * age_s - error_e_m,
            down_m + vel_d * age_s - self.down_error_m,
        )

    def agree(self, now_us: int, *, on_station: bool, table: NeighbourTable) -> None:
        """Update the agreement on the start of the motion by the neighbours' reports."""
        if self._plan.moves:
            self.start.update(now_us, on_station=on_station, neighbours=table.neighbours())

    def wait(self, own: OwnState, now_us: int) -> Setpoint:
        """Return a setpoint at the present position and vertical speed, for a smooth start of offboard."""
        believed_ned_m = self.believed_ned_m(own, now_us)
        vel_ned_m_s = (0.0, 0.0, own.vel_ned_m_s[2])
        self._reference.reset(believed_ned_m, vel_ned_m_s)
        return self._in_autopilots_frame(believed_ned_m, vel_ned_m_s, own, accelerates=False)

    def follow(
        self, own: OwnState, believed_ned_m: Vector, others: Others | None, now_us: int, dt_s: float
    ) -> Setpoint:
        """Return the setpoint on the way to the own place and at it, ``dt_s`` after the last one.

        ``others`` is the neighbourhood to avoid; None if the own position in it is unknown.
        """
        # The middle of the period for which a setpoint is valid.
        since_s = self._since_start_s(now_us) + 0.5 * SETPOINT_PERIOD_US * 1e-6
        target = self._plan.own(self._station, since_s)
        place_n_m, place_e_m, place_d_m = target.pos_ned_m
        reference = self._reference
        reference.advance(
            (place_n_m, place_e_m, place_d_m - self.layers.height_m), dt_s,
            target_vel_ned_m_s=target.vel_ned_m_s, target_acc_ned_m_s2=target.acc_ned_m_s2,
            vehicle_ned_m=believed_ned_m,
        )  # fmt: skip
        north_m, east_m, down_m = reference.pos_ned_m.tolist()
        vel_n, vel_e, vel_d = reference.vel_ned_m_s.tolist()
        if others is not None:
            gain_1_s = self.position_gain_1_s
            plan = self._plan.at(since_s)
            change_n, change_e = self._avoidance.velocity_change_ne_m_s(
                now_us,
                others=others,
                plan_pos_ned_m=plan.pos_ned_m, plan_vel_ned_m_s=plan.vel_ned_m_s,
                goal_ned_m=target.pos_ned_m,
                desired_ne_m_s=(
                    gain_1_s * (north_m - believed_ned_m[0]) + vel_n,
                    gain_1_s * (east_m - believed_ned_m[1]) + vel_e,
                ),
            )  # fmt: skip
            vel_n, vel_e = vel_n + change_n, vel_e + change_e
        return self._in_autopilots_frame(
            (north_m, east_m, down_m), (vel_n, vel_e, vel_d), own, accelerates=True
        )

    def _in_autopilots_frame(
        self, pos_ned_m: Vector, vel_ned_m_s: Vector, own: OwnState, *, accelerates: bool
    ) -> Setpoint:
        north_m, east_m, down_m = pos_ned_m
        error_n_m, error_e_m = self.correction.ne_m
        origin_n_m, origin_e_m, _ = own.origin_ned_m or (0.0, 0.0, 0.0)
        vel_n, vel_e, vel_d = vel_ned_m_s
        target_ned_m = (
            north_m + error_n_m - origin_n_m, east_m + error_e_m - origin_e_m,
            down_m + self.down_error_m + own.height.autopilot_down_m,
        )  # fmt: skip
        acc_ned_m_s2 = None
        if accelerates and (self._plan.moves or self.wind is not None):
            acc_n, acc_e, acc_d = self._reference.acc_ned_m_s2.tolist()
            if self.wind is not None:
                feed_n, feed_e = self.wind.feed_forward_ne_m_s2
                acc_n, acc_e = acc_n + feed_n, acc_e + feed_e
            acc_ned_m_s2 = (acc_n, acc_e, acc_d)
        return target_ned_m, (vel_n, vel_e, vel_d + own.height.vel_error_m_s), acc_ned_m_s2

    def _since_start_s(self, now_us: int) -> float:
        start_us = self.start.start_us
        return -1.0 if start_us is None else (now_us - start_us) * 1e-6
