"""Received powers of the ranging radios, from the models of ``[radio]`` at the frequency of the UWB channel.

Path loss, antenna pattern, shadowing and blockage are those of the 802.11 channel; with two rays the loss is
averaged over 499.2 MHz. There is no small-scale fading: a receiver with that bandwidth resolves the first
path.
"""

from math import log10

import numpy as np
from msgspec import structs

from netsim.ftm.port import Environment
from netsim.model.config import RadioConfig
from netsim.model.random_streams import RandomStreams
from netsim.phy.path_gain import PathGain
from netsim.phy.path_loss import REFERENCE_DISTANCE_M, Doubles, TwoRay, friis_loss_db
from netsim.radio_models.registry import make_models
from netsim.uwb.config import UwbConfig
from netsim.uwb.frames import CENTRE_MHZ, CHIP_MHZ


def at_channel(radio: RadioConfig, config: UwbConfig) -> RadioConfig:
    """Return the settings of the 802.11 radio at the frequency of the UWB channel, without fading."""
    return structs.replace(radio, frequency_mhz=CENTRE_MHZ[config.channel], rician_k_db=None)


class LinkBudget:
    """Received powers of all pairs of stations, whose motion and blockage are those of ``environment``.

    Raises ExtensionError for a model that is not available at the frequency, as `make_models`.
    """

    def __init__(
        self,
        radio: RadioConfig,
        config: UwbConfig,
        *,
        stations: int,
        environment: Environment,
        streams: RandomStreams,
    ) -> None:
        at_uwb = at_channel(radio, config)
        models = make_models(at_uwb, stations, streams)
        if isinstance(models.path_loss, TwoRay):
            models = structs.replace(
                models, path_loss=structs.replace(models.path_loss, bandwidth_mhz=CHIP_MHZ)
            )
        self._path = PathGain(at_uwb, models)
        self._trajectories = environment.trajectories
        self.is_blocked = environment.blocked
        self.blocked_gain: float = 10.0 ** (-radio.nlos_loss_db / 10.0)
        """Linear gain of a blocked line of sight."""
        self._sent_dbm = config.eirp_dbm_mhz + 10.0 * log10(CHIP_MHZ) + config.antenna_gain_dbi
        self._sent_dbm -= friis_loss_db(REFERENCE_DISTANCE_M, at_uwb.frequency_mhz)
        self.set_extra_attenuation_db(radio.extra_attenuation_db)

    def set_extra_attenuation_db(self, value: float) -> None:
        """Set the extra attenuation of all links, dB."""
        self._at_reference_mw: float = 10.0 ** ((self._sent_dbm - value) / 10.0)

    def clear_powers_mw(self, source: int, at_ns: int) -> Doubles:
        """Return the powers (n,) that all stations receive from a source without blockage."""
        pos_ned_m = self._trajectories.positions_ned_m(at_ns)
        exponent = self._path.power_law_exponent
        if exponent is not None:
            distances_m = np.sqrt(((pos_ned_m - pos_ned_m[source]) ** 2).sum(axis=1))
            gains = np.maximum(distances_m, REFERENCE_DISTANCE_M) ** -exponent
        else:
            rotations = self._trajectories.rotations_ned_frd() if self._path.uses_attitudes else None
            rows, _ = self._path.between_stations(slice(source, source + 1), pos_ned_m, rotations)
            gains = rows[0]
        return np.asarray(self._at_reference_mw * gains)
