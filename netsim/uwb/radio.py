"""One ranging radio: its clock, the noise of its time stamps, its antenna delay and what occupies it."""

import numpy as np

from netsim.model.random_streams import FloatStream
from netsim.uwb.clock import UwbClock, stamp
from netsim.uwb.config import UwbConfig
from netsim.uwb.reception import arrival_std_ps


class UwbRadio:
    """Radio of one station.

    ``clocks``, ``noise`` and ``nlos`` are generators of its clock and antenna delay, of its time stamps, and
    of the excess ranges of the exchanges that it initiates.
    """

    def __init__(
        self,
        config: UwbConfig,
        *,
        clocks: np.random.Generator,
        noise: np.random.Generator,
        nlos: np.random.Generator,
    ) -> None:
        self._config = config
        self.clock = UwbClock(config.clock_ppm, config.clock_drift_ppm_s, clocks)
        self._antenna_delay_ps = config.antenna_delay_std_ps * float(clocks.standard_normal())
        """Error of the sum of both antenna delays, which its arrivals carry."""
        self._errors = FloatStream(noise.standard_normal)
        self._nlos = nlos
        self.occupied_by: object | None = None
        """Exchange that the radio takes part in; None: it waits for a poll."""

    def excess_m(self) -> float:
        """Return the excess range of a new exchange while its line of sight is blocked."""
        return float(self._nlos.exponential(self._config.nlos_bias_mean_m))

    def departure(self, true_ps: int) -> int:
        """Return the time stamp of a programmed departure, which is exact."""
        return stamp(self.clock, true_ps)

    def arrival(self, true_ps: int, power_mw: float, excess_ps: float) -> int:
        """Return the time stamp of an arrival: noise, antenna delay and an excess path are added."""
        noise_ps = arrival_std_ps(self._config, power_mw) * self._errors.draw()
        return stamp(self.clock, true_ps, noise_ps + self._antenna_delay_ps + excess_ps)

    def rate_ratio(self, other: UwbClock, true_ps: int) -> float:
        """Return the rate of the own clock relative to another one, as estimated from a frame's carrier."""
        if not self._config.carrier_correction:
            return 1.0
        error = 1e-6 * self._config.carrier_offset_std_ppm * self._errors.draw()
        return self.clock.rate(true_ps) / other.rate(true_ps) + error
