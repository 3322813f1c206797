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

from math import cos, pi, sin, sqrt

import numpy as np
from numba import njit

from netsim.model.random_streams import Model, RandomStreams
from netsim.phy.path_loss import SPEED_OF_LIGHT_M_S, Doubles

SECTORS = 8
"""Angles of a link, as many as Zheng and Xiao find sufficient; it has twice as many waves."""


@njit(cache=True)
def _turn(
    theta_rad: Doubles,
    rates_rad_ns: Doubles,
    from_ned_m: Doubles,
    to_ned_m: Doubles,
    vel_ned_m_s: Doubles,
    since_s: float,
    doppler_hz: float,
    wavelength_m: float,
) -> None:
    """Turn every pair's theta (n, n) on by its ends' ways between places (n, 3), and take its new rate."""
    # products, not powers: of those Python's pow rounds some otherwise than compiled code
    wavelength_m2, doppler_turns = wavelength_m * wavelength_m, doppler_hz * since_s
    for a in range(len(theta_rad)):
        for b in range(a):
            way_m2 = speed_m2_s2 = 0.0
            for axis in range(3):
                moved_m = to_ned_m[a, axis] - from_ned_m[a, axis]
                way_m = moved_m - (to_ned_m[b, axis] - from_ned_m[b, axis])
                speed_m_s = vel_ned_m_s[a, axis] - vel_ned_m_s[b, axis]
                way_m2 += way_m * way_m
                speed_m2_s2 += speed_m_s * speed_m_s
            turns = sqrt(way_m2 / wavelength_m2 + doppler_turns * doppler_turns)
            spread_hz = sqrt(speed_m2_s2 / wavelength_m2 + doppler_hz * doppler_hz)
            theta_rad[a, b] += 2.0 * pi * turns
            theta_rad[b, a] = theta_rad[a, b]
            rates_rad_ns[a, b] = rates_rad_ns[b, a] = 2e-9 * pi * spread_hz


@njit(cache=True)
def fade(block: Doubles, source: int, at_ns: int, powers_mw: Doubles) -> None:
    """Multiply the powers (n,) of a station's signals by |h|^2 of its links, in a `RicianFading.block`."""
    n = len(powers_mw)
    since_ns, line_of_sight = int(block[0]), block[1]
    theta_rad, rates_rad_ns, cosines, weights = _parts(block, n)
    for r in range(n):
        angle_rad = theta_rad[source, r] + rates_rad_ns[source, r] * (at_ns - since_ns)
        real, imaginary = line_of_sight, 0.0
        for m in range(SECTORS):
            phase_rad = angle_rad * cosines[source, r, m]
            cosine, sine = cos(phase_rad), sin(phase_rad)
            real += weights[source, r, m, 0] * cosine + weights[source, r, m, 1] * sine
            imaginary += weights[source, r, m, 2] * cosine + weights[source, r, m, 3] * sine
        powers_mw[r] *= real * real + imaginary * imaginary


@njit(cache=True)
def _parts(block: Doubles, n: int) -> tuple[Doubles, Doubles, Doubles, Doubles]:
    """Give every pair's theta and its rate (n, n), the waves' cosines (n, n, sectors), and their weights.

    Weights (n, n, sectors, 4) are of each one's cosine and sine, in the real and then in the imaginary part.
    """
    square = n * n
    at = 2
    theta_rad = block[at : at + square].reshape((n, n))
    rates_rad_ns = block[at + square : at + 2 * square].reshape((n, n))
    at += 2 * square
    cosines = block[at : at + square * SECTORS].reshape((n, n, SECTORS))
    weights = block[at + square * SECTORS : at + 5 * square * SECTORS].reshape((n, n, SECTORS, 4))
    return theta_rad, rates_rad_ns, cosines, weights


class RicianFading:
    """Fading of all links."""

    def __init__(
        self, *, k_db: float, doppler_hz: float, frequency_mhz: float, stations: int, streams: RandomStreams
    ) -> None:
        k = 10.0 ** (k_db / 10.0)
        self._amplitude = (0.5 / SECTORS / (k + 1.0)) ** 0.5
        self._doppler_hz = doppler_hz
        self._wavelength_m = SPEED_OF_LIGHT_M_S / (frequency_mhz * 1e6)
        self._stations = stations
        self._pos_ned_m: Doubles | None = None
        self.block = np.zeros(2 + stations**2 * (2 + 5 * SECTORS))
        """All that `fade` needs: since when the parts hold, in nanoseconds, the steady ray, and the parts."""
        self.block[1] = (k / (k + 1.0)) ** 0.5
        self._theta_rad, self._rates_rad_ns, self._cosines, self._weights = _parts(self.block, stations)
        self._rates_rad_ns[...] = 2e-9 * pi * doppler_hz
        for a in range(stations):
            for b in range(a + 1, stations):
                cosines, weights = self._waves(streams.generator(Model.FADING, a, b))
                self._cosines[a, b] = self._cosines[b, a] = cosines
                self._weights[a, b] = self._weights[b, a] = weights

    def move(self, at_ns: int, pos_ned_m: Doubles, vel_ned_m_s: Doubles) -> None:
        """At ``at_ns`` the stations are at these places (n, 3), and go on with these velocities (n, 3).

        While all rest this need not be said again.
        """
        # before the first instant everybody stood still
        from_ned_m = pos_ned_m if self._pos_ned_m is None else self._pos_ned_m
        _turn(
            self._theta_rad,
            self._rates_rad_ns,
            from_ned_m,
            pos_ned_m,
            vel_ned_m_s,
            (at_ns - int(self.block[0])) * 1e-9,
            self._doppler_hz,
            self._wavelength_m,
        )
        self.block[0], self._pos_ned_m = at_ns, pos_ned_m

    def gains(self, source: int, at_ns: int) -> Doubles:
        """Gain of each link of ``source``, by station; of no meaning for itself."""
        gains = np.ones(self._stations)
        fade(self.block, source, at_ns, gains)
        return gains

    def _waves(self, generator: np.random.Generator) -> tuple[Doubles, Doubles]:
        """Draw the waves of one link: their cosines (sectors,) and weights (sectors, 4)."""
        cosines = np.cos(pi / SECTORS * (np.arange(SECTORS) + generator.random(SECTORS)))
        ahead, behind = self._amplitude * np.exp(2j * pi * generator.random((2, SECTORS)))
        # ahead e^(ix) + behind e^(-ix)
        of_cosine, of_sine = ahead + behind, 1j * (ahead - behind)
        weights = np.stack((of_cosine.real, of_sine.real, of_cosine.imag, of_sine.imag), axis=1)
        return cosines, weights
