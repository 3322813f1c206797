"""Small-scale fading: a steady ray and scattered waves that turn with the Doppler spread.

Power gain |h|^2 of a link, mean 1, with h = sqrt(K / (K + 1)) + sqrt(1 / (K + 1)) s. The scattered part s is
Clarke's: waves from all around, of phase theta cos(alpha_m) + phi_m, where theta is the integral of 2 pi
times the Doppler spread over time. Its correlation is then J0(theta' - theta): with a steady spread f_d, J0(2
pi f_d tau). Angles lie one in each sector of the half circle, and each stands for the wave from the other
side as well, whose phase turns the other way: cosine and sine serve both (Zheng and Xiao, IEEE Transactions
on Communications 51, 2003, on such sums).

The spread of what moves around the stations and that of the stations' own relative motion, v / lambda, are of
independent causes: their squares add. From one instant at which positions are stated to the next, v is the
way of the one end as seen from the other over the time between; after the last it is as the velocities say.
So it hardly matters at how many instants they are stated: a turn counts as its chord.

All is a function of the seed, the unordered pair and theta, so a link is the same in both directions and no
matter who sends when.

A frame has the gain of its beginning throughout, and the same on all subcarriers.
"""

from math import pi

import numpy as np

from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S, Doubles, Vector
from netsim.streams import Model, Streams

SECTORS = 8
"""Angles of a link, as many as Zheng and Xiao find sufficient; it has twice as many waves."""


class RicianFading:
    """Fading of all links."""

    def __init__(
        self, *, k_db: float, doppler_hz: float, frequency_mhz: float, stations: int, streams: Streams
    ) -> None:
        k = 10.0 ** (k_db / 10.0)
        self._line_of_sight = (k / (k + 1.0)) ** 0.5
        self._amplitude = (0.5 / SECTORS / (k + 1.0)) ** 0.5
        self._doppler_square_hz2 = doppler_hz**2
        self._wavelength_m = SPEED_OF_LIGHT_M_S / (frequency_mhz * 1e6)
        self._stations = stations
        self._streams = streams
        self._since_ns = 0
        self._stated: object = None
        self._pos_ned_m: Doubles | None = None
        self._theta_rad = np.zeros((stations, stations))
        """Of every pair at ``_since_ns``, and its rate from then on."""
        self._rates_rad_ns = np.full((stations, stations), 2e-9 * pi * doppler_hz)
        self._waves: list[tuple[Doubles, Doubles] | None] = [None] * stations
        """By source: cosines (n, sectors), weights of real and imaginary part (n, 2, 2 sectors)."""
        self._turning: list[tuple[Doubles, Doubles] | None] = [None] * stations
        """By source: the waves' phases (n, sectors) at ``_since_ns``, and their rates."""
        self._phases = np.empty((stations, SECTORS))
        self._turned = np.empty((stations, 2 * SECTORS))
        self._cosine, self._sine = self._turned[:, :SECTORS], self._turned[:, SECTORS:]

    def move(self, at_ns: int, pos_ned_m: list[Vector], vel_ned_m_s: list[Vector]) -> None:
        """At ``at_ns`` the stations are at these places, and go on with these velocities."""
        if (pos_ned_m, vel_ned_m_s) == self._stated and not any(map(any, vel_ned_m_s)):
            return
        self._stated = pos_ned_m, vel_ned_m_s
        places = np.array(pos_ned_m).reshape(-1, 3)
        # before the first instant everybody stood still
        moved = np.zeros_like(places) if self._pos_ned_m is None else places - self._pos_ned_m
        since_s = (at_ns - self._since_ns) * 1e-9
        both = np.stack((moved, np.array(vel_ned_m_s).reshape(-1, 3)))
        relative = both[:, :, None] - both[:, None]
        square = np.einsum("kijl,kijl->kij", relative, relative) / self._wavelength_m**2
        square[0] += self._doppler_square_hz2 * since_s**2
        square[1] += self._doppler_square_hz2
        turns, spread_hz = np.sqrt(square)
        self._theta_rad += 2.0 * pi * turns
        self._rates_rad_ns = 2e-9 * pi * spread_hz
        self._since_ns, self._pos_ned_m = at_ns, places
        self._turning = [None] * self._stations

    def gains(self, source: int, at_ns: int) -> list[float]:
        """Gain of each link of ``source``, by station; of no meaning for itself."""
        waves = self._waves[source]
        if waves is None:
            waves = self._waves[source] = self._draw(source)
        cosines, weights = waves
        turning = self._turning[source]
        if turning is None:
            theta_rad, rate_rad_ns = self._theta_rad[source, :, None], self._rates_rad_ns[source, :, None]
            turning = self._turning[source] = theta_rad * cosines, rate_rad_ns * cosines
        phases = np.multiply(turning[1], at_ns - self._since_ns, out=self._phases)
        phases += turning[0]
        np.cos(phases, out=self._cosine)
        np.sin(phases, out=self._sine)
        steady = self._line_of_sight
        scattered = np.matvec(weights, self._turned).tolist()
        return [(steady + real) ** 2 + imaginary**2 for real, imaginary in scattered]

    def _draw(self, source: int) -> tuple[Doubles, Doubles]:
        cosines = np.zeros((self._stations, SECTORS))
        weights = np.zeros((self._stations, 2, 2 * SECTORS))
        for other in range(self._stations):
            if other == source:
                continue
            generator = self._streams.generator(Model.FADING, min(source, other), max(source, other))
            cosines[other] = np.cos(pi / SECTORS * (np.arange(SECTORS) + generator.random(SECTORS)))
            ahead, behind = self._amplitude * np.exp(2j * pi * generator.random((2, SECTORS)))
            # ahead e^(ix) + behind e^(-ix)
            both = np.concatenate((ahead + behind, 1j * (ahead - behind)))
            weights[other] = both.real, both.imag
        return cosines, weights
