"""The on-board application that flies the searched policy in any run, without the environment."""

from numpy.typing import ArrayLike

from coflight import Context, EnvSettings, PolicyApplication
from trained_policy.policies import Floats, LinearPolicy, lead


class PilotSettings(EnvSettings, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the environment, and the searched weights of `LinearPolicy`."""

    weights: tuple[float, float, float, float]


class Pilot(PolicyApplication):
    """UAV 0 leads, and UAV 1 follows it by the searched policy."""

    Settings = PilotSettings
    settings: PilotSettings

    def start(self, context: Context) -> None:
        """Select the policy of the UAV."""
        super().start(context)
        self._policy = lead
        if context.uav == 1:
            from_leader_ned_m = context.places_ned_m[1] - context.places_ned_m[0]
            self._policy = LinearPolicy(self.observation_names, from_leader_ned_m, self.settings.weights)

    def act(self, observation: Floats) -> ArrayLike:
        """Return the action of the policy."""
        return self._policy(observation)
