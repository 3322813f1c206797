"""Setpoints of the present flight mode for the flight controller. Pure.

Offboard mode is not part of this: its setpoints are external and go to the controller unchanged.
"""

from collections.abc import Sequence
from typing import TypeVar

from autopilot.control.hover_thrust import GRAVITY_M_S2
from autopilot.control.params import PositionParams, TrajectoryParams
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.flight_mode import (
    FlightModeBehaviour,
    HomePosition,
    ModeContext,
    ModeEntry,
    ModeInputs,
)
from autopilot.navigation.hold import HoldMode, HoldTarget
from autopilot.navigation.mission_flight import MissionMode
from autopilot.navigation.mode_registry import MODES, ModeRow
from autopilot.navigation.orbit import OrbitMode
from autopilot.navigation.params import NavigationParams
from autopilot.navigation.plan_store import RallyPoint
from autopilot.navigation.return_home import ReturnMode
from foundation.types import Array, AttitudeSetpoint, Course, EstimatorState, Setpoint, TrajectorySetpoint

_Kind = TypeVar("_Kind")


class Navigator:
    """Computes the setpoints of one vehicle's mode: call `enter`, then `update` at every step."""

    def __init__(
        self,
        params: NavigationParams,
        trajectory: TrajectoryParams,
        position: PositionParams,
        rows: Sequence[ModeRow] = MODES,
    ) -> None:
        """``rows`` are the modes, which include all of `MODES`."""
        self._context = context = ModeContext(params, trajectory, position)
        self.behaviours: dict[FlightMode, FlightModeBehaviour] = {}
        """By mode."""
        for row in rows:
            self.behaviours[row.mode] = row.make(context, *(self.behaviours[part] for part in row.parts))
        self._hold = self._of_kind(FlightMode.HOLD, HoldMode)
        self._return = self._of_kind(FlightMode.RETURN, ReturnMode)
        self.mission = self._of_kind(FlightMode.MISSION, MissionMode)
        """The mission and its progress; kept while other modes are active."""
        self.orbit = self._of_kind(FlightMode.ORBIT, OrbitMode)
        self._mode = FlightMode.HOLD

    def _of_kind(self, mode: FlightMode, kind: type[_Kind]) -> _Kind:
        behaviour = self.behaviours[mode]
        assert isinstance(behaviour, kind)  # noqa: S101  by the registry
        return behaviour

    # ---- status

    @property
    def course(self) -> Course:
        """Whether the vehicle takes off or lands, by a mode, a mission item or a return."""
        return self.behaviours[self._mode].course

    @property
    def place_ned_m(self) -> Array:
        """Position (3,) at which the present leg comes to rest, in modes that fly a path."""
        return self._context.guide.target_ned_m

    def next_mode(self, state: EstimatorState) -> FlightMode | None:
        """Return the next mode: hold after a take-off or a mission, return by a mission item; or None."""
        return self.behaviours[self._mode].next_mode(state)

    # ---- requests

    def set_rally_points(self, points: Sequence[RallyPoint]) -> None:
        """Change the rally points; a return in progress keeps its destination."""
        self._return.rally_points = tuple(points)

    def set_params(
        self, params: NavigationParams, trajectory: TrajectoryParams, position: PositionParams
    ) -> None:
        """Change the settings; a take-off or a leg in progress keeps its target."""
        self._context.set_params(params, trajectory, position)
        self.behaviours[self._mode].apply_limits()

    def change_speed(self, speed_m_s: float | None) -> None:
        """Change the ground speed of legs until the mode ends; None: as by the parameters.

        In a mission it applies until an item changes the speed.
        """
        self.behaviours[self._mode].change_speed(speed_m_s)

    def hold_at(self, place_ned_m: Array, *, yaw_rad: float | None = None) -> None:
        """Fly to a position (3,) in the hold mode that was entered; yaw None: by MPC_YAW_MODE."""
        self._hold.hold_at(HoldTarget(place_ned_m, yaw_rad))

    def stop(self, state: EstimatorState) -> None:
        """Stop in the hold mode that was entered."""
        self._hold.stop(state)

    def enter(
        self,
        mode: FlightMode,
        state: EstimatorState,
        *,
        landed: bool,
        takeoff_down_m: float,
        home_ned_m: HomePosition | None = None,
    ) -> None:
        """Start a mode from the present motion, or restart it after a reset of the estimate.

        A mission, a return, an orbit and the flight to a hold target continue; a finished mission that is
        entered again starts with its first item. ``takeoff_down_m`` is the final height of a take-off, which
        never descends. Hold after a mode that ends in hold keeps the path of that mode.
        """
        again = mode is self._mode
        if landed:
            self._context.ground_down_m = float(state.pos_ned_m[2])
        if landed or not again:
            self._hold.target = self._context.speed_m_s = None
        goes_on = mode is FlightMode.HOLD and not landed and self.next_mode(state) is FlightMode.HOLD
        self._mode = mode
        if goes_on:
            return
        entry = ModeEntry(
            state=state, dt_s=0.0, landed=landed, touching=False, home_ned_m=home_ned_m,
            again=again, takeoff_down_m=takeoff_down_m,
        )  # fmt: skip
        self.behaviours[mode].enter(entry)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint | AttitudeSetpoint:
        """Return the setpoint of the present mode."""
        return self.behaviours[self._mode].update(inputs)


def down_demand_m_s(
    state: EstimatorState, setpoint: Setpoint, *, z_p_1_s: float, hover_thrust: float = 0.5
) -> float:
    """Return the vertical speed that a setpoint demands, positive down; accelerations count for one second.

    For attitudes and rates the acceleration is that of the thrust in excess of ``hover_thrust``.
    """
    if not isinstance(setpoint, TrajectorySetpoint):
        return GRAVITY_M_S2 * (1.0 - setpoint.thrust / hover_thrust)
    vel, acc = setpoint.vel_ned_m_s, setpoint.acc_ned_m_s2
    vel_down_m_s = float(vel[2]) if vel is not None and setpoint.vel_axes[2] else None
    if setpoint.pos_ned_m is not None and setpoint.pos_axes[2]:
        demand_m_s = z_p_1_s * (float(setpoint.pos_ned_m[2]) - state.pos_ned_m.item(2))
        return demand_m_s if vel_down_m_s is None else demand_m_s + vel_down_m_s
    if vel_down_m_s is not None:
        return vel_down_m_s
    return float(acc[2]) if acc is not None and setpoint.acc_axes[2] else 0.0
