"""What vehicles and applications report, and the events of the run that follow from it.

Modes, statuses of the applications, losses, the formation reached, and the start of its motion.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mavlink

from autopilot.mavlink.ardupilot_modes import label_of
from autopilot.mavlink.codec import Message
from autopilot.mavlink.components import APPLICATION_COMPONENT, AUTOPILOT_COMPONENT
from autopilot.onboard.application import Layout
from autopilot.onboard.formation_plan import FormationPlan
from harness.simulator.application_status import ApplicationStatus
from harness.simulator.messages import (
    AnyEvent,
    ApplicationLost,
    ApplicationSilent,
    ApplicationText,
    FormationMoves,
    Formed,
    VehicleLost,
    VehicleSilent,
    VehicleTruth,
)
from harness.simulator.motion_start import agreed
from harness.world.physics.truth import Truth


class VehicleReports:
    """State of the swarm as its vehicles report it; ``now_us`` returns the simulated time.

    ``emit`` receives the events. A lost vehicle counts no more, and an application that was lost is absent.
    """

    def __init__(
        self, vehicles: int, layout: Layout, *, now_us: Callable[[], int], emit: Callable[[AnyEvent], None]
    ) -> None:
        self._now_us = now_us
        self._emit = emit
        self.lost: tuple[int, ...] = ()
        """Vehicles that were removed from the run, in order."""
        self.alive = np.ones(vehicles, dtype=np.bool_)
        """Whether each vehicle is in the run, (vehicles,)."""
        self.formed = False
        """Whether all applications, without absent ones, have reached their aim."""
        self._modes = [""] * vehicles
        self._applied = [ApplicationStatus(layout) for _ in range(vehicles)]
        self.without_application: set[int] = set()
        """Vehicles whose application was lost."""
        self._start_us: int | None = None
        """Start of the formation's motion that the majority of the applications reports."""
        self._changed = False
        """Whether the formation may have been reached, or its start agreed, since the last check."""

    def on_message(self, instance: int, message: Message) -> None:
        """Process a vehicle's message other than an answer: its mode, or the status of its application."""
        component = message.get_srcComponent()
        is_heartbeat = message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT
        if component == APPLICATION_COMPONENT:
            self._on_status(instance, message)
        elif component == AUTOPILOT_COMPONENT and is_heartbeat:
            self._modes[instance] = label_of(message)

    def _on_status(self, instance: int, message: Message) -> None:
        status = self._applied[instance]
        text = status.text
        status.on_message(message)
        self._changed = True
        if status.text != text:
            self._emit(ApplicationText(time_us=self._now_us(), instance=instance, text=status.text))

    def on_silent(self, instance: int, wall_silence_s: float) -> None:
        """Report a vehicle that has not answered for a while."""
        time_us = self._now_us()
        self._emit(VehicleSilent(time_us=time_us, instance=instance, wall_silence_s=wall_silence_s))

    def on_lost(self, instance: int, reason: str) -> None:
        """Report a vehicle that was removed from the run."""
        self.lost += (instance,)
        self.alive[instance] = False
        self._changed = True  # all others may be on station
        self._emit(VehicleLost(time_us=self._now_us(), instance=instance, reason=reason))

    def on_application_silent(self, instance: int, wall_silence_s: float) -> None:
        """Report an application that has not answered for a while."""
        time_us = self._now_us()
        self._emit(ApplicationSilent(time_us=time_us, instance=instance, wall_silence_s=wall_silence_s))

    def on_application_lost(self, instance: int, reason: str) -> None:
        """Report an application that was given up; its phase is unknown from now on."""
        self.without_application.add(instance)
        self._applied[instance].forget()
        self._changed = True  # all others may be on station
        self._emit(ApplicationLost(time_us=self._now_us(), instance=instance, reason=reason))

    def notice_changes(self) -> None:
        """Report the formation when it is reached, and a new start of its motion."""
        if not self._changed:
            return
        self._changed = False
        counted = [
            status
            for instance, status in enumerate(self._applied)
            if self.alive[instance] and instance not in self.without_application
        ]
        if not self.formed and {status.aim for status in counted} - {"dropped"} == {"reached"}:
            self.formed = True
            self._emit(Formed(time_us=self._now_us()))
        agreed_us = agreed([status.motion_start_us for status in counted])
        if agreed_us is not None and agreed_us != self._start_us:
            self._start_us = agreed_us
            self._emit(FormationMoves(time_us=self._now_us(), start_us=agreed_us))

    def vehicles(
        self, truth: Truth, plan: FormationPlan, *, connected: Sequence[bool], armed: NDArray[np.bool_]
    ) -> tuple[VehicleTruth, ...]:
        """Return the reports with the truth and the distance of each vehicle from its place of the plan."""
        since_start_s = 0.0 if self._start_us is None else (self._now_us() - self._start_us) * 1e-6
        places_ned_m = plan.at(since_start_s).pos_ned_m
        error_m = np.linalg.norm((truth.pos_ned_m - places_ned_m)[:, :2], axis=1)
        return tuple(
            VehicleTruth(
                alive=connected[i],
                armed=bool(armed[i]),
                mode=self._modes[i],
                phase=status.phase_text,
                pos_ned_m=tuple(truth.pos_ned_m[i].tolist()),
                vel_ned_m_s=tuple(truth.vel_ned_m_s[i].tolist()),
                q_ned_frd=tuple(truth.q_ned_frd[i].tolist()),
                error_m=float(error_m[i]),
                aim=status.aim,
                is_placed=status.is_placed,
                text=status.text,
                values=status.values,
            )
            for i, status in enumerate(self._applied)
        )
