"""Models of the radio that the study's scenarios name: equal received powers, and a given loss of frames."""

from collections.abc import Callable
from math import log1p
from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from netsim.phy.interfaces import RadioContext
from netsim.phy.modes import PhyMode
from netsim.phy.path_loss import Doubles

LOSS_DB = 60.0


def equal_loss(distance_m: Doubles) -> Doubles:
    """Return a path loss of `LOSS_DB` at all distances, so that no frame captures a receiver."""
    return np.full_like(distance_m, LOSS_DB)


class LossSettings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Fraction of the frames of a length that are lost."""

    fraction: Annotated[float, Meta(ge=0.0, lt=1.0)]
    frame_bytes: Annotated[int, Meta(ge=1)]
    """Length of such a frame with MAC header and check sequence"""


class FrameLoss:
    """Losses that do not depend on the SNR: shorter frames are lost less often."""

    Settings = LossSettings

    def __init__(self, _radio: RadioContext, settings: LossSettings) -> None:
        self._hazard = -log1p(-settings.fraction) / (8 * settings.frame_bytes)

    def hazard(self, _mode: PhyMode) -> Callable[[float], float]:
        """See `netsim.phy.interfaces.ErrorModel`."""
        return lambda _snr_db: self._hazard
