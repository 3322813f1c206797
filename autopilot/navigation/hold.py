"""Hold: a stop, or a flight to a position. Pure."""

from typing import NamedTuple

from autopilot.commander.mode_table import FLIES_TO_A_PLACE, ModeTraits
from autopilot.navigation.flight_mode import IDLE, ON_GROUND_M, ModeContext, ModeEntry, ModeInputs, StopMode
from autopilot.navigation.landing import LandMode
from foundation.types import Array, EstimatorState, TrajectorySetpoint


class HoldTarget(NamedTuple):
    """Target of a hold."""

    place_ned_m: Array
    """(3,) position."""
    yaw_rad: float | None
    """None: by MPC_YAW_MODE."""


class HoldMode(StopMode):
    """Stops, or flies to a target and lands there if it is on the ground."""

    traits = ModeTraits(needs=FLIES_TO_A_PLACE, arms=True)

    def __init__(self, context: ModeContext, landing: LandMode) -> None:
        super().__init__(context)
        self.target: HoldTarget | None = None
        """None: the stopping point."""
        self._landing = landing

    def enter(self, entry: ModeEntry) -> None:
        """Stop; if it has a target, fly there."""
        super().enter(entry)
        self._landing.start(entry.state)
        if self.target is not None:
            self.hold_at(self.target)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint of the stop or of the leg to the target."""
        if inputs.landed:
            return IDLE
        guide, ground_down_m = self._guide, self._context.ground_down_m
        if guide.target_ned_m[2] > ground_down_m - ON_GROUND_M:
            # the target is on the ground: a hover above it would never be detected as landed
            if guide.pos_ned_m[2] > ground_down_m - ON_GROUND_M:
                return self._landing.update(inputs)
            self._landing.start(inputs.state)
        elif self.target is None:
            return guide.update(inputs.dt_s)
        return self._fly_to_target(inputs)

    def change_speed(self, speed_m_s: float | None, /) -> None:
        """Change the ground speed of the leg to a target."""
        self._context.change_speed(speed_m_s)

    def hold_at(self, target: HoldTarget) -> None:
        """Fly to a target."""
        self.target = target
        self._guide.go_to(target.place_ned_m, yaw_rad=target.yaw_rad)

    def stop(self, state: EstimatorState) -> None:
        """Stop here."""
        self.target = None
        self._guide.restart(state)

    def _fly_to_target(self, inputs: ModeInputs) -> TrajectorySetpoint:
        """Return the setpoint on the way to the target; heading as on any leg unless one was given."""
        guide, target, context = self._guide, self.target, self._context
        if target is not None and target.yaw_rad is None and not guide.resting:
            near_m = context.params.acceptance_m
            context.turn_by_yaw_mode(target.place_ned_m, inputs.home_ned_m, near_m=near_m)
        return guide.update(inputs.dt_s, vehicle_pos_ned_m=inputs.state.pos_ned_m)
