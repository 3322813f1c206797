"""Path gains between the stations of the serial radios, from the models of ``[radio]`` at another frequency.

Path loss, antenna pattern, shadowing and blockage are those of the 802.11 channel (`netsim.phy`); with equal
seeds, shadowing and blockage are the same. Rician fading is drawn for each pair of modems; a fading model of
the user's own is not used.
"""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
from msgspec import structs
from numpy.typing import ArrayLike

from netsim.model.config import RadioConfig
from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.fading import RicianFading, gain
from netsim.phy.obstruction import Obstruction
from netsim.phy.path_gain import ALL, PathGain
from netsim.phy.path_loss import REFERENCE_DISTANCE_M, Doubles, TwoRay, friis_loss_db
from netsim.phy.propagation import Trajectories
from netsim.radio_models.registry import make_models
from netsim.serial_radio.config import SerialRadioConfig
from netsim.serial_radio.hopping import centre_mhz, span_mhz

GAINS_LIFETIME_NS = 20_000_000
"""Time for which gains are constant that are computed as arrays: 0.4 m of motion at 20 m/s."""
KEPT_GAINS = 8
"""Number of such arrays that are kept, since gains are needed as of the beginnings of packets that end."""


class LinkGains(Protocol):
    """Power gains of links between stations; equal in both directions."""

    def gain(self, a: int, b: int, at_ns: int) -> float:
        """Return the linear gain from antenna port to antenna port, without fading."""

    def fading(self, a: int, b: int, times_ns: list[int]) -> list[float] | None:
        """Return the linear gains by fading of a pair of modems at increasing times; None: no fading."""


class PathGains:
    """Path gains by the settings of a scenario, for stations in motion.

    Raises ExtensionError for a model that is not available at the frequency, as `make_models`.
    """

    def __init__(
        self,
        radio: RadioConfig,
        serial: SerialRadioConfig,
        stations: int,
        seed: np.random.SeedSequence,
        *,
        own_gain_dbi: Mapping[int, float] | None = None,
    ) -> None:
        """Create the models; ``own_gain_dbi`` are peak gains of single stations instead of the common one."""
        self._config = structs.replace(radio, frequency_mhz=centre_mhz(serial), rician_k_db=None)
        self._k_db = radio.rician_k_db if radio.fading == "rician" else None
        self._doppler_hz = radio.fading_doppler_hz
        self._seed = seed
        streams = RandomStreams(seed)
        models = make_models(self._config, stations, streams)
        if isinstance(models.path_loss, TwoRay):
            # averaged over the channels of the hopping sequence
            path_loss = structs.replace(models.path_loss, bandwidth_mhz=span_mhz(serial))
            models = structs.replace(models, path_loss=path_loss)
        self._path = PathGain(self._config, models)
        own = own_gain_dbi or {}
        self._relative: list[float] = [
            10.0 ** ((own.get(i, serial.antenna_gain_dbi) - serial.antenna_gain_dbi) / 10.0)
            for i in range(stations)
        ]
        """By station: gain of its antenna relative to the common one."""
        self._exponent = self._path.power_law_exponent
        self._fixed_db = 2.0 * serial.antenna_gain_dbi - friis_loss_db(
            REFERENCE_DISTANCE_M, self._config.frequency_mhz
        )
        self.set_extra_attenuation_db(radio.extra_attenuation_db)
        self._trajectories = Trajectories(stations)
        self._obstruction: Obstruction | None = None
        if radio.nlos_fraction > 0.0:
            self._obstruction = Obstruction(
                fraction=radio.nlos_fraction,
                duration_s=radio.nlos_duration_s,
                stations=stations,
                streams=streams,
            )
        self._blocked: float = 10.0 ** (-radio.nlos_loss_db / 10.0)
        self._fading: dict[tuple[int, int], RicianFading] = {}
        self._computed: dict[int, Doubles] = {}
        """Gains of all links by time in units of `GAINS_LIFETIME_NS`."""

    def set_extra_attenuation_db(self, value: float) -> None:
        """Set the extra attenuation of all links, dB."""
        self._fixed: float = 10.0 ** ((self._fixed_db - value) / 10.0)

    def set_motion(
        self, at_ns: int, pos_ned_m: ArrayLike, vel_ned_m_s: ArrayLike, q_ned_frd: ArrayLike | None = None
    ) -> None:
        """Set positions (n, 3) at ``at_ns`` and velocities (n, 3) from then on, as `Trajectories.set`."""
        self._trajectories.set(at_ns, pos_ned_m, vel_ned_m_s, q_ned_frd)

    def gain(self, a: int, b: int, at_ns: int) -> float:
        """Return the linear gain of a link, without fading; between modems of one station at 1 m."""
        fixed = self._fixed * self._relative[a] * self._relative[b]
        if a == b:
            return fixed
        if self._exponent is not None:
            distance_m = max(self._trajectories.distance_m(a, b, at_ns), REFERENCE_DISTANCE_M)
            result = fixed * float(distance_m**-self._exponent)
        else:
            result = fixed * float(self._gains(at_ns)[a, b])
        if self._obstruction is not None and self._obstruction.blocked(a, b, at_ns)[0]:
            result *= self._blocked
        return result

    def _gains(self, at_ns: int) -> Doubles:
        """Return the gains (n, n) of all links, which are computed together for `GAINS_LIFETIME_NS`."""
        cell = at_ns // GAINS_LIFETIME_NS
        gains = self._computed.get(cell)
        if gains is None:
            if len(self._computed) == KEPT_GAINS:
                del self._computed[min(self._computed)]
            pos_ned_m = self._trajectories.positions_ned_m(cell * GAINS_LIFETIME_NS)
            rotations = self._trajectories.rotations_ned_frd() if self._path.uses_attitudes else None
            gains, _ = self._path.between_stations(ALL, pos_ned_m, rotations)
            self._computed[cell] = gains
        return gains

    def fading(self, a: int, b: int, times_ns: list[int]) -> list[float] | None:
        """Return the linear gains by fading of a pair of modems at increasing times; None: no fading."""
        if self._k_db is None:
            return None
        key = (a, b) if a < b else (b, a)
        fading = self._fading.get(key)
        if fading is None:
            seed = np.random.SeedSequence(
                self._seed.entropy, spawn_key=(*self._seed.spawn_key, Model.SERIAL_RADIO, *key)
            )
            fading = self._fading[key] = RicianFading(
                k_db=self._k_db,
                doppler_hz=self._doppler_hz,
                frequency_mhz=self._config.frequency_mhz,
                stations=2,
                streams=RandomStreams(seed),
            )
        pos_ned_m, vel_ned_m_s, since_s = self._trajectories.course(times_ns[0])
        ends_m_s = vel_ned_m_s[key, :]
        fading.move(times_ns[0], pos_ned_m[key, :] + since_s * ends_m_s, ends_m_s)
        return [gain(fading.block, 2, 0, 1, time_ns) for time_ns in times_ns]
