"""Flight control by a controller of the user in place of the cascade.

It has the interface of `autopilot.control.flight.FlightController`, its take-off phases and its observers.
There are no fast steps in flight, because each sample is processed in Python.
"""

from collections.abc import Callable

import numpy as np

from autopilot.control.cascade import airmode_above, observe
from autopilot.control.controller import (
    TORQUE_MAX,
    Controller,
    ControllerContext,
    ControllerInputs,
    ThrustTorque,
)
from autopilot.control.flight import INPUTS, FlightController
from autopilot.control.inner_loop import follow_demand
from autopilot.control.mixing import effectiveness, mixer
from autopilot.control.params import ControlParams
from autopilot.control.takeoff import TakeoffPhase
from foundation.airframe.description import Airframe
from foundation.airframe.files import IRIS
from foundation.extension_call import ExtensionCall
from foundation.types import Array, AttitudeSetpoint, EstimatorState, Setpoint, TrajectorySetpoint


class UserFlightController(FlightController):
    """Computes motor controls from the demand of a `Controller`."""

    def __init__(
        self,
        params: ControlParams,
        *,
        make: Callable[[ControllerContext], Controller],
        title: str,
        instance: int,
        airframe: Airframe = IRIS,
    ) -> None:
        """``make`` creates the controller; ``title`` begins the lines of its failures."""
        super().__init__(params)
        self._call = ExtensionCall(title)
        context = ControllerContext(
            instance=instance,
            airframe=airframe,
            unit_torque_m=unit_torque_m(params),
            params=params,
        )
        self._controller = make(context)
        self._runs = False
        """Whether the controller has been reset since arming and since the last landing."""
        self._was_landed = True
        self._followed: Setpoint | None = None

    @property
    def flies_on(self) -> bool:
        """False: fast steps only follow the cascade."""
        return False

    @property
    def attitude_setpoint(self) -> AttitudeSetpoint | None:
        """The attitude that the controller follows; None if it has a setpoint of another kind."""
        followed = self._followed
        return followed if isinstance(followed, AttitudeSetpoint) else None

    def idle(self) -> None:
        """Stop the motors of a disarmed vehicle; the controller is reset before the next flight."""
        super().idle()
        self._runs, self._was_landed, self._followed = False, True, None

    def update(self, state: EstimatorState, setpoint: Setpoint, *, dt_s: float, landed: bool) -> list[float]:
        """Return the motor controls for the next ``dt_s``; see `FlightController.update`.

        Raises ExtensionFailure if the controller raises an exception or returns an invalid demand.
        """
        self._prepare(state, setpoint, dt_s=dt_s, landed=landed)
        if landed and not self._was_landed:
            self._runs = False
        self._was_landed, self._followed = landed, setpoint
        phase, climb_max_m_s = self._takeoff.phase, self._takeoff.climb_max_m_s
        yaw_rad, idles, flies = 0.0, False, False
        if isinstance(setpoint, TrajectorySetpoint):
            yaw_rad = self._update_yaw(state, setpoint, dt_s=dt_s)
            idles, flies = phase is TakeoffPhase.GROUND, phase is TakeoffPhase.FLYING
        else:
            self._yaw_rad = None
        INPUTS.pack_into(
            self._octets, 0, yaw_rad, 0.0, climb_max_m_s,
            dt_s, state.velocity_valid, idles, landed, flies,
        )  # fmt: skip
        observe(self.block, state.estimate)
        if idles:
            self._runs = False
            thrust, torque = 0.0, np.zeros(3)
        else:
            thrust, torque = self._demand(
                ControllerInputs(
                    state=state,
                    setpoint=setpoint,
                    yaw_rad=yaw_rad,
                    dt_s=dt_s,
                    landed=landed,
                    climb_max_m_s=climb_max_m_s,
                    hover_thrust=self.hover_thrust,
                    disturbance_ned_m_s2=self.disturbance_ned_m_s2,
                    unallocated=self._unallocated.copy(),
                    controls_yaw=self._allocator.controls_yaw,
                )
            )
        follow_demand(self.block, thrust, torque, airmode_above(landed, self.params.position.thr_min))
        return self.controls

    def _demand(self, inputs: ControllerInputs) -> tuple[float, Array]:
        """Return the controller's demand once it is valid."""
        with self._call:
            if not self._runs:
                self._runs = True
                self._controller.reset(inputs.state)
            demand = self._controller.update(inputs)
        return self._checked(demand)

    def _checked(self, demand: object) -> tuple[float, Array]:
        """Return thrust and torque of a demand. Raises ExtensionFailure for one that cannot be allocated."""
        if not isinstance(demand, ThrustTorque):
            raise self._call.refused(f"update returned a {type(demand).__name__}; expected a ThrustTorque")
        try:
            thrust, torque = float(demand.thrust), np.asarray(demand.torque, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise self._call.refused(f"update returned {demand!r:.100}: {error}") from error
        if torque.shape != (3,):
            raise self._call.refused(f"update returned a torque of shape {torque.shape}; expected (3,)")
        if not 0.0 <= thrust <= 1.0:  # also refuses NaN
            raise self._call.refused(f"update returned a thrust of {thrust:g}; expected 0 to 1")
        if not (np.abs(torque) <= TORQUE_MAX).all():
            values = ", ".join(f"{value:g}" for value in torque)
            raise self._call.refused(
                f"update returned a torque of ({values}); expected {-TORQUE_MAX:g} to {TORQUE_MAX:g}"
            )
        return thrust, torque


def unit_torque_m(params: ControlParams) -> tuple[float, float, float]:
    """Return the torque of a normalised demand of 1 about each axis, N m per newton of a rotor's thrust."""
    x, y, z = np.diag(effectiveness(params.allocation)[1:] @ mixer(params.allocation).torque).tolist()
    return x, y, z
