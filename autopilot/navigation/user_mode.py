"""A flight mode of the user: the same interface, with a check of everything that the user's code returns."""

import numpy as np

from autopilot.commander.mode_table import ModeTraits
from autopilot.mavlink.modes import FlightMode
from autopilot.navigation.flight_mode import FlightModeBehaviour, ModeEntry, ModeInputs
from foundation.extension_call import ExtensionCall
from foundation.types import AttitudeSetpoint, Course, EstimatorState, TrajectorySetpoint, Triple

_VECTORS = ("pos_ned_m", "vel_ned_m_s", "acc_ned_m_s2")


class UserMode:
    """Calls a behaviour of the user; all methods raise ExtensionFailure if it fails."""

    def __init__(self, behaviour: FlightModeBehaviour, title: str) -> None:
        """``title`` begins the lines of its failures."""
        self._behaviour = behaviour
        self._call = ExtensionCall(title)
        self._checked: object = None
        """The last setpoint that was checked: most steps return another one, but some reuse it."""

    @property
    def traits(self) -> ModeTraits:
        """Those of the user's class."""
        return self._behaviour.traits

    def enter(self, entry: ModeEntry) -> None:
        """Enter the mode."""
        with self._call:
            self._behaviour.enter(entry)

    def update(self, inputs: ModeInputs) -> TrajectorySetpoint | AttitudeSetpoint:
        """Return the mode's setpoint if it is one, with finite numbers."""
        with self._call:
            setpoint = self._behaviour.update(inputs)
        if setpoint is not self._checked:
            self._check(setpoint)
            self._checked = setpoint
        return setpoint

    def next_mode(self, state: EstimatorState, /) -> FlightMode | None:
        """Return the mode that follows, if it is complete."""
        with self._call:
            mode = self._behaviour.next_mode(state)
        if mode is not None and not isinstance(mode, FlightMode):
            raise self._call.refused(f"next_mode returned {mode!r:.100}; expected a FlightMode or None")
        return mode

    @property
    def course(self) -> Course:
        """Whether the vehicle takes off or lands."""
        with self._call:
            course = self._behaviour.course
        if not isinstance(course, Course):
            raise self._call.refused(f"course is {course!r:.100}; expected a Course")
        return course

    def apply_limits(self) -> None:
        """Pass on that parameters have changed."""
        with self._call:
            self._behaviour.apply_limits()

    def change_speed(self, speed_m_s: float | None, /) -> None:
        """Pass on another ground speed."""
        with self._call:
            self._behaviour.change_speed(speed_m_s)

    def _check(self, setpoint: object) -> None:
        if isinstance(setpoint, TrajectorySetpoint):
            for name in _VECTORS:
                self._check_vector(name, getattr(setpoint, name), 3)
            numbers = (0.0 if setpoint.yaw_rad is None else setpoint.yaw_rad, setpoint.yaw_rate_rad_s)
            self._check_vector("yaw", numbers, 2)
        elif isinstance(setpoint, AttitudeSetpoint):
            self._check_vector("q_ned_frd", setpoint.q_ned_frd, 4)
            self._check_vector("yaw rate and thrust", (setpoint.yaw_rate_rad_s, setpoint.thrust), 2)
            if not 0.0 <= setpoint.thrust <= 1.0:
                raise self._call.refused(f"update returned a thrust of {setpoint.thrust:g}; expected 0 to 1")
            if abs(float(np.linalg.norm(setpoint.q_ned_frd)) - 1.0) > 1e-3:
                raise self._call.refused("update returned a q_ned_frd that is no unit quaternion")
        else:
            raise self._call.refused(
                f"update returned a {type(setpoint).__name__}; expected a TrajectorySetpoint or an "
                "AttitudeSetpoint"
            )

    def _check_vector(self, name: str, vector: Triple | None, size: int) -> None:
        if vector is None:
            return
        try:
            values = np.asarray(vector, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise self._call.refused(f"update returned a {name} of {vector!r:.100}: {error}") from error
        if values.shape != (size,) or not np.isfinite(values).all():
            raise self._call.refused(
                f"update returned a {name} of {vector!r:.100}; expected {size} finite numbers"
            )
