"""A path loss with two slopes: free space up to a breakpoint, a steeper power law beyond it."""

from dataclasses import dataclass
from math import log10, pi
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from coflight import RadioContext

Doubles = NDArray[np.float64]
SPEED_OF_LIGHT_M_S = 299_792_458.0


@dataclass(frozen=True)
class Settings:
    """The table ``[radio.path_loss.settings]``."""

    breakpoint_m: Annotated[float, Meta(ge=1.0)] = 40.0
    exponent_beyond: Annotated[float, Meta(ge=2.0, le=8.0)] = 4.0


class TwoSlopes:
    """See `coflight.PathLoss`."""

    Settings = Settings

    def __init__(self, radio: RadioContext, settings: Settings) -> None:
        wavelength_m = SPEED_OF_LIGHT_M_S / (1e6 * radio.config.frequency_mhz)
        self._at_1_m_db = 20.0 * log10(4.0 * pi / wavelength_m)
        self._settings = settings

    def loss_db(self, _from_ned_m: Doubles, _to_ned_m: Doubles, distance_m: Doubles) -> Doubles:
        """Return the losses (m, n) in dB over distances (m, n)."""
        settings = self._settings
        beyond = np.log10(np.maximum(distance_m / settings.breakpoint_m, 1.0))
        losses_db = self._at_1_m_db + 20.0 * np.log10(distance_m)
        return losses_db + 10.0 * (settings.exponent_beyond - 2.0) * beyond
