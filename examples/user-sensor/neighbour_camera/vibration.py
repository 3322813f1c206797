"""A damaged rotor that shakes the accelerometer at the frequency of its turns."""

import math
from typing import Annotated

from msgspec import Meta, Struct

from coflight import Effects, WorldContext, WorldInputs


class VibrationSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The table ``settings`` of the fault."""

    rotor: Annotated[int, Meta(ge=0)] = 0
    amplitude_m_s2: Annotated[float, Meta(gt=0.0, le=50.0)] = 3.0
    """At ``reference_rad_s``; the force of an imbalance grows with the square of the speed."""
    reference_rad_s: Annotated[float, Meta(gt=0.0)] = 700.0


class Vibration:
    """See `coflight.FaultModel`. The sensor samples every step, so turns above 125 Hz are aliased."""

    Settings = VibrationSettings

    def __init__(self, context: WorldContext, settings: VibrationSettings) -> None:
        self._settings, self._step_s = settings, context.step_us * 1e-6
        self._angle_rad = 0.0

    def update(self, inputs: WorldInputs, since_s: float) -> Effects:  # noqa: ARG002  the protocol has it
        """Return the offset of a force that turns with the rotor, in the plane of the body."""
        settings, speed_rad_s = self._settings, float(inputs.rotor_speed_rad_s[self._settings.rotor])
        self._angle_rad = math.remainder(self._angle_rad + speed_rad_s * self._step_s, math.tau)
        amplitude_m_s2 = settings.amplitude_m_s2 * (speed_rad_s / settings.reference_rad_s) ** 2
        forward, right = math.cos(self._angle_rad), math.sin(self._angle_rad)
        return Effects(accel_offset_frd_m_s2=(amplitude_m_s2 * forward, amplitude_m_s2 * right, 0.0))
