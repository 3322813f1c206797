"""A trained policy as an on-board application, which flies it in any run. No I/O."""

from abc import abstractmethod
from enum import IntEnum

from numpy.typing import ArrayLike

from autopilot.onboard.application import Reports, Status
from autopilot.onboard.context import Context
from harness.env.application import EnvApplication
from harness.env.settings import Floats, checked_action, limited

HOVER_S = 2.0
"""Time for which a UAV hovers at its place before it follows the policy, as all do in an environment."""


class PolicyPhase(IntEnum):
    """What a `PolicyApplication` does."""

    APPROACHING = 0
    """Takes off, and flies to its place of the formation."""
    FOLLOWING = 1
    """Follows the policy; this counts as formed."""


class PolicyApplication(EnvApplication):
    """Base of an application that flies a policy from `coflight.env`: a subclass has the method `act`.

    Settings are `EnvSettings`, which must be those of the environment that the policy was trained in; a
    subclass may extend them by a class attribute ``Settings``. A UAV flies to its place and hovers there for
    2 s; then `act` is called in every iteration of the loop. In an environment all UAVs hover before the
    first action, here each begins when it does.
    """

    reports = Reports(phases=PolicyPhase, formed=(PolicyPhase.FOLLOWING,), placed=(PolicyPhase.APPROACHING,))

    def start(self, context: Context) -> None:
        """Store the context; names and bounds of observations are then known."""
        super().start(context)
        agents = len(context.places_ned_m)
        self.uav = context.uav
        self.observation_names = self.settings.observation_names(agents)
        self.action_names = self.settings.action_names()
        self._bounds = self.settings.observation_bounds(agents)
        self._hovering_us: int | None = None
        """Since when the UAV hovers at its place."""
        self._phase = PolicyPhase.APPROACHING

    @abstractmethod
    def act(self, observation: Floats) -> ArrayLike:
        """Return the action (A,) for an observation (O,), as in the environment."""

    def on_timer(self, now_us: int) -> None:
        """Apply the policy to the observation of the last iteration, as an environment does."""
        if self._phase is PolicyPhase.APPROACHING:
            if not self.is_hovering:
                self._hovering_us = None
            elif self._hovering_us is None:
                self._hovering_us = now_us
            elif now_us - self._hovering_us >= HOVER_S * 1e6:
                self._phase = PolicyPhase.FOLLOWING
        if self._phase is PolicyPhase.FOLLOWING:
            observed = limited(self.observation(), self._bounds)
            self.action = checked_action(self.settings, f"uav_{self.uav}", self.act(observed))
        super().on_timer(now_us)

    def status(self) -> Status:
        """Return the phase."""
        return Status(self._phase)
